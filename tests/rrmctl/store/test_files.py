"""Writes as a whole or not at all, and locks that die with their holder."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from rrmctl.store.files import DamagedError, StorageError, is_locked, open_lock, remove_leftovers, try_lock, write_bytes
from rrmctl.store.records import read_json, write_json

HOLD = "import sys, time; from rrmctl.store.files import try_lock; from pathlib import Path; " \
       "print(try_lock(Path(sys.argv[1])) is not None, flush=True); time.sleep(60)"  # fmt: skip


def test_a_write_that_does_not_fit_leaves_the_old_file(tmp_path: Path) -> None:
    """A real limit of the system in the middle of a write: the message names the file, the old content stays."""
    path = tmp_path / "file"
    write_bytes(path, b"old")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(StorageError, match=f"cannot write {path}: File too large"):
            write_bytes(path, b"x" * 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == b"old"
    assert [path] == list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    """A results root below a file is refused with its path and what to do."""
    (tmp_path / "taken").touch()
    with pytest.raises(StorageError, match="taken/runs/x") as caught:
        write_json(tmp_path / "taken" / "runs" / "x", {})
    assert "--results" in str(caught.value.hint)


def test_leftovers_of_writers_that_died_are_removed(tmp_path: Path) -> None:
    """Only temporary files go, and not those that somebody else may be writing just now."""
    for name in (".status.json.12.tmp", "status.json", ".lock", ".config.json.12.tmp"):
        (tmp_path / name).touch()
    os.utime(tmp_path / ".status.json.12.tmp", (time.time() - 3600,) * 2)
    remove_leftovers(tmp_path)
    assert {".lock", "status.json", ".config.json.12.tmp"} == {path.name for path in tmp_path.iterdir()}


@pytest.mark.parametrize("ahead_s", [-7200.0, 7200.0])
def test_leftovers_are_as_old_as_the_file_system_says(
    tmp_path: Path, ahead_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever this machine's clock says: the files may be another's, who is at work."""
    there = time.time()
    monkeypatch.setattr(time, "time", lambda: there + ahead_s)
    for name, age_s in ((".young.1.tmp", 60.0), (".old.1.tmp", 3600.0)):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (there - age_s,) * 2)
    remove_leftovers(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [".young.1.tmp"]


def test_what_is_not_there_is_looked_for_behind_a_listing(tmp_path: Path) -> None:
    """Another machine may have made it since it was last looked for, and NFS says so to nobody but who lists."""
    script = """if True:
        import sys
        from pathlib import Path
        from rrmctl.store.files import read_bytes
        path, events = Path(sys.argv[1]), []
        def look(event, arguments):
            if event in ("open", "os.listdir", "os.scandir") and str(arguments[0]).startswith(str(path.parent)):
                events.append(event)
                if event != "open":
                    path.write_bytes(b"made meanwhile")
        sys.addaudithook(look)
        print(read_bytes(path), events[0], events[1])
    """
    command = [sys.executable, "-c", script, str(tmp_path / "status.json")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
    assert done.stdout == "b'made meanwhile' open os.listdir\n"


@pytest.mark.parametrize("content", ["", "{", "[1]", '{"a": 1', "\x00\x00"])
def test_json_that_is_not_an_object_is_refused_by_name(tmp_path: Path, content: str) -> None:
    """A torn JSON file is never taken for an empty one."""
    path = tmp_path / "status.json"
    path.write_text(content)
    with pytest.raises(DamagedError, match=r"status\.json"):
        read_json(path)


def test_a_file_that_cannot_be_read_now_is_not_damaged(tmp_path: Path) -> None:
    """What it holds nobody knows: it is not one to set aside."""
    (tmp_path / "status.json").mkdir()
    with pytest.raises(StorageError, match=r"status\.json cannot be read now: not a regular file"):
        read_json(tmp_path / "status.json")


def test_a_file_that_is_not_there_is_none(tmp_path: Path) -> None:
    """Absence is not damage."""
    assert read_json(tmp_path / "nothing" / "status.json") is None


def test_a_lock_is_exclusive_and_freed_by_sigkill(tmp_path: Path) -> None:
    """Nobody else gets it while the holder lives; the moment it is killed anybody may."""
    path = tmp_path / "lock"
    with subprocess.Popen([sys.executable, "-c", HOLD, str(path)], stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"True\n"
        assert is_locked(path)
        assert try_lock(path, patience_s=0.05) is None
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        assert not is_locked(path)
        lock = try_lock(path)
        assert lock is not None
        os.close(lock)


@pytest.mark.parametrize("problem", [errno.ENOENT, errno.ESTALE])
def test_a_lock_that_is_replaced_as_it_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, problem: int) -> None:
    """FUSE and NFS say that it is not there, though it was to be made; one whose folder is gone is refused."""
    really, problems = os.open, [problem] * 3

    def sometimes(path: Path, *options: int) -> int:
        if problems:
            raise OSError(problems.pop(), "gone", str(path))
        return really(path, *options)

    monkeypatch.setattr(os, "open", sometimes)
    os.close(open_lock(tmp_path / "lock"))
    assert not problems
    with pytest.raises(StorageError, match="No such file"):
        open_lock(tmp_path / "missing" / "lock")


def test_readers_that_look_do_not_stop_a_writer_from_locking(tmp_path: Path) -> None:
    """A lock is had within its patience while others keep asking whether it is taken."""
    path, over = tmp_path / "lock", threading.Event()
    path.touch()

    def look() -> None:
        while not over.is_set():
            is_locked(path)

    readers = [threading.Thread(target=look) for _ in range(3)]
    for reader in readers:
        reader.start()
    try:
        for _ in range(20):
            lock = try_lock(path, patience_s=10.0)
            assert lock is not None
            os.close(lock)
    finally:
        over.set()
        for reader in readers:
            reader.join()
