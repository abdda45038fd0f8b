"""An executor of one's own: jobs run in threads of the test; the supervisor schedules, retries and blocks as ever."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from pathlib import Path

from rrmctl.errors import Exit
from rrmctl.running.executor import Ended, Evaluated, Event, Note, Started, WorkOrder
from rrmctl.running.scheduler import Outcome, Stage
from rrmctl.running.supervisor import Supervisor
from rrmctl.store.layout import Layout
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, read_status, write_status
from tests.rrmctl.running.standin import prepare
from tests.rrmctl.running.test_supervisor import Record

CRASH = Outcome(Stage.FAILED, RunError(kind=ErrorKind.CRASHED, type="RuntimeError", message="boom"))


class Threads:
    """Does nothing but end, each attempt in a thread; the first run crashes at its first attempt."""

    def __init__(self, layout: Layout, crashing: str) -> None:
        self.layout, self.crashing, self.orders = layout, crashing, list[WorkOrder]()
        self._events: queue.Queue[Event] = queue.Queue()
        self._threads: list[threading.Thread] = []
        self._ended = 0

    def submit(self, order: WorkOrder) -> None:
        self.orders.append(order)
        self._threads.append(threading.Thread(target=self._do, args=(order.run, len(self.orders))))
        self._threads[-1].start()

    def _do(self, run: str, number: int) -> None:
        crashes = run == self.crashing and [order.run for order in self.orders].count(run) == 1
        self._events.put(Started(run, number, 0))
        self._events.put(Note(run, threading.current_thread().name))
        if not crashes:
            self._events.put(Evaluated(run, 40, 1.0, 1.0))
            write_status(self.layout.run(run), Status(state=RunState.DONE, attempt=number, step=40, steps=40))
        self._events.put(Ended(run, CRASH if crashes else Outcome(Stage.DONE)))

    def events(self, wait_s: float) -> Iterator[Event]:
        try:
            event = self._events.get(timeout=wait_s)
        except queue.Empty:
            return
        self._ended += isinstance(event, Ended)
        yield event

    @property
    def running(self) -> int:
        return len(self._threads) - self._ended

    def stop(self, *, now: bool = False) -> None:
        pass

    def close(self) -> None:
        for thread in self._threads:
            thread.join()


def test_threads_can_run_a_sweep(tmp_path: Path) -> None:
    """All end, the one that crashed was tried again behind the others, and every event reached the watcher."""
    layout, assigned = prepare(tmp_path, range(4))
    executor, watcher = Threads(layout, assigned[0].id), Record()
    pool = Supervisor(layout=layout, jobs=assigned, slots=2, watcher=watcher, executor=executor)
    assert pool.run() is Exit.DONE
    assert [order.run for order in executor.orders] == [*(job.id for job in assigned), assigned[0].id]
    assert set(watcher.phases.values()) == {Stage.DONE}
    assert len(watcher.notes) == 5
    assert watcher.errors == ["RuntimeError: boom"]
    assert all(read_status(layout.run(job.id)).state is RunState.DONE for job in assigned)
