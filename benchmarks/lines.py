"""What a benchmark reports: one line of the table, and the measurements behind it.

Everything that is compared is measured in turns within one process (or by processes started in turns), so that a busy
or throttled machine slows both alike; the figure is the median over the turns.
"""

from __future__ import annotations

import os
import re
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True, kw_only=True)
class Line:
    """One line. A quantity is a rate (more is better) unless its unit is one of time, memory or error."""

    item: str
    ours: float
    unit: str  #: "/s" and "x" want more; "s", "ms", "MiB", "%", "mm" and "deg" want less
    peers: Mapping[str, float] = field(default_factory=dict)  #: figures of the others by name, in the same unit
    floor: float | None = None  #: what the machine's arithmetic alone would allow, in the same unit
    least_ratio: float | None = None  #: of ours to the best peer's
    least_share: float | None = None  #: of the floor
    bound: float | None = None  #: of ours itself: at least for rates, at most for times, memory and errors
    note: str = ""

    @property
    def _more_is_better(self) -> bool:
        return self.unit in ("/s", "x")

    def _over(self, other: float) -> float:
        return self.ours / other if self._more_is_better else other / self.ours

    @property
    def best(self) -> str:
        """Whose figure is the best: "ours", or a peer's name; empty where there is no peer."""
        if not self.peers:
            return ""
        figures = {"ours": self.ours, **self.peers}
        return (max if self._more_is_better else min)(figures, key=figures.__getitem__)

    @property
    def ratio(self) -> float | None:
        """How many times better than the best peer; None without one."""
        return min(map(self._over, self.peers.values()), default=None)

    @property
    def share(self) -> float | None:
        """How much of what the machine allows is reached, as a fraction."""
        return None if self.floor is None else self._over(self.floor)

    @property
    def met(self) -> bool | None:
        """Whether every demand on this line is met; None where there is none."""
        demands = [
            figure >= least
            for figure, least in ((self.ratio, self.least_ratio), (self.share, self.least_share))
            if figure is not None and least is not None
        ]
        if self.bound is not None:
            demands.append(self.ours >= self.bound if self._more_is_better else self.ours <= self.bound)
        return all(demands) if demands else None

    @property
    def demand(self) -> str:
        """The demands in words."""
        parts = []
        if self.least_ratio is not None:
            parts.append(f"≥ {self.least_ratio:g} x best peer")
        if self.least_share is not None:
            parts.append(f"≥ {self.least_share:.0%} of floor")
        if self.bound is not None:
            parts.append(f"{'≥' if self._more_is_better else '≤'} {self.bound:g} {self.unit}")
        return ", ".join(parts)


@contextmanager
def one_core() -> Iterator[None]:
    """Holds this process, its threads and those they start to one core, where the system (Linux) can do that.

    A library that counts the cores when it is first used then starts no more threads than one core can use.
    """
    if sys.platform != "linux":
        yield
        return
    before = os.sched_getaffinity(0)
    _hold_threads_to({max(before)})
    try:
        yield
    finally:
        _hold_threads_to(before)


def _hold_threads_to(cores: set[int]) -> None:
    for thread in Path("/proc/self/task").iterdir():
        with suppress(ProcessLookupError):  # it has ended since
            os.sched_setaffinity(int(thread.name), cores)


def seconds(work: Callable[[], object], budget: float) -> float:
    """Processor seconds per call, of all threads of this process: the mean over about `budget` seconds, or one call."""
    calls, start = 0, time.process_time()
    while True:
        work()
        calls += 1
        passed = time.process_time() - start
        if passed >= budget:
            return passed / calls


def in_turns(*works: Callable[[], object], turns: int = 9, budget: float = 0.3) -> list[float]:
    """Median seconds per call of each, timed in turns after a warm-up."""
    for work in works:
        seconds(work, budget)
    rounds = [[seconds(work, budget) for work in works] for _ in range(turns)]
    return [statistics.median(column) for column in zip(*rounds, strict=True)]


def apart(module: str, *arguments: object) -> list[float]:
    """Figures measured in a process of its own: what that module of this folder prints when it is run so."""
    command = [sys.executable, "-m", module, *map(str, arguments)]
    return [float(word) for word in subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout.split()]


def peak_mib() -> float:
    """Largest resident size of this process so far, where the system (Linux) tells it. `getrusage` begins with that of
    whoever started the process.
    """
    told = re.search(r"^VmHWM:\s*(\d+) kB$", Path("/proc/self/status").read_text(), re.MULTILINE)
    return int(told[1]) / 1024 if told else float("nan")
