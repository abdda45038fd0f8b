"""On a graphics card: updates beside Stable-Baselines3's, whole loops of one run and of many, and reward learning.

All of it waits for the card: times are those of the clock. Nothing is measured where no card can be used, and that is
said.
"""

from __future__ import annotations

import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import nullcontext
from functools import partial
from importlib.util import find_spec
from typing import Self

import numpy as np
import torch

from benchmarks import drqv2_update
from benchmarks.lines import Line
from benchmarks.reward_learning import ROWS, SEGMENT, labelled, lived
from benchmarks.sac_update import ACT, OBS, random_batch, stable_baselines
from rrm import devices
from rrm.agents.drqv2 import Drq
from rrm.agents.sac import Sac
from rrm.config import DrqConfig, RewardConfig, SacConfig
from rrm.envs import Spaces
from rrm.nets.captured import prepare
from rrm.precision import Precision
from rrm.rewards.ensemble import ResidualReward
from rrm.rewards.pebble import Pebble
from rrm.seeding import Streams
from rrm.training.loop import Trainer
from rrm.training.run_config import RunConfig
from rrm.types import Batch
from rrmctl.running.cards import REPEATABLE, names
from rrmctl.running.local import worker_environment
from rrmctl.running.mps import service

DEVICE = "cuda"
LABELS = 5_000
_AT_ONCE = 50  # updates between two moments at which the card is waited for
_LOOP_S = 4.0
_WORKERS = (4, 8, 16)  # at a time


def lines() -> Iterator[Line]:
    """Updates, loops, reward learning."""
    if why := devices.missing():
        print(f"not measured: {why}", file=sys.stderr)
        return
    print(f"{devices.in_words(devices.cards()[0])}, driver {devices.driver_version()}", file=sys.stderr)
    yield from _updates()
    yield from _reward_learning()
    yield from _loops()


def _updates() -> Iterator[Line]:
    config = SacConfig()
    for precision in ("float32", "tf32", "bfloat16"):
        prepare(DEVICE, precision)
        updates = {"ours": _ours(config, precision)}
        if precision == "float32" and find_spec("stable_baselines3"):
            torch.use_deterministic_algorithms(False)  # it does not ask for that
            updates["Stable-Baselines3"] = partial(stable_baselines(config, DEVICE).train, _AT_ONCE, config.batch)
        ours, *peers = (_AT_ONCE / took for took in in_turns(*updates.values()))
        yield Line(
            item=f"SAC update on a card, batch {config.batch}, {config.hidden} x {config.layers}, {precision}",
            ours=ours, unit="/s", peers=dict(zip(list(updates)[1:], peers, strict=True)),
            least_ratio=8 if peers else None, bound=2000 if precision == "float32" else None,
        )  # fmt: skip
    yield from _seeing()


def _seeing() -> Iterator[Line]:
    """Of DrQ-v2, by windows that are on the card."""
    config = DrqConfig(kind="drqv2")
    for precision in ("float32", "bfloat16"):
        prepare(DEVICE, precision)
        agent = Drq(
            config, Spaces(1, drqv2_update.ACT, drqv2_update.FRAMES), Streams(0), precision=precision, device=DEVICE
        )
        (took,) = in_turns(partial(_often, agent.update, _there(drqv2_update.random_batch(config))))
        item = f"DrQ-v2 update on a card, batch {config.batch}, {config.channels} channels, {precision}"
        yield Line(item=item, ours=1e3 * took / _AT_ONCE, unit="ms")


def _ours(config: SacConfig, precision: Precision) -> Callable[[], None]:
    sac = Sac(config, Spaces(OBS, ACT), Streams(0), precision=precision, device=DEVICE)
    return partial(_often, sac.update, _there(random_batch(config.batch)))


def _there(batch: Batch) -> Batch:
    return Batch(*(None if part is None else part.to(DEVICE) for part in batch))


def _often(update: Callable[[Batch], None], batch: Batch) -> None:
    for _ in range(_AT_ONCE):
        update(batch)


