"""Many short jobs, twenty workers, one of them killed every second; with readers that never rest, and without."""

from __future__ import annotations

import contextlib
import os
import random
import re
import resource
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.errors import Exit
from rrmctl.running.pool import Assignment, Pool
from rrmctl.store import load, planned
from rrmctl.store.reader import run_status
from rrmctl.store.records import State, read_status
from tests.rrmctl.running.standin import COMMAND, STEP_S, expected, prepare
from tests.rrmctl.running.test_pool import Record, rows

pytestmark = pytest.mark.slow

WORKERS, EVALUATIONS = 20, 4


@dataclass
class Storm:
    """A sweep of jobs that all take as long, and what becomes of it.

    Args:
        steps: of each job, `STEP_S` seconds each.
    """

    root: Path
    jobs: int
    steps: int
    killed: int = 0  #: workers
    wall_s: float = 0.0
    cpu_s: float = 0.0  #: of the workers, who only sleep: all of it is what running jobs costs
    _rng: random.Random = field(default_factory=lambda: random.Random(0))

    def __post_init__(self) -> None:
        self.every = self.steps // EVALUATIONS
        self.layout, self.assigned = prepare(self.root, range(self.jobs), self.steps, self.every)

    def kill_one(self) -> None:
        """A worker, after a second."""
        time.sleep(1.0)
        states = [run_status(self.layout.run(job.id)) for job in self.assigned]
        if pids := [each.pid for each in states if each.state is State.RUNNING and each.pid is not None]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._rng.choice(pids), signal.SIGKILL)
                self.killed += 1

    def survive(self, *readers: Callable[[], object]) -> None:
        """Run it under fire: all end, none twice, every row is there, and no reader sees an error."""
        watcher = Record()
        pool = Pool(
            layout=self.layout, assignments=self.assigned, slots=WORKERS, watcher=watcher, command=COMMAND
        )  # fmt: skip
        began, cpu = time.monotonic(), _children_cpu_s()
        with endlessly(self.kill_one, *readers) as errors:
            code = pool.run()
            self.wall_s, self.cpu_s = time.monotonic() - began, _children_cpu_s() - cpu
        assert errors == []
        assert code is Exit.DONE, set(watcher.errors)
        assert rows(self.root) == expected(range(self.jobs), self.steps, self.every)
        assert self.killed > 5
        assert self.jobs <= sum(map(self._attempts_of_one_end, self.assigned)) <= self.jobs + self.killed

    def _attempts_of_one_end(self, job: Assignment) -> int:
        folder = self.layout.run(job.id)
        ends = re.findall(r"^--- done at step", folder.log.read_text(), re.MULTILINE)
        assert len(ends) <= 1  # none if it was killed when all was written but this line
        return read_status(folder).attempt


def _children_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


@contextlib.contextmanager
def endlessly(*actions: Callable[[], object]) -> Iterator[list[BaseException]]:
    """Repeat each action in a thread beside the block; gives the errors that ended them."""
    stop, errors = threading.Event(), list[BaseException]()

    def repeat(action: Callable[[], object]) -> None:
        try:
            while not stop.is_set():
                action()
                time.sleep(0.05)
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=repeat, args=(action,)) for action in actions]
    for thread in threads:
        thread.start()
    try:
        yield errors
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def test_a_hundred_jobs_of_a_second(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What the orchestration costs is printed."""
    storm = Storm(tmp_path, jobs=100, steps=int(1 / STEP_S))
    storm.survive()
    starts = sum(read_status(storm.layout.run(job.id)).attempt for job in storm.assigned)
    told = (
        f"{storm.jobs} jobs of 1 s, {WORKERS} workers, {storm.killed} killed: {storm.wall_s:.0f} s, of which "
        f"{storm.jobs / WORKERS:.0f} s are the jobs'; {storm.cpu_s / starts:.2f} s of CPU for each of {starts} starts"
    )
    with capsys.disabled():
        sys.stdout.write(f"\n{told}\n")


def test_readers_during_a_sweep_of_two_hundred_jobs(tmp_path: Path) -> None:
    """`status`, `report` and plain pandas, over and over: none ever sees an error."""

    def as_a_notebook_does() -> None:
        load(tmp_path, "stand-in")
        planned(tmp_path, "stand-in")
        for path in tmp_path.glob("runs/*/curve.parquet"):
            pd.read_parquet(path)

    def as_people_do() -> None:
        for command in (["status"], ["status", "--json"], ["report", "iqm", "--replicates", "100"]):
            result = CliRunner().invoke(app, [*command, "--results", str(tmp_path)])
            nothing_yet = result.exit_code == 2 and "no run can be reported yet" in result.stderr
            assert result.exit_code == 0 or nothing_yet, result.output

    Storm(tmp_path, jobs=200, steps=200).survive(as_a_notebook_does, as_people_do)
