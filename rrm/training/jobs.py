"""Jobs: what a process is given to do. `rrm.training.kinds` has the table."""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from importlib.metadata import version
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch

from rrm.buffers.frames import Frames
from rrm.checkpoint import Checkpoints, check_finite, encode
from rrm.envs import make
from rrm.errors import NumericalError, PriorError, WaitingError
from rrm.files import make_folder, write_atomically
from rrm.imitation.demos import film_of
from rrm.nets import products
from rrm.registry import lookup
from rrm.rendering import renderer
from rrm.training.build import DEMOS, NO_RESULTS, Assembled, Results, assemble, result_of
from rrm.training.episodes import demonstrate, expert_policy
from rrm.training.kinds import JOBS, MODEL, DemosConfig, kept_networks
from rrm.training.loop import Trainer
from rrm.training.run_config import JobConfig, RunConfig
from rrm.tuning import Choice, machine
from rrm.types import EvalRow, State

_BEAT_S = 0.25
_WALK = 50  # steps


class Monitor(Protocol):
    """What a job tells whoever started it, and asks of them. A class made from it takes no notice and never stops."""

    def restored(self, rows: Sequence[EvalRow]) -> None:
        """Take every evaluation up to the checkpoint that is continued from, oldest first; most are known already."""

    def row(self, row: EvalRow) -> None:
        """Take a finished evaluation; it is durable on return. A row of a step seen before replaces it."""

    def beat(self, step: int, steps_per_s: float) -> None:
        """Sign of life, a few times a second."""

    def note(self, message: str) -> None:
        """Something a person should be told."""

    def should_stop(self) -> bool:
        """True: write a checkpoint and return."""
        return False

    def writing(self) -> AbstractContextManager[None]:
        """Around every write into the job's folder; entering it raises where the folder belongs to another by now."""
        return nullcontext()


def perform(config: JobConfig, folder: Path, monitor: Monitor, results: Results = NO_RESULTS) -> bool:
    """Do the job in `folder`, or go on with it; see `train` and `collect`."""
    does = lookup({config.kind: JOBS[config.kind].perform}, "kind of job", config.kind)
    finished: bool = does(config, folder, monitor, results)
    return finished


def choose_products(earlier: Choice | None) -> Choice:
    """Have networks multiply as they did before, where that can be, else as is the quickest on this machine. Returns
    what that is. Without a call it is the machine's own.
    """
    chosen = machine().keep(earlier)
    products.use(chosen)
    return chosen


def fingerprint(config: JobConfig) -> dict[str, str]:
    """Which world a job is done in: versions of what its task is made of, and `true_reward`, a digest of the task's
    rewards along a fixed random walk, rounded to six digits, so that machines that differ in the last bits agree.
    What draws its pictures, where OpenGL does; a `RenderingError` where there is none.
    """
    env, rng = make(config.task), np.random.default_rng(0)
    steps, shape = min(_WALK, env.horizon), env.action_space.shape
    try:
        env.reset(seed=0)
        rewards = [env.step(rng.uniform(-1, 1, shape).astype(np.float32))[1] for _ in range(steps)]
    finally:
        env.close()
    digest = hashlib.sha256(" ".join(f"{reward:.6f}" for reward in rewards).encode()).hexdigest()[:16]
    drawn = {"renderer": renderer().name} if config.needs_opengl else {}
    versions = {name: version(name) for name in (*config.spec().packages, "numpy", "torch")}
    return versions | {"true_reward": digest} | drawn


def collect(config: DemosConfig, folder: Path, monitor: Monitor, results: Results) -> bool:
    """Have the expert play, and leave its episodes in `folder/demos.safetensors`, and pictures of them beside it. A
    matter of a minute, or of some where they are drawn: no checkpoint.

    True when they are there; False when it was told to stop, and will begin anew.
    """
    torch.set_num_threads(config.threads)
    policy = expert_policy(config.expert, result_of(results, config.expert.identity, MODEL))

    def stopped(step: int, steps_per_s: float) -> bool:
        monitor.beat(step, steps_per_s)
        return monitor.should_stop()

    frames = None
    if config.frames is not None:
        frames = Frames(config.frames)
        with monitor.writing():
            frames.save(film_of(folder / DEMOS))
    source = {"source": "expert", "expert": config.expert.identity, "expert_steps": config.expert.steps}
    demos = demonstrate(
        config.task, policy, config.episodes,
        seed=config.seed, horizon=config.expert.horizon, least_success=config.least_success, source=source,
        ranges=config.expert.env.ranges(), repeat=config.expert.action_repeat, frames=frames,
        by_state=config.expert.task != config.task, stopped=stopped,
    )  # fmt: skip
    if demos is None:
        return False
    with monitor.writing():
        demos.save(folder / DEMOS)
    summary = demos.summary()
    monitor.note(f"{summary['episodes']} episodes, {_worth(summary)}")
    return True


