"""Ownership of a run: one holder at a time, taken over only from one that gives no sign of life."""

from __future__ import annotations

import contextlib
import os
import resource
import shutil
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
from rrmctl.store.files import StorageError, is_locked, try_lock
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.lease import Lease, LeaseLostError
from rrmctl.store.owner import Beat, Watch, read_beat
from rrmctl.suspend_clock import WakingTime


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


@contextlib.contextmanager
def no_space() -> Iterator[None]:
    """Files can be made, and nothing written into them."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@contextlib.contextmanager
def stopped_in_a_write(folder: RunFolder) -> Iterator[None]:
    """Another process holds the guard and is stopped."""
    script = (
        "import fcntl, sys; file = open(sys.argv[1], 'a'); fcntl.flock(file, fcntl.LOCK_EX); print(flush=True); input()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script, str(folder.guard)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        try:
            assert process.stdout is not None
            process.stdout.readline()
            process.send_signal(signal.SIGSTOP)
            yield
        finally:
            process.kill()


def test_one_owner_at_a_time(folder: RunFolder) -> None:
    """While somebody owns a run nobody else does; once released it can be taken, and what is left behind is empty."""
    first = Lease.take(folder)
    assert first is not None
    assert Lease.take(folder) is None
    first.release()
    assert read_beat(folder) is None
    assert folder.lease_of(1).read_bytes() == b""
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


def test_the_owner_gives_signs_of_life_in_a_long_write(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who does not see the guard sees that it is at work; one that was taken over meanwhile does not take it back."""
    monkeypatch.setattr(module, "BEAT_S", 0.02)
    taken = Lease.take(folder)
    assert taken is not None
    with taken.writing():
        before = beat_of(folder)
        for _ in range(500):
            if beat_of(folder) != before:
                break
            time.sleep(0.02)
        assert beat_of(folder).count > before.count
        with taken._ending:
            folder.lease_of(2).write_text('{"owner": "another", "count": 1}')
        time.sleep(0.1)
        assert beat_of(folder) == Beat("another", 1)
    taken.release()
    assert beat_of(folder) == Beat("another", 1)


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


def test_a_watch_speaks_once_a_lease(folder: RunFolder) -> None:
    """Who could not take the run over does not try again before another lease has passed."""
    now = 0.0
    folder.lease.write_text('{"owner": "a", "count": 1}')
    watch = Watch(30.0, lambda: now)
    told = []
    for now in range(100):
        if watch.expired(folder):
            told.append(now)
    assert told == [30, 60, 90]


def test_a_watch_that_was_stopped_itself_does_not_blame_the_owner(folder: RunFolder) -> None:
    """A minute in which it saw nothing is not a minute of silence; one in which it looked is."""
    now = 0.0
    folder.lease.write_text('{"owner": "a", "count": 1}')
    watch = Watch(30.0, WakingTime(lambda: now))
    for then in (0.0, 1.0, 3600.0, 3601.0, 7200.0):
        now = then
        assert watch.expired(folder) is None
    while watch.expired(folder) is None:
        now += 1.0
    assert 7200.0 + 20.0 <= now <= 7200.0 + 30.0


def test_a_full_disk_does_not_end_the_signs_of_life(folder: RunFolder) -> None:
    """When there is space again the count goes on rising, and nothing was printed; nor when the lease is given back."""
    script = textwrap.dedent("""
        import sys, time
        from pathlib import Path
        from rrmctl.store import lease as module
        from rrmctl.store.layout import Layout
        from rrmctl.store.owner import read_beat
        from tests.rrmctl.store.test_lease import no_space
        module.BEAT_S = 0.02
        folder = Layout(Path(sys.argv[1])).run("0" * 16)
        lease = module.Lease.take(folder)
        with no_space():
            time.sleep(0.5)
            before = read_beat(folder)
        while read_beat(folder) == before:
            time.sleep(0.02)
        print("goes on")
    """)
    command = [sys.executable, "-c", script, str(folder.path.parents[1])]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "goes on\n", "")


def test_a_lease_on_a_folder_that_is_gone_can_be_released(folder: RunFolder) -> None:
    """Whatever keeps the guard from being opened, leaving goes on."""
    taken = Lease.take(folder)
    assert taken is not None
    shutil.rmtree(folder.path)
    taken.release()
    assert not folder.path.exists()


