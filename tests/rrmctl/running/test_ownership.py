"""Runs that other processes hold, and workers and parents that were stopped: who waits, who leaves, who is ended."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest

from rrmctl.errors import Exit
from rrmctl.running.scheduler import Outcome, Stage
from rrmctl.store.files import is_locked, try_lock
from rrmctl.store.layout import RunFolder
from rrmctl.store.owner import read_beat
from rrmctl.store.status import RunState, read_status
from tests.rrmctl.running.standin import expected, live_on, prepare
from tests.rrmctl.running.test_supervisor import (
    PARENT,
    Record,
    alive,
    attempts,
    behave,
    children,
    go,
    half_way,
    meanwhile,
    parent,
    pool,
    rows,
    states,
    until,
)
from tests.rrmctl.store.test_lease import stopped_in_a_write

__all__ = ["behave"]

pytestmark = pytest.mark.slow


class Counting(Record):
    """Counts how attempts ended as well."""

    def __init__(self) -> None:
        super().__init__()
        self.ends: Counter[Stage] = Counter()

    def ended(self, job: str, outcome: Outcome, phase: Stage) -> None:
        super().ended(job, outcome, phase)
        self.ends[phase] += 1


def test_a_hang_that_keeps_python_from_running_does_not_outlive_the_parent(
    tmp_path: Path, behave: Callable[..., None]
) -> None:
    """A regular expression holds the interpreter's lock, so that no thread and no handler runs: the system ends it."""
    behave(other="stuck")
    layout, assigned = prepare(tmp_path, range(1))
    with parent(tmp_path, 1, 1) as process:
        (pid,) = half_way(layout, assigned)
        time.sleep(1.0)
        process.send_signal(signal.SIGKILL)
    try:
        until(lambda: not alive(pid), 60.0)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def test_a_worker_that_waits_for_its_run_leaves_with_its_parent(tmp_path: Path) -> None:
    """The guard's holder never lets go: the worker goes when its parent is killed, and the run is as it was."""
    layout, assigned = prepare(tmp_path, range(1))
    folder = layout.run(assigned[0].id)
    with stopped_in_a_write(folder):
        with parent(tmp_path, 1, 1) as process:
            until(lambda: is_locked(folder.lock))
            (pid,) = children(process.pid)
            process.send_signal(signal.SIGKILL)
        until(lambda: not alive(pid), 30.0)
    assert not folder.status.exists()


def test_a_worker_that_waits_for_a_write_is_not_hung(tmp_path: Path) -> None:
    """It gives signs of life until the guard's holder is gone, for longer than a hang takes."""
    layout, assigned = prepare(tmp_path, range(1))
    folder = layout.run(assigned[0].id)
    watcher = Record()

    def hold() -> None:
        with stopped_in_a_write(folder):
            time.sleep(20.0)

    with meanwhile(hold):
        until(lambda: is_locked(folder.guard))
        assert pool(layout, assigned, watcher, hang_after_s=15.0).run() is Exit.DONE
    assert watcher.errors == []
    assert attempts(layout, assigned) == [1]


def test_a_run_whose_owner_has_not_begun_is_waited_for_without_processes(tmp_path: Path) -> None:
    """Its lock is held and its status says nothing of it: one worker finds that out, and no other is started."""
    layout, assigned = prepare(tmp_path, range(1))
    lock = try_lock(layout.run(assigned[0].id).lock)
    assert lock is not None
    watcher = Counting()

    def release() -> None:
        until(lambda: watcher.ends[Stage.ELSEWHERE] > 0)
        time.sleep(6.0)
        os.close(lock)

    with meanwhile(release):
        assert pool(layout, assigned, watcher).run() is Exit.DONE
    assert watcher.ends == {Stage.ELSEWHERE: 1, Stage.DONE: 1}


def test_an_owner_stopped_in_a_write_is_asked_after_once_a_lease(tmp_path: Path) -> None:
    """It cannot be taken over; attempts, and what is said of them, are a lease apart. When it dies its run is done."""
    layout, assigned = prepare(tmp_path, range(1))
    folder = layout.run(assigned[0].id)
    folder.lease.write_text('{"owner": "a", "count": 1}')
    watcher, began = Counting(), time.monotonic()

    def own() -> None:
        lock = try_lock(folder.lock)
        assert lock is not None
        with stopped_in_a_write(folder):
            until(lambda: len(watcher.notes) >= 2)
            time.sleep(4.0)
        os.close(lock)

    with meanwhile(own):
        until(lambda: is_locked(folder.guard))
        assert pool(layout, assigned, watcher, lease_s=3.0).run() is Exit.DONE
    said = len([note for note in watcher.notes if "sign of life" in note])
    assert 2 <= said <= (time.monotonic() - began) / 3.0
    assert watcher.ends[Stage.ELSEWHERE] <= said + 1


def test_the_runs_of_another_machine_are_taken_over_when_it_is_dead(
    tmp_path: Path, behave: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two machines that do not see each other's locks: while one lives the other waits, for longer than a lease."""
    behave(other="gate")
    layout, assigned = prepare(tmp_path, range(2))
    folders = [layout.run(job.id) for job in assigned]
    monkeypatch.setenv("STANDIN_HOST", "one")
    with parent(tmp_path, 2, 2) as one:
        pids = half_way(layout, assigned)
        monkeypatch.setenv("STANDIN_HOST", "two")
        live_on("two", monkeypatch.setattr)
        watcher, seen = Record(), []

        def kill() -> None:
            before = count(folders)
            until(lambda: count(folders) > before + 20)
            seen.extend((*states(layout, assigned), *attempts(layout, assigned), *watcher.phases.values()))
            for pid in (one.pid, *pids):
                os.kill(pid, signal.SIGKILL)
            go(layout)

        with meanwhile(kill):
            assert pool(layout, assigned, watcher, lease_s=3.0).run() is Exit.DONE
    assert seen == [RunState.RUNNING, RunState.RUNNING, 1, 1, Stage.ELSEWHERE, Stage.ELSEWHERE]
    assert len([note for note in watcher.notes if "sign of life" in note]) >= 2
    assert attempts(layout, assigned) == [2, 2]
    assert rows(tmp_path) == expected(range(2))


def count(folders: list[RunFolder]) -> int:
    """Signs of life that each of these runs has had at least."""
    return min(beat.count if (beat := read_beat(folder)) else 0 for folder in folders)


def test_a_parent_that_was_stopped_with_its_worker_does_not_blame_it(tmp_path: Path) -> None:
    """Both stand still for longer than a hang takes, and the parent wakes first: the attempt goes on."""
    script = PARENT.replace("command=COMMAND)", "command=COMMAND, hang_after_s=15.0)")
    layout, assigned = prepare(tmp_path, range(1), 3000)
    folder = layout.run(assigned[0].id)
    command = [sys.executable, "-c", script, str(tmp_path), "1", "1", "3000", "30"]
    with subprocess.Popen(command, cwd=Path(__file__).parents[3]) as process:
        try:
            until(lambda: read_status(folder).rows > 0)
            worker = read_status(folder).pid
            assert worker is not None
            for each in (process.pid, worker):
                os.kill(each, signal.SIGSTOP)
            time.sleep(18.0)
            for each in (process.pid, worker):
                os.kill(each, signal.SIGCONT)
                time.sleep(1.0)
            assert process.wait() == 0
        finally:
            process.kill()
    assert attempts(layout, assigned) == [1]
