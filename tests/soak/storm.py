"""Many short jobs, twenty workers, and one of them killed every second."""

from __future__ import annotations

import contextlib
import os
import random
import re
import resource
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from rrmctl.errors import Exit
from rrmctl.running.local import LocalExecutor
from rrmctl.running.supervisor import Supervisor
from rrmctl.store.status import RunState, read_status, run_status
from rrmctl.store.sweeps import Job
from tests.rrmctl.running.standin import COMMAND, STEP_S, expected, prepare
from tests.rrmctl.running.test_supervisor import Record, rows

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
    starts: int = 0  #: of workers
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
        if pids := [each.pid for each in states if each.state is RunState.RUNNING and each.pid is not None]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._rng.choice(pids), signal.SIGKILL)
                self.killed += 1

    def survive(self, *readers: Callable[[], object]) -> None:
        """Run it under fire: all end, none twice, every row is there, and no reader sees an error."""
        watcher = Record()
        pool = Supervisor(
            layout=self.layout, jobs=self.assigned, slots=WORKERS, watcher=watcher,
            executor=LocalExecutor(layout=self.layout, command=COMMAND),
        )  # fmt: skip
        began, cpu = time.monotonic(), _children_cpu_s()
        with endlessly(self.kill_one, *readers) as errors:
            code = pool.run()
            self.wall_s, self.cpu_s = time.monotonic() - began, _children_cpu_s() - cpu
        assert errors == []
        assert code is Exit.DONE, set(watcher.errors)
        assert rows(self.root) == expected(range(self.jobs), self.steps, self.every)
        assert self.killed > 5
        self.starts = sum(map(self._attempts_of_one_end, self.assigned))
        assert self.jobs <= self.starts <= self.jobs + self.killed

    def told(self) -> str:
        """What the orchestration cost, in one line."""
        return (
            f"{self.jobs} jobs of {self.steps * STEP_S:g} s, {WORKERS} workers, {self.killed} killed, all done, none "
            f"twice: {self.wall_s:.0f} s, of which {self.jobs * self.steps * STEP_S / WORKERS:.0f} s are the jobs'; "
            f"{self.cpu_s / self.starts:.2f} s of CPU for each of {self.starts} starts"
        )

    def _attempts_of_one_end(self, job: Job) -> int:
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
