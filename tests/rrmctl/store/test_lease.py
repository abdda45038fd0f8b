"""Ownership of a run: one holder at a time, taken over only from one that gives no sign of life."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rrmctl.store import lease as module
from rrmctl.store.atomic import is_locked, try_lock
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.lease import Beat, Lease, LeaseLostError, Watch, read_beat


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    found = Layout(tmp_path).run("0" * 16)
    found.path.mkdir(parents=True)
    return found


@pytest.fixture
def owner(folder: RunFolder) -> Iterator[Lease]:
    taken = Lease.take(folder)
    assert taken is not None
    yield taken
    taken.release()


def beat_of(folder: RunFolder) -> Beat:
    beat = read_beat(folder)
    assert beat is not None
    return beat


def test_one_owner_at_a_time(folder: RunFolder) -> None:
    """While somebody owns a run nobody else does; once released it can be taken, and no lease is left behind."""
    first = Lease.take(folder)
    assert first is not None
    assert Lease.take(folder) is None
    first.release()
    assert not folder.lease.exists()
    second = Lease.take(folder)
    assert second is not None
    second.release()


def test_the_owner_gives_signs_of_life(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """The count rises by itself, so that a watch never calls a living owner silent."""
    monkeypatch.setattr(module, "BEAT_S", 0.05)
    taken = Lease.take(folder)
    assert taken is not None
    watch = Watch(lease_s=0.4)
    before = beat_of(folder)
    for _ in range(20):
        assert watch.expired(folder) is None
        time.sleep(0.05)
    assert beat_of(folder).count > before.count
    taken.release()


def test_a_watch_waits_for_the_length_of_a_lease_by_its_own_clock(folder: RunFolder) -> None:
    """What it sees first starts the clock, however old it is; another beat starts it again."""
    folder.lease.write_text('{"owner": "a", "count": 1}')
    os.utime(folder.lease, (0, 0))
    watch = Watch(lease_s=0.2)
    assert watch.expired(folder) is None
    time.sleep(0.25)
    assert watch.expired(folder) == Beat("a", 1)
    folder.lease.write_text('{"owner": "a", "count": 2}')
    assert watch.expired(folder) is None


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"owner": "a", "count": "x"}', "\0"])
def test_a_lease_that_cannot_be_read_never_expires(folder: RunFolder, text: str) -> None:
    """Nothing is taken over on the word of a damaged file."""
    folder.lease.write_text(text)
    watch = Watch(lease_s=0.0)
    assert [watch.expired(folder) for _ in range(3)] == [None] * 3


def test_one_who_was_taken_over_writes_nothing(folder: RunFolder, owner: Lease) -> None:
    """The new owner writes; the old one is refused, and its release leaves the new one's lock and lease alone."""
    successor = Lease.take(folder, stale=beat_of(folder))
    assert successor is not None
    with pytest.raises(LeaseLostError), owner.writing():
        raise AssertionError("nothing may happen here")
    with successor.writing():
        pass
    owner.release()
    assert is_locked(folder.lock)
    assert Lease.take(folder) is None
    successor.release()
    owner._lock = os.open(os.devnull, os.O_RDONLY)  # for the fixture to close


def test_one_who_was_taken_over_by_somebody_who_is_done_by_now_writes_nothing(folder: RunFolder, owner: Lease) -> None:
    """No lease is left, and that is not taken for one's own."""
    successor = Lease.take(folder, stale=beat_of(folder))
    assert successor is not None
    successor.release()
    with pytest.raises(LeaseLostError), owner.writing():
        raise AssertionError("nothing may happen here")


def test_a_sign_of_life_prevents_being_taken_over(folder: RunFolder, owner: Lease) -> None:
    """The beat that was called stale is not the last one any more."""
    stale = beat_of(folder)
    with owner.writing():
        owner._write()
    assert Lease.take(folder, stale=stale) is None
    with owner.writing():
        pass


def test_one_in_the_middle_of_a_write_is_not_taken_over(folder: RunFolder, owner: Lease) -> None:
    """What it writes is whole before anybody else comes."""
    stale = beat_of(folder)
    with owner.writing():
        assert Lease.take(folder, stale=stale) is None
    successor = Lease.take(folder, stale=stale)
    assert successor is not None
    successor.release()


def test_of_many_who_want_to_take_over_one_does(folder: RunFolder, owner: Lease) -> None:
    """Threads with descriptors of their own, as processes have them."""
    for _ in range(10):
        stale, taken = beat_of(folder), []
        start = threading.Barrier(8)

        def take(stale: Beat = stale, start: threading.Barrier = start, taken: list[Lease] = taken) -> None:
            start.wait()
            lease = Lease.take(folder, stale=stale)
            if lease is not None:
                taken.append(lease)

        threads = [threading.Thread(target=take) for _ in range(8)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(taken) <= 1
        assert is_locked(folder.lock)


def test_a_lock_behind_another_name_is_no_lock(folder: RunFolder) -> None:
    """One who waits for a file that is replaced meanwhile gets the new one."""
    old = try_lock(folder.lock)
    assert old is not None
    folder.lock.unlink()
    new = try_lock(folder.lock, 1.0)
    assert new is not None
    assert os.fstat(new).st_ino != os.fstat(old).st_ino
    os.close(old)
    os.close(new)


def test_a_stopped_process_wakes_to_find_its_run_taken(folder: RunFolder) -> None:
    """SIGSTOP, taken over by another process, SIGCONT: the first writes nothing any more."""
    script = textwrap.dedent("""
        import sys, time
        from pathlib import Path
        from rrmctl.store.layout import Layout
        from rrmctl.store.lease import Lease, LeaseLostError
        folder = Layout(Path(sys.argv[1])).run("0" * 16)
        lease = Lease.take(folder)
        for number in range(10_000):
            try:
                with lease.writing():
                    (folder.path / "written").write_text(str(number))
            except LeaseLostError:
                sys.exit(3)
            time.sleep(0.01)
    """)
    process = subprocess.Popen([sys.executable, "-c", script, str(folder.path.parents[1])])
    try:
        while not (folder.path / "written").exists():
            time.sleep(0.02)
        successor = None
        while successor is None:  # it may have been stopped in the middle of a write: then that one comes first
            process.send_signal(signal.SIGSTOP)
            time.sleep(0.05)
            successor = Lease.take(folder, stale=beat_of(folder))
            if successor is None:
                process.send_signal(signal.SIGCONT)
                time.sleep(0.03)
        (folder.path / "written").write_text("mine")
        process.send_signal(signal.SIGCONT)
        assert process.wait(20) == 3
        assert (folder.path / "written").read_text() == "mine"
        successor.release()
    finally:
        process.kill()
        process.wait()
