"""The whole PEBBLE loop on Meta-World in the middle of a run of the paper's size, and what surrounds it.

The state of mid-run is made quickly: real steps of random actions, repeated until half of the run's transitions are
there, and 2,500 labels by the scripted teacher on them. The loop's rate counts acting, simulation, storing, the update
of every step, and one feedback session (queries, teacher, epochs until the labels are learned, relabelling) every
5,000 steps. Its floor is the rate at which the update alone would run.

At the laptop profile's scale the loop is taken from the first session on, as it is, beside itself with torch's own
products.
"""

from __future__ import annotations

import gc
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch

from benchmarks.lines import Line, apart, in_turns, peak_mib
from rrm.buffers.experience import Experience
from rrm.checkpoint import Checkpoints
from rrm.config import RewardConfig
from rrm.nets.precision import multiplies
from rrm.nets.products import choice, using
from rrm.precision import Precision
from rrm.queries import uniform_pairs
from rrm.sources.preferences import PreferenceReward
from rrm.training.loop import Trainer
from rrm.training.run_config import RunConfig
from rrm.tuning import OTHERWISE, Choice
from rrm.types import Transition
from rrmctl.planning.experiments import SHIPPED
from rrmctl.planning.manifest import load
from rrmctl.planning.plan import make_plan

TASK, STEPS, EVERY, LABELS = "button-press", 500_000, 5_000, 2_500
REAL_STEPS = 5_000
CHECKPOINT_S = 120.0  # the default interval
_MEMORY_STEPS = 1_000_000
_LAPTOP_STEPS = 2_500  # from one session to the next
_HERE = "benchmarks.training_loop"


def lines() -> Iterator[Line]:
    """Loop, shares, checkpoint, memory, start of a worker."""
    torch.set_num_threads(1)
    for precision in ("float32", "bfloat16") if multiplies("bfloat16") else ("float32",):
        yield from _loop(precision)
    for method in ("oracle", "rrm-proxy"):
        yield _laptop(method)
    yield Line(item=f"resident memory, {_MEMORY_STEPS:,} steps", ours=apart(_HERE, "memory")[0], unit="MiB", bound=1024)
    starts = [_timed_start() for _ in range(3)]
    yield Line(item="worker, start to first step", ours=statistics.median(starts), unit="s", bound=5)