def in_turns(*works: Callable[[], object], turns: int = 5) -> list[float]:
    """Median seconds of the clock until the card has done each, timed in turns after a warm-up."""

    def timed(work: Callable[[], object]) -> float:
        torch.cuda.synchronize()
        start = time.perf_counter()
        work()
        torch.cuda.synchronize()
        return time.perf_counter() - start

    for work in works:
        work()
    rounds = [[timed(work) for work in works] for _ in range(turns)]
    return [statistics.median(column) for column in zip(*rounds, strict=True)]


def _reward_learning() -> Iterator[Line]:
    prepare(DEVICE, "float32")
    config = RewardConfig(epochs=1, target_accuracy=1.0)
    experience = lived(DEVICE)
    reward = ResidualReward(config, OBS, ACT, torch.Generator().manual_seed(0), device=DEVICE)
    learner, labels = Pebble(reward, config, np.random.default_rng(0)), labelled(experience, LABELS)
    epoch_s, relabel_s = in_turns(lambda: learner.fit(labels), lambda: experience.relabel(reward.predict), turns=3)
    item = f"reward epoch on a card, {LABELS:,} labels of {SEGMENT} steps"
    yield Line(item=item, ours=epoch_s, unit="s", bound=0.5)
    yield Line(item=f"relabelling {ROWS:,} transitions on a card", ours=relabel_s, unit="s", bound=0.2)


def _loops() -> Iterator[Line]:
    """The oracle on button-press, one run and many of them."""
    item = "oracle loop on button-press, on a card"
    for mps in (False, True) if shutil.which("nvidia-cuda-mps-control") else (False,):
        with service(names(1)) if mps else nullcontext({}) as variables, _Loops(max(_WORKERS), variables) as loops:
            by = ", by MPS" if mps else ""
            alone, memory = loops.together(1)
            bound, note = None if mps else 900, f"{memory:.0f} MiB"
            yield Line(item=f"{item}{by}", ours=alone, unit="/s", bound=bound, note=note)
            for workers in _WORKERS:
                least = 6 if mps and workers == max(_WORKERS) else None
                rate, _ = loops.together(workers)
                peers = {"one": alone}
                yield Line(item=f"{workers} of them{by}", ours=rate, unit="/s", peers=peers, least_ratio=least)


class _Loops:
    """Processes that are each ready to go on with a run of their own."""

    def __init__(self, count: int, variables: Mapping[str, str]) -> None:
        environment = {**worker_environment(1), **REPEATABLE, **variables}
        self._processes = [
            subprocess.Popen(
                [sys.executable, "-m", "benchmarks.cards", str(seed)],
                env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            )
            for seed in range(count)
        ]  # fmt: skip

    def __enter__(self) -> Self:
        for process in self._processes:
            self._told(process)  # it is ready
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._processes:
            process.communicate()

    @staticmethod
    def _told(process: subprocess.Popen[str]) -> list[float]:
        assert process.stdout is not None
        return list(map(float, process.stdout.readline().split()))

    def together(self, count: int) -> tuple[float, float]:
        """Steps a second of so many of them at a time, and MiB of the card that one reserves."""
        for process in self._processes[:count]:
            assert process.stdin is not None
            process.stdin.write("go\n")
            process.stdin.flush()
        told = [self._told(process) for process in self._processes[:count]]
        return sum(rate for rate, _ in told), told[0][1]


def _loop(seed: int) -> None:
    """One process of `_Loops`: as often as it is told to, so many seconds of a run."""
    torch.set_num_threads(1)
    config = RunConfig(
        task="button-press", seed=seed, steps=500_000, device=DEVICE, reward=RewardConfig(learner="true")
    )
    trainer = Trainer(config)
    while trainer.step < config.random_steps + 100:
        trainer.advance()
    print(flush=True)
    for _ in sys.stdin:
        steps, begin = 0, time.perf_counter()
        while time.perf_counter() < begin + _LOOP_S:
            trainer.advance()
            steps += 1
        torch.cuda.synchronize()
        print(steps / (time.perf_counter() - begin), torch.cuda.max_memory_reserved() / 2**20, flush=True)
    trainer.close()


if __name__ == "__main__":
    _loop(int(sys.argv[1]))
