"""Jobs: what a process is given to do. `rrm.training.kinds` has the table: training a policy, or collecting
demonstrations of one.
"""

from __future__ import annotations

import shutil
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol

import torch

from rrm.checkpoint import KEPT, Checkpoints, check_finite, encode
from rrm.errors import NumericalError, PriorError, WaitingError
from rrm.files import make_folder, write_atomically
from rrm.registry import lookup
from rrm.training.build import DEMOS, Assembled, Results, assemble, result_of
from rrm.training.demonstrate import demonstrate, expert_policy
from rrm.training.demos_config import DemosConfig
from rrm.training.fingerprint import fingerprint
from rrm.training.kinds import JOBS, JobConfig
from rrm.training.loop import Trainer
from rrm.training.run_config import RunConfig
from rrm.types import EvalRow, State

__all__ = ["Monitor", "collect", "fingerprint", "perform", "train"]

_BEAT_S = 0.25
_NOTHING: Results = MappingProxyType({})


class Monitor(Protocol):
    """What a job tells whoever started it, and asks of them."""

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

    def writing(self) -> AbstractContextManager[None]:
        """Around every write into the job's folder; entering it raises where the folder belongs to another by now."""


def perform(config: JobConfig, folder: Path, monitor: Monitor, results: Results = _NOTHING) -> bool:
    """Do the job in `folder`, or go on with it; see `train` and `collect`.

    Args:
        results: folders of the runs that this one requires, by identity.
    """
    does = lookup({config.kind: JOBS[config.kind].perform}, "kind of job", config.kind)
    finished: bool = does(config, folder, monitor, results)
    return finished


def collect(config: DemosConfig, folder: Path, monitor: Monitor, results: Results) -> bool:
    """Have the expert play, and leave its episodes in `folder/demos.safetensors`. A matter of a minute: no checkpoint.

    Returns:
        True when they are there; False when it was told to stop, and will begin anew.

    Raises:
        DemosError: the expert succeeds too rarely.
        MissingResultError: there is no expert.
    """
    torch.set_num_threads(config.threads)
    policy = expert_policy(config.expert, result_of(results, config.expert.identity, "model.safetensors"))

    def stopped(step: int, steps_per_s: float) -> bool:
        monitor.beat(step, steps_per_s)
        return monitor.should_stop()

    source = {"source": "expert", "expert": config.expert.identity, "expert_steps": config.expert.steps}
    demos = demonstrate(
        config.task, policy, config.episodes,
        seed=config.seed, horizon=config.expert.horizon, least_success=config.least_success, source=source,
        stopped=stopped,
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
    results: Results = _NOTHING,
    *,
    checkpoint_every_s: float = 120.0,
    assembled: Assembled = assemble,
) -> bool:
    """Train from the newest checkpoint in `folder`, or from the start, to the end of the run.

    A checkpoint is written after every evaluation and at least every `checkpoint_every_s` seconds; when they are
    written has no influence on the numbers. A finished run leaves its networks in `folder/model.safetensors` and no
    checkpoint. `assembled` makes the run's parts, for those who try one of their own.

    Returns:
        True when the run is finished; False when it was told to stop and can be continued.

    Raises:
        WaitingError: it cannot go on before something has come from outside; it is checkpointed.
        RrmError: what the run was given cannot be run (a prior that fails, numbers that are not finite).
        OSError: a checkpoint could not be written; the ones before are intact.
    """
    torch.set_num_threads(config.threads)
    checkpoints = Checkpoints(folder / "checkpoint")
    with monitor.writing():  # what is damaged is set aside
        make_folder(checkpoints.folder)
        trainer = _restore(lambda: Trainer(config, results, assembled), checkpoints, monitor)
    monitor.restored(trainer.rows)
    session = _Session(trainer, checkpoints, monitor, checkpoint_every_s)
    try:
        finished = session.run()
        if finished:
            left = trainer.legacy()
            with monitor.writing():
                write_atomically(folder / "model.safetensors", encode(left))
            _tell(left.get("imitation"), monitor)
    except (NumericalError, PriorError) as error:
        saved, step = session.saved_step, trainer.step
        last = f"the last good checkpoint is of step {saved:,}" if saved else "no checkpoint yet"
        where = "" if f"step {step}" in str(error) else f"at step {step:,}; "
        raise type(error)(f"{error} ({where}{last})") from error
    finally:
        trainer.close()
    if finished:
        with monitor.writing():
            shutil.rmtree(checkpoints.folder)
    return finished


def _tell(prior: State | None, monitor: Monitor) -> None:
    """Say what an imitation prior is worth, and how far it reaches."""
    if prior is None:
        return
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
        if trainer.experience.transitions:  # a checkpoint that turned out damaged half-way through
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


class _Session:
    """One process' share of a run: steps until the end or until told to stop."""

    def __init__(self, trainer: Trainer, checkpoints: Checkpoints, monitor: Monitor, checkpoint_every_s: float) -> None:
        self.trainer = trainer
        self.checkpoints = checkpoints
        self.monitor = monitor
        self.checkpoint_every_s = checkpoint_every_s
        self._saved_at = time.monotonic()
        self.saved_step = trainer.step
        self._generations = deque([trainer.experience.generation], maxlen=KEPT)  # of the checkpoints that are kept

    def run(self) -> bool:
        trainer, config = self.trainer, self.trainer.config
        beat_at, beat_step = time.monotonic(), trainer.step
        while trainer.step < config.steps:
            try:
                trainer.advance()
            except WaitingError:
                self._save()
                raise
            if trainer.step % config.evaluation.every == 0 or trainer.step == config.steps:
                self.monitor.row(trainer.evaluate())
                with self.monitor.writing():
                    trainer.publish(self.checkpoints.folder.parent)
                self._save()
            now = time.monotonic()
            if now - beat_at >= _BEAT_S:
                self.monitor.beat(trainer.step, (trainer.step - beat_step) / (now - beat_at))
                beat_at, beat_step = now, trainer.step
            if self.monitor.should_stop():
                break
            if now - self._saved_at >= self.checkpoint_every_s:
                self._save()
        if trainer.step < config.steps and self.saved_step != trainer.step:
            self._save()
        return trainer.step == config.steps

    def _save(self) -> None:
        trainer = self.trainer
        check_finite(trainer.weights())
        if trainer.step == trainer.config.steps:
            return  # the run is over; its networks are written instead
        with self.monitor.writing():
            state = trainer.save(self.checkpoints.folder)
            self.checkpoints.save(trainer.step, state)
            self._generations.append(trainer.experience.generation)
            trainer.experience.discard(self.checkpoints.folder, self._generations)
        self._saved_at, self.saved_step = time.monotonic(), trainer.step