def train(
    config: RunConfig,
    folder: Path,
    monitor: Monitor,
    results: Results = NO_RESULTS,
    *,
    checkpoint_every_s: float = 120.0,
    assembled: Assembled = assemble,
) -> bool:
    """Train from the newest checkpoint in `folder`, or from the start, to the end of the run.

    A checkpoint is written after every evaluation and at least every `checkpoint_every_s` seconds; when they are
    written has no influence on the numbers. A finished run leaves its networks in `folder/model.safetensors` and no
    checkpoint. `assembled` makes the run's parts, for those who try one of their own.

    Returns True when the run is finished; False when it was told to stop and can be continued.

    Raises:
        WaitingError: it cannot go on before something has come from outside; it is checkpointed.
        RrmError: what the run was given cannot be run (a prior that fails, numbers that are not finite).
        OSError: a checkpoint could not be written; the ones before are intact.
    """
    torch.set_num_threads(config.threads)
    known = results if not config.asks_people else {**results, config.identity: folder}
    checkpoints = Checkpoints(folder / "checkpoint")
    with monitor.writing():  # what is damaged is set aside
        make_folder(checkpoints.folder)
        trainer = _restore(lambda: Trainer(config, known, assembled), checkpoints, monitor)
    monitor.restored(trainer.rows)
    saved_at, saved_step = beat_at, beat_step = time.monotonic(), trainer.step

    def save() -> None:
        nonlocal saved_at, saved_step
        check_finite(trainer.weights())
        with monitor.writing():
            if trainer.step < config.steps:  # else the run is over; its networks are written instead
                checkpoints.save(trainer.step, trainer.save(checkpoints.folder))
                trainer.experience.discard(checkpoints.folder)
            trainer.publish(folder)
        saved_at, saved_step = time.monotonic(), trainer.step

    try:
        while trainer.step < config.steps:
            try:
                trainer.advance()
            except WaitingError:
                save()
                raise
            _keep(trainer, folder, monitor)
            if trainer.step % config.evaluation.every == 0 or trainer.step == config.steps:
                monitor.row(trainer.evaluate())
                save()
            now = time.monotonic()
            if now - beat_at >= _BEAT_S:
                monitor.beat(trainer.step, (trainer.step - beat_step) / (now - beat_at))
                beat_at, beat_step = now, trainer.step
            if monitor.should_stop():
                break
            if now - saved_at >= checkpoint_every_s:
                save()
        if trainer.step < config.steps:
            if saved_step != trainer.step:
                save()
            return False
        _leave(trainer.legacy(), folder, monitor)
    except (NumericalError, PriorError) as error:
        last = f"the last good checkpoint is of step {saved_step:,}" if saved_step else "no checkpoint yet"
        where = "" if f"step {trainer.step}" in str(error) else f"at step {trainer.step:,}; "
        raise type(error)(f"{error} ({where}{last})") from error
    finally:
        trainer.close()
    with monitor.writing():
        shutil.rmtree(checkpoints.folder)
    return True


def _keep(trainer: Trainer, folder: Path, monitor: Monitor) -> None:
    """The networks of a step that is to be deployed. Where training goes back behind it, they are the same again."""
    if trainer.step not in trainer.config.deploy.checkpoints or trainer.step == trainer.config.steps:
        return
    check_finite(trainer.weights())
    path = folder / kept_networks(trainer.step, trainer.config.steps)
    with monitor.writing():
        make_folder(path.parent)
        write_atomically(path, encode({"agent": trainer.agent.state_dict()}))


def _leave(networks: State, folder: Path, monitor: Monitor) -> None:
    with monitor.writing():
        write_atomically(folder / MODEL, encode(networks))
    if prior := networks.get("imitation"):  # what it is worth, and how far it reaches
        spans = ", ".join(f"{low:.2f} to {high:.2f} on the {name}" for name, (low, high) in prior["range"].items())
        monitor.note(f"the prior is g of step {prior['step']:,}, {_worth(prior)}; it runs from {spans}")


def _worth(policy: Mapping[str, Any]) -> str:
    """Success, where the task has that notion, and return in words."""
    success = "" if policy["success"] is None else f"success {policy['success']:.0%}, "
    return f"{success}mean return {policy['true_return']:,.1f}"


def _restore(fresh: Callable[[], Trainer], checkpoints: Checkpoints, monitor: Monitor) -> Trainer:
    trainer = fresh()

    def restore(state: State) -> None:
        nonlocal trainer
        if trainer.experience.rows:  # a checkpoint that turned out damaged half-way through
            trainer.close()
            trainer = fresh()
        trainer.load(checkpoints.folder, state)

    step = checkpoints.load(restore)
    for damage in checkpoints.skipped:
        monitor.note(f"checkpoint set aside: {damage}")
    if step is not None:
        again = f"; {checkpoints.newest - step:,} steps are trained again" if checkpoints.skipped else ""
        monitor.note(f"continuing from the checkpoint of step {step}{again}")
    elif checkpoints.skipped:
        monitor.note("no usable checkpoint is left: starting again from step 0")
        trainer.close()
        trainer = fresh()
    return trainer
