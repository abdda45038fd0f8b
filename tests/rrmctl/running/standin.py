"""A worker with a trainer that trains nothing: real process, real store, and every way to end that a test needs.

What a run does is said in the environment variable STANDIN: a JSON object from seed (as text) to behaviour, with
"other" for seeds it does not name. It happens five steps after half the run, between two checkpoints; "gate" means
to wait there for a file `go` in the results root. STANDIN_TELL names variables that a run notes before it begins;
STANDIN_HOST the machine that it lives on, see `live_on`.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from rrm.config import EvaluationConfig, ExplorationConfig, RewardConfig
from rrm.errors import PriorError, WaitingError
from rrm.teachers.labels import read_labels
from rrm.training.run_config import RunConfig
from rrm.tuning import OTHERWISE, Choice
from rrm.types import EvalRow
from rrmctl.running import parent_link, worker
from rrmctl.running.config_file import config_content
from rrmctl.running.monitor import RunMonitor
from rrmctl.store import lease, owner
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.provenance import record_config
from rrmctl.store.sweeps import Job, SweepRecord, record_sweep

COMMAND = (sys.executable, __file__)
STEP_S = 0.002


def live_on(host: str, set_: Callable[[Any, str, Any], None] = setattr) -> None:
    """Have this process live on a machine of that name, whose locks are not seen on others."""
    set_(owner, "HERE", owner.Machine(host, f"boot of {host}"))
    set_(lease, "BEAT_S", 0.2)
    for name in ("lock", "guard"):
        set_(RunFolder, name, property(lambda folder, name=name: folder.path / f"{name} of {host}"))


if "STANDIN_HOST" in os.environ:
    live_on(os.environ["STANDIN_HOST"])


def config(seed: int, steps: int = 40, every: int = 10, device: str = "cpu") -> RunConfig:
    return RunConfig(
        task="toy-car", seed=seed, steps=steps, device=device, reward=RewardConfig(learner="true"),
        evaluation=EvaluationConfig(every=every), exploration=ExplorationConfig(seed_steps=0),
    )  # fmt: skip


def prepare(
    root: Path, seeds: range, steps: int = 40, every: int = 10, on_cards: Collection[int] = ()
) -> tuple[Layout, list[Job]]:
    """A results folder in which a sweep over these seeds is recorded, and its jobs."""
    layout = Layout(root)
    configs = [config(seed, steps, every, "cuda" if seed in on_cards else "cpu") for seed in seeds]
    for each in configs:
        record_config(layout.run(each.identity), config_content(each))
    jobs = tuple(
        Job(
            id=each.identity, cell=each.cell, task="toy-car", method="oracle", teacher="-", feedback="-",
            seed=each.seed, steps=steps,
        )
        for each in configs
    )  # fmt: skip
    record_sweep(layout, SweepRecord(experiment="stand-in", variant="smoke", profile="smoke", jobs=jobs))
    return layout, list(jobs)


def expected(seeds: range, steps: int = 40, every: int = 10) -> list[tuple[int, int, float]]:
    """Seed, step and return of every row of an undisturbed sweep."""
    return [(seed, step, row(step, seed).true_return) for seed in seeds for step in range(every, steps + 1, every)]


def row(step: int, seed: int = 0, **changes: float) -> EvalRow:
    """The evaluation of a policy that knows its step and seed alone."""
    values: dict[str, Any] = {name: float("nan") for name in EvalRow.__dataclass_fields__ if name != "figures"}
    values |= {"step": step, "episodes": 10, "queries": 0, "labels": 0, "wall_s": 1.0, "steps_per_s": 100.0}
    values |= {"true_return": seed * 1000.0 + step, "success": 0.5}
    return EvalRow(**(values | changes))


class OutOfMemoryError(RuntimeError):
    """As torch calls its own."""


class Trainer:
    """Counts steps and keeps the count in a checkpoint."""

    def fingerprint(self, config: RunConfig) -> dict[str, str]:
        return {"toy-car": os.environ.get("STANDIN_WORLD", "1")}

    def choose_products(self, earlier: Choice | None) -> Choice:
        return earlier or {OTHERWISE: "torch"}

    def perform(self, config: RunConfig, folder: Path, monitor: RunMonitor, results: dict[str, Path]) -> bool:
        behaviours = json.loads(os.environ.get("STANDIN", "{}"))
        behaviour = behaviours.get(str(config.seed), behaviours.get("other", "train"))
        checkpoint = folder / "checkpoint" / "step"
        checkpoint.parent.mkdir(exist_ok=True)
        step = int(checkpoint.read_text()) if checkpoint.exists() else 0
        monitor.note(f"from step {step}")
        for name in os.environ.get("STANDIN_TELL", "").split():
            monitor.note(f"{name}={os.environ.get(name)}")
        while step < config.steps:
            time.sleep(STEP_S)
            step += 1
            monitor.beat(step, 100.0)
            if step % config.evaluation.every == 0:
                monitor.row(row(step, config.seed))
                if step < config.steps:
                    with monitor.writing():
                        save(checkpoint, step)
            if step == config.steps // 2 + 5 and behaviour != "train":
                misbehave(behaviour, folder, monitor)
            if monitor.should_stop():
                with monitor.writing():
                    save(checkpoint, step)
                return False
        with monitor.writing():
            (folder / "model.safetensors").write_bytes(b"")
            checkpoint.unlink(missing_ok=True)
        return True


def save(path: Path, step: int) -> None:
    path.with_suffix(".tmp").write_text(str(step))
    path.with_suffix(".tmp").replace(path)


def misbehave(behaviour: str, folder: Path, monitor: RunMonitor) -> None:
    first = not (folder / "misbehaved").exists()
    (folder / "misbehaved").touch()
    match behaviour:
        case "gate":
            while not (folder.parents[1] / "go").exists() and not monitor.should_stop():
                time.sleep(0.02)
        case "exit":
            os._exit(0)
        case "crash":
            raise RuntimeError("boom")
        case "crash-once" if first:
            raise RuntimeError("boom, but once")
        case "wait" if not (folder.parents[1] / "answers").exists():
            with monitor.writing():
                save(folder / "checkpoint" / "step", monitor.status.step)
            raise WaitingError("3 answers of its teacher")
        case "ask" if not any(label.sealed for label in read_labels(folder / "labels.parquet")):
            with monitor.writing():
                save(folder / "checkpoint" / "step", monitor.status.step - 1)
                shutil.copytree(folder.parents[1] / "asked" / folder.name, folder, dirs_exist_ok=True)
            raise WaitingError("3 answers of its teacher")
        case "card-full":
            raise OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB. Of the allocated memory 1 GiB is")
        case "refuse":
            raise PriorError("prior returned NaN at step 20")
        case "segfault":
            os.kill(os.getpid(), signal.SIGSEGV)
        case "full":
            raise OSError(errno.ENOSPC, "No space left on device", str(folder / "checkpoint"))
        case "hang":
            while True:
                with contextlib.suppress(InterruptedError):
                    time.sleep(60)
        case "stuck":
            re.match(r"(a+)+$", "a" * 60 + "b")  # for ages, and no other thread runs meanwhile
        case "leak" if first:
            leak = bytearray(300 * 2**20)
            leak[::4096] = b"x" * len(leak[::4096])
            time.sleep(60)
        case "orphan":
            child = subprocess.Popen(["sleep", "600"])
            (folder / "orphan").write_text(str(child.pid))
            os.kill(os.getpid(), signal.SIGKILL)


if __name__ == "__main__":
    # Orphans that hang are ended the sooner: this signal's number is 10, for as many seconds.
    parent_link._ORPHANED, parent_link._GRACE_S = signal.SIGUSR1, 30.0
    sys.exit(worker.main(trainer=Trainer()))