def _loop(precision: Precision) -> Iterator[Line]:
    trainer = mid_run(paper_run(STEPS, precision), STEPS // 2, LABELS)
    session_s = session_seconds(trainer)
    batch = _preferences(trainer).batch(trainer.agent)
    step_s, update_s = in_turns(trainer.advance, lambda: trainer.agent.update(batch), turns=7, budget=1.0)
    act = np.zeros(4, np.float32)
    simulate_s = _median_of(lambda: _simulate(trainer, act), 200)
    append_s = _median_of(lambda: _append(trainer, act), 200)
    sample_s = _median_of(lambda: _preferences(trainer).batch(trainer.agent), 200)
    whole_s = step_s + session_s / EVERY
    yield Line(
        item=f"PEBBLE loop, {precision}", ours=1 / whole_s, unit="/s", floor=1 / update_s,
        least_share=0.80 if precision == "float32" else None,
        note=f"session {session_s:.1f} s, step {1e3 * step_s:.1f} ms, update {1e3 * update_s:.1f} ms",
    )  # fmt: skip
    yield Line(
        item=f"simulation, insertion and sampling, of the loop, {precision}", unit="%",
        ours=100 * (simulate_s + append_s + sample_s) / whole_s, bound=5 if precision == "float32" else None,
    )  # fmt: skip
    if precision == "float32":
        checkpoint_s = checkpoint_seconds(trainer, steps=int(CHECKPOINT_S / whole_s))
        yield Line(
            item="checkpoint, of training time", ours=100 * checkpoint_s / CHECKPOINT_S, unit="%", bound=1,
            note=f"{1e3 * checkpoint_s:.0f} ms every {CHECKPOINT_S:.0f} s",
        )  # fmt: skip
    trainer.close()


def _laptop(method: str) -> Line:
    """Steps a second of a shipped run, sessions among them."""
    config = shipped(method)
    loops = [_LaptopLoop(config, chosen) for chosen in (choice(), {OTHERWISE: "torch"})]
    ours_s, torch_s = in_turns(*loops, turns=3, budget=0)
    for loop in loops:
        loop.trainer.close()
    return Line(
        item=f"loop on {TASK}, laptop, {method}", ours=_LAPTOP_STEPS / ours_s, unit="/s",
        peers={"torch's products": _LAPTOP_STEPS / torch_s},
    )  # fmt: skip


class _LaptopLoop:
    """A run from its first update on, a session's interval at a call, with products by this choice."""

    def __init__(self, config: RunConfig, chosen: Choice) -> None:
        self.trainer, self._chosen = Trainer(config), chosen
        begin = config.first_session if config.feedback else config.random_steps
        self(begin + 1)

    def __call__(self, steps: int = _LAPTOP_STEPS) -> None:
        with using(self._chosen):
            for _ in range(steps):
                self.trainer.advance()


def paper_run(steps: int, precision: Precision = "float32") -> RunConfig:
    """PEBBLE on a prior with the paper's settings, so long."""
    return RunConfig(task=TASK, seed=0, steps=steps, precision=precision, reward=RewardConfig(prior="proxy"))


def shipped(method: str, task: str = TASK, profile: str = "laptop") -> RunConfig:
    """A run of `main-results`."""
    manifest = load(SHIPPED / "main-results.toml")
    (config,) = make_plan(manifest, profile=profile, seeds=1, tasks=[task], methods=[method]).configs.values()
    assert isinstance(config, RunConfig)
    return config


def mid_run(
    config: RunConfig, transitions: int, labels: int = 0, *, real: int = REAL_STEPS, folder: Path | None = None
) -> Trainer:
    """A trainer with so many transitions and labels, right before a feedback session.

    Args: real: transitions that are lived; they are repeated. folder: where they are saved now and then, as in a run.
    """
    trainer, repeat = Trainer(config), config.action_repeat
    begin = config.first_session if config.feedback else config.random_steps
    for _ in range(min(real, begin // repeat)):
        trainer.advance()
    lived, length = trainer.experience, config.episode_steps // repeat
    again = [_stored(lived, number) for number in range(lived.transitions)]
    for number in range(len(again), transitions):
        ends = number % length == length - 1
        lived.append(again[number % len(again)]._replace(truncated=ends), 0.0)
        if folder is not None and number % EVERY == 0:
            lived.save(folder)
    while labels and _preferences(trainer).queries < labels:
        _label_only(trainer, min(500, labels))
    every = config.feedback.every if config.feedback else repeat
    trainer.step = begin + every * (transitions * repeat // every)
    return trainer


def _stored(lived: Experience, number: int) -> Transition:
    """A transition as it was appended."""
    row, pictures = int(lived._row_of[number]), lived.batch(torch.tensor([number])).frames
    obs, act, next_obs = lived.obs[row].numpy(), lived.act[row].numpy(), lived.obs[row + 1].numpy()
    prior, true = float(lived.prior[row]), float(lived.true_reward[row])
    seen = (None, None) if pictures is None else (pictures[0, :-1].numpy(), pictures[0, 1:].numpy())
    return Transition(obs, act, next_obs, prior, 0.0, true, False, False, *seen)


def _label_only(trainer: Trainer, count: int) -> None:
    """Labels without the training that goes with them."""
    source, experience = _preferences(trainer), trainer.experience
    assert trainer.config.feedback is not None
    length = trainer.config.feedback.segment // trainer.config.action_repeat
    pairs = uniform_pairs(experience.episodes, length, count, np.random.default_rng(source.queries))
    source.teacher.ask(source.journal.ask(experience, pairs, length, 0))
    assert source.waiting() is None
    source.preferences.add(*source.journal.apply(0))


def session_seconds(trainer: Trainer) -> float:
    """The third of three sessions: the reward has learned the older labels by then, as it has in a run."""
    assert trainer.config.feedback is not None
    every = trainer.config.feedback.every
    for number in range(3):
        start = time.process_time()
        hold(trainer, trainer.step + number * every)
        seconds = time.process_time() - start
    return seconds


def _preferences(trainer: Trainer) -> PreferenceReward:
    source = trainer.sources["preferences"]
    assert isinstance(source, PreferenceReward)
    return source


def hold(trainer: Trainer, step: int) -> None:
    """The session that is due before this step."""
    source = _preferences(trainer)
    source.ask(step)
    assert source.waiting() is None
    source.attend(step, trainer.agent)


def _simulate(trainer: Trainer, act: np.ndarray) -> None:
    if trainer.env.step(act)[3]:
        trainer.env.reset()


def _append(trainer: Trainer, act: np.ndarray) -> None:
    obs = trainer._obs
    step = Transition(obs.state, act, obs.state, 0.0, 0.0, 0.0, False, False, obs.frames, obs.frames)
    trainer.experience.append(step, 0.0)


def _median_of(work: Callable[[], object], calls: int) -> float:
    times = []
    for _ in range(calls):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def checkpoint_seconds(trainer: Trainer, steps: int) -> float:
    """A checkpoint after as many steps as the interval holds, with a relabelling among them."""
    with tempfile.TemporaryDirectory() as name:
        checkpoints = Checkpoints(Path(name))
        checkpoints.save(trainer.step, trainer.save(checkpoints.folder))
        seconds = []
        for _ in range(3):
            for _ in range(steps):
                _append(trainer, np.zeros(trainer.config.spaces.act, np.float32))
            _preferences(trainer).relabel()
            trainer.step += steps
            start = time.perf_counter()
            checkpoints.save(trainer.step, trainer.save(checkpoints.folder))
            seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def _timed_start() -> float:
    start = time.perf_counter()
    apart(_HERE, "start")
    return time.perf_counter() - start


def _memory() -> float:
    """Largest resident size in MiB of a run near its end: stored, learned from, saved, and restored by a successor."""
    with tempfile.TemporaryDirectory() as name:
        checkpoints = Checkpoints(Path(name))
        trainer = mid_run(paper_run(_MEMORY_STEPS), _MEMORY_STEPS - 10_000, LABELS, folder=checkpoints.folder)
        trainer.advance()
        hold(trainer, trainer.step + EVERY - trainer.step % EVERY)
        checkpoints.save(trainer.step, trainer.save(checkpoints.folder))
        config = trainer.config
        trainer.close()
        del trainer
        gc.collect()
        successor = Trainer(config)
        checkpoints.load(lambda state: successor.load(checkpoints.folder, state))
        successor.advance()
        successor.close()
    return peak_mib()


def _start() -> float:
    """From nothing to the first step of a run."""
    from rrm.training import jobs  # noqa: F401 (what a worker loads)

    trainer = Trainer(RunConfig(task=TASK, seed=0, steps=STEPS, reward=RewardConfig(prior="proxy")))
    trainer.advance()
    trainer.close()
    return 0.0


if __name__ == "__main__":
    torch.set_num_threads(1)
    print({"memory": _memory, "start": _start}[sys.argv[1]]())
