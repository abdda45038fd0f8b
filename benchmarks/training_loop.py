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
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import torch

from benchmarks.lines import Line, in_turns
from rrm.checkpoint import Checkpoints
from rrm.config import RewardConfig
from rrm.nets.precision import multiplies
from rrm.nets.products import choice, using
from rrm.precision import Precision
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


def lines() -> Iterator[Line]:
    """Loop, shares, checkpoint, memory, start of a worker."""
    torch.set_num_threads(1)
    for precision in ("float32", "bfloat16") if multiplies("bfloat16") else ("float32",):
        yield from _loop(precision)
    for method in ("oracle", "rrm-proxy"):
        yield _laptop(method)
    yield Line(item=f"resident memory, {_MEMORY_STEPS:,} steps", ours=_apart("memory"), unit="MiB", bound=1024)
    starts = [_timed_start() for _ in range(3)]
    yield Line(item="worker, start to first step", ours=statistics.median(starts), unit="s", bound=5)


def _loop(precision: Precision) -> Iterator[Line]:
    trainer = mid_run(STEPS, STEPS // 2, precision)
    session_s = _session_seconds(trainer)
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
        checkpoint_s = _checkpoint_seconds(trainer, steps=int(CHECKPOINT_S / whole_s))
        yield Line(
            item="checkpoint, of training time", ours=100 * checkpoint_s / CHECKPOINT_S, unit="%", bound=1,
            note=f"{1e3 * checkpoint_s:.0f} ms every {CHECKPOINT_S:.0f} s",
        )  # fmt: skip
    trainer.close()


def _laptop(method: str) -> Line:
    """Steps a second of a shipped run, sessions among them."""
    manifest = load(SHIPPED / "main-results.toml")
    (config,) = make_plan(manifest, profile="laptop", seeds=1, tasks=[TASK], methods=[method]).configs.values()
    assert isinstance(config, RunConfig)
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


def mid_run(steps: int, transitions: int, precision: Precision, folder: Path | None = None) -> Trainer:
    """A trainer of `steps` steps, `transitions` of them lived (and saved in the folder now and then, as a run does),
    right before a feedback session.
    """
    config = RunConfig(task=TASK, seed=0, steps=steps, precision=precision, reward=RewardConfig(prior="proxy"))
    trainer = Trainer(config)
    for _ in range(min(REAL_STEPS, config.first_session)):
        trainer.advance()
    real = trainer.experience
    count = real.transitions
    for step in range(count, transitions):
        row = int(real._row_of[step % count])
        again = Transition(
            obs=real.obs[row].numpy(), act=real.act[row].numpy(), prior=float(real.prior[row]), raw_prior=0.0,
            true_reward=float(real.true_reward[row]), next_obs=real.obs[row + 1].numpy(),
            terminated=False, truncated=step % 500 == 499,
        )  # fmt: skip
        real.append(again, 0.0)
        if folder is not None and step % EVERY == 0:
            real.save(folder)
    while _preferences(trainer).queries < LABELS:
        _label_only(trainer, 500)
    trainer.step = config.first_session + EVERY * (transitions // EVERY)
    return trainer


def _label_only(trainer: Trainer, count: int) -> None:
    """Labels without the training that goes with them."""
    from rrm.queries import uniform_pairs

    source, experience = _preferences(trainer), trainer.experience
    assert trainer.config.feedback is not None
    length = trainer.config.feedback.segment
    pairs = uniform_pairs(experience.episodes, length, count, np.random.default_rng(source.queries))
    source.teacher.ask(source.journal.ask(experience, pairs, length, 0))
    assert source.waiting() is None
    source.preferences.add(*source.journal.apply(0))


def _session_seconds(trainer: Trainer) -> float:
    """The third of three sessions: the reward has learned the older labels by then, as it has in a run."""
    for number in range(3):
        start = time.process_time()
        _hold(trainer, trainer.step + number * EVERY)
        seconds = time.process_time() - start
    return seconds


def _preferences(trainer: Trainer) -> PreferenceReward:
    source = trainer.sources["preferences"]
    assert isinstance(source, PreferenceReward)
    return source


def _hold(trainer: Trainer, step: int) -> None:
    """The session that is due before this step."""
    source = _preferences(trainer)
    source.ask(step)
    assert source.waiting() is None
    source.attend(step, trainer.agent)


def _simulate(trainer: Trainer, act: np.ndarray) -> None:
    if trainer.env.step(act)[3]:
        trainer.env.reset()


def _append(trainer: Trainer, act: np.ndarray) -> None:
    trainer.experience.append(Transition(trainer._obs.state, act, trainer._obs.state, 0.0, 0.0, 0.0, False, False), 0.0)


def _median_of(work: Callable[[], object], calls: int) -> float:
    times = []
    for _ in range(calls):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def _checkpoint_seconds(trainer: Trainer, steps: int) -> float:
    """A checkpoint after as many steps as the interval holds, with a relabelling among them."""
    with tempfile.TemporaryDirectory() as name:
        checkpoints = Checkpoints(Path(name))
        checkpoints.save(trainer.step, trainer.save(checkpoints.folder))
        seconds = []
        for _ in range(3):
            for _ in range(steps):
                _append(trainer, np.zeros(4, np.float32))
            _preferences(trainer).relabel()
            trainer.step += steps
            start = time.perf_counter()
            checkpoints.save(trainer.step, trainer.save(checkpoints.folder))
            seconds.append(time.perf_counter() - start)
    return statistics.median(seconds)


def _apart(what: str) -> float:
    """A figure measured in a process of its own."""
    found = subprocess.run(
        [sys.executable, "-m", "benchmarks.training_loop", what], check=True, capture_output=True, text=True
    )
    return float(found.stdout)


def _timed_start() -> float:
    start = time.perf_counter()
    _apart("start")
    return time.perf_counter() - start


def _memory() -> float:
    """Largest resident size in MiB of a run near its end: stored, learned from, saved, and restored by a successor."""
    with tempfile.TemporaryDirectory() as name:
        checkpoints = Checkpoints(Path(name))
        trainer = mid_run(_MEMORY_STEPS, _MEMORY_STEPS - 10_000, "float32", checkpoints.folder)
        trainer.advance()
        _hold(trainer, trainer.step + EVERY - trainer.step % EVERY)
        checkpoints.save(trainer.step, trainer.save(checkpoints.folder))
        config = trainer.config
        trainer.close()
        del trainer
        gc.collect()
        successor = Trainer(config)
        checkpoints.load(lambda state: successor.load(checkpoints.folder, state))
        successor.advance()
        successor.close()
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


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