def test_where_there_is_no_space_nothing_is_taken_over(folder: RunFolder, owner: Lease) -> None:
    """The owner keeps both lock and lease."""
    lock = folder.lock.stat().st_ino
    with no_space(), pytest.raises(StorageError):
        Lease.take(folder, stale=beat_of(folder))
    assert folder.lock.stat().st_ino == lock
    with owner.writing():
        pass


def test_one_who_waits_for_the_guard_says_so(folder: RunFolder) -> None:
    """The holder is stopped: a write waits, tells that it does, and happens as soon as the holder is gone."""
    waited = threading.Event()
    taken = Lease.take(folder, waiting=waited.set)
    assert taken is not None
    written = threading.Event()

    def write() -> None:
        with taken.writing():
            written.set()

    with stopped_in_a_write(folder):
        writer = threading.Thread(target=write)
        writer.start()
        assert waited.wait(20)
        assert not written.is_set()
    assert written.wait(20)
    writer.join()
    taken.release()


@pytest.mark.slow
def test_leaving_does_not_wait_for_the_guard(folder: RunFolder) -> None:
    """The lock is free although the holder of the guard never wakes."""
    taken = Lease.take(folder)
    assert taken is not None
    with stopped_in_a_write(folder):
        taken.release()
        assert not is_locked(folder.lock)


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


def test_of_many_who_claim_a_run_one_has_it(folder: RunFolder) -> None:
    """No lock keeps them apart, as on machines that do not see each other's: not one is made."""
    for number in range(1, 30):
        start, tokens = threading.Barrier(6), []

        def claim(number: int = number, start: threading.Barrier = start, tokens: list[str | None] = tokens) -> None:
            start.wait()
            tokens.append(module._claim(folder, number))

        threads = [threading.Thread(target=claim) for _ in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        (token,) = filter(None, tokens)
        assert folder.leases() == [number]
        assert beat_of(folder).owner == token
    assert [path.name for path in folder.path.iterdir()] == ["lease-29.json"]


def test_who_looked_before_others_had_the_run_does_not_get_it(folder: RunFolder) -> None:
    """Its number is free again, and there is a later one."""
    assert module._claim(folder, 7)
    assert module._claim(folder, 3) is None
    assert folder.leases() == [7]


def test_a_sign_of_life_that_comes_late_takes_nothing_back(folder: RunFolder, owner: Lease) -> None:
    """The owner was frozen behind its look at who is the last, which no lock of the other machine kept waiting."""
    token = module._claim(folder, 2)
    owner._write()
    assert beat_of(folder).owner == token
    with pytest.raises(LeaseLostError), owner.writing():
        raise AssertionError("nothing may happen here")


def test_what_a_frozen_owner_was_about_to_put_in_place_is_gone(folder: RunFolder, owner: Lease) -> None:
    """It was frozen in a write, which another machine does not see: it wakes, and the file is its successor's. What
    others write into the folder, who own nothing, is left alone.
    """
    begun, answers = folder.path / ".curve.parquet.1.00.tmp", folder.path / ".labels.parquet.1.00.tmp"
    answers.touch()

    def write() -> None:
        begun.write_text("mine")
        assert module._claim(folder, 2)
        begun.replace(folder.curve)

    with pytest.raises(LeaseLostError), owner.writing():
        write()
    assert not folder.curve.exists()
    assert answers.exists()


def test_a_write_that_fails_by_itself_is_no_lost_lease(folder: RunFolder, owner: Lease) -> None:
    """Only a later owner makes it one."""
    with pytest.raises(FileNotFoundError), owner.writing():
        (folder.path / "nothing").unlink()
    with owner.writing():
        pass


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


def test_a_lock_that_is_put_in_place_is_held(folder: RunFolder) -> None:
    """While a run goes from one owner that is stopped to the next, nobody else gets hold of its lock for a moment."""
    script = """
    import sys
    from pathlib import Path
    from rrmctl.store.files import try_lock
    path = Path(sys.argv[1])
    print(flush=True)
    while try_lock(path) is None:
        pass
    print("held", flush=True)
    """
    leases = [Lease.take(folder)]
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script), str(folder.lock)], stdout=subprocess.PIPE, text=True
    ) as rival:
        try:
            assert rival.stdout is not None
            rival.stdout.readline()
            for _ in range(200):
                leases.append(Lease.take(folder, stale=beat_of(folder)))
                assert None not in leases
            assert rival.poll() is None
        finally:
            rival.kill()
    for lease in leases:
        assert lease is not None
        lease.release()


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
