"""Atomic writes."""

import errno
import os
import subprocess
import sys
from pathlib import Path
from threading import Barrier, Thread

import pytest

from rrm.files import UnfitFileError, create, make_folder, read_bounded, write_atomically


def test_a_file_is_replaced_as_a_whole(tmp_path):
    """New bytes stand where the old ones stood, and nothing else is left behind."""
    path = tmp_path / "a"
    for data in (b"old", b"newer"):
        write_atomically(path, data)
        assert path.read_bytes() == data
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_fails_names_the_file_and_leaves_the_old_one(tmp_path):
    """A limit in the middle of the write: the error carries the path, the old content stays, no temporary file does."""
    path = tmp_path / "a"
    write_atomically(path, b"old")
    script = (
        "import resource, signal, sys; from pathlib import Path; from rrm.files import write_atomically\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN); resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try: write_atomically(Path(sys.argv[1]), bytes(5000))\n"
        "except OSError as error: print(error.filename)"
    )
    done = subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == str(path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_missing_folder_is_an_error(tmp_path):
    """The folder is the caller's to make."""
    with pytest.raises(FileNotFoundError):
        write_atomically(tmp_path / "none" / "a", b"")


def test_a_temporary_file_is_nobody_elses(tmp_path):
    """Processes in two containers can have one number: what the other is writing stays as it is."""
    theirs = tmp_path / f".a.{os.getpid()}.tmp"
    theirs.write_bytes(b"half")
    write_atomically(tmp_path / "a", b"ours")
    assert theirs.read_bytes() == b"half"
    assert (tmp_path / "a").read_bytes() == b"ours"


def test_every_new_folder_is_flushed_into_the_one_above(tmp_path, monkeypatch):
    """From the top; what is there already is not touched, and a file in the way is an error."""
    synced = []
    monkeypatch.setattr("rrm.files.sync_folder", lambda folder: synced.append((folder, sorted(folder.iterdir()))))
    folder = tmp_path / "results" / "runs" / "r"
    for _ in range(2):
        make_folder(folder)
    assert synced == [
        (above, [above / name])
        for above, name in zip(
            (tmp_path, tmp_path / "results", tmp_path / "results" / "runs"), ("results", "runs", "r"), strict=True
        )
    ]
    (tmp_path / "file").touch()
    with pytest.raises(FileExistsError):
        make_folder(tmp_path / "file" / "r")


def test_a_read_ends(tmp_path):
    """A regular file within the limit is read; a pipe is not waited for, a device has no end, a folder is no file."""
    path = tmp_path / "a"
    path.write_bytes(b"12345")
    assert read_bounded(path, 5) == b"12345"
    with pytest.raises(UnfitFileError, match="longer than 4 bytes"):
        read_bounded(path, 4)
    os.mkfifo(tmp_path / "pipe")
    for name in (tmp_path / "pipe", tmp_path, Path("/dev/zero")):
        with pytest.raises(UnfitFileError, match="not a regular file"):
            read_bounded(name, 100)
    with pytest.raises(FileNotFoundError):
        read_bounded(tmp_path / "none", 100)


def test_a_name_that_is_a_folder_takes_no_write(tmp_path, monkeypatch):
    """Also `.`, which has no name of its own: an error of the system, and nothing is left behind."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OSError, match=r"'\.'"):
        write_atomically(Path(), b"data")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("links", [True, False])
def test_of_many_who_create_a_file_one_does(tmp_path, links, monkeypatch):
    """It holds what the one wanted; nothing else is left, also where the file system has no links (FAT)."""
    if not links:
        monkeypatch.setattr(os, "link", _refused)
    for number in range(30):
        path, start, made = tmp_path / str(number), Barrier(4), []

        def attempt(name, path=path, start=start, made=made):
            start.wait()
            made.append((name, create(path, name)))

        threads = [Thread(target=attempt, args=(bytes([65 + n]),)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        (winner,) = [name for name, whether in made if whether]
        assert path.read_bytes() == winner
    assert len(list(tmp_path.iterdir())) == 30


def _refused(*_):
    raise PermissionError(errno.EPERM, "Operation not permitted")


def test_a_file_that_cannot_be_created_is_named(tmp_path):
    """And no temporary one in its stead."""
    with pytest.raises(FileNotFoundError) as caught:
        create(tmp_path / "no" / "file", b"")
    assert caught.value.filename == str(tmp_path / "no" / "file")
