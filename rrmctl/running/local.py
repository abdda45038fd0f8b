"""The executor of this machine: one child process a run, each in its own process group, none able to take another down.

It waits for pipes and exit codes only, and ends what is silent for too long or takes too much memory.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import wait
from typing import TYPE_CHECKING

from rrmctl.running.executor import Ended, Event, WorkOrder
from rrmctl.running.process import WORKER, Child
from rrmctl.store.status import ErrorKind
from rrmctl.suspend_clock import WakingTime

if TYPE_CHECKING:
    from rrmctl.store.layout import Layout

#: Time between two looks at the memory of workers, seconds.
_POLL_S = 1.0


@dataclass(kw_only=True)
class LocalExecutor:
    """An `rrmctl.running.executor.Executor`."""

    layout: Layout
    hang_after_s: float = 1800.0  #: silence after which a worker counts as hung; a feedback session may take minutes
    memory_limit: int | None = None  #: bytes that a worker may take; None: as much as there is
    command: Sequence[str] = WORKER
    _children: dict[str, Child] = field(default_factory=dict, init=False)
    _waking: WakingTime = field(default_factory=WakingTime, init=False)
    _stopping: bool = field(default=False, init=False)
    _weighed: float = field(default=0.0, init=False)  #: when the memory of workers was last looked at

    def submit(self, order: WorkOrder) -> None:
        self._children[order.run] = Child(self.layout, order, command=self.command, clock=self._waking)

    def events(self, wait_s: float) -> Iterator[Event]:
        speaking = {child.pipe: child for child in self._children.values() if child.open}
        for pipe in wait([*speaking], wait_s):
            yield from speaking[pipe].events()  # type: ignore[index]  # they come back as they were given
        self._end_misbehaving()
        for child in [child for child in self._children.values() if child.ended()]:
            yield from child.events()
            child.close()
            del self._children[child.job]
            yield Ended(child.job, child.outcome(stopping=self._stopping))

    @property
    def running(self) -> int:
        return len(self._children)

    def stop(self, *, now: bool = False) -> None:
        self._stopping = True
        for child in self._children.values():
            child.kill() if now else child.ask_to_stop()

    def close(self) -> None:
        for child in self._children.values():
            child.kill()
        for child in self._children.values():
            child.wait()
        self._children.clear()

    def _end_misbehaving(self) -> None:
        """End workers that are silent for too long, and those that take too much memory."""
        lived, now = self._waking(), time.monotonic()
        for child in self._children.values():
            if lived - child.heard > self.hang_after_s:
                child.end(ErrorKind.HUNG, "gave no sign of life")
        if self.memory_limit is None or now - self._weighed < _POLL_S:
            return
        self._weighed = now
        for child in self._children.values():
            memory = child.memory()
            if memory is not None and memory > self.memory_limit:
                taken, limit = (f"{size / 2**30:.2f} GiB" for size in (memory, self.memory_limit))
                child.end(ErrorKind.MEMORY, f"took {taken} of memory, {limit} are allowed,")
