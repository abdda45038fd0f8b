"""Whether a run is somebody's, as seen from the machine of its owner and from others."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.store.files import try_lock
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.lease import Lease
from rrmctl.store.owner import HERE, Beat, Machine, is_owned, owned, read_beat
from rrmctl.store.status import (
    ErrorKind,
    RunError,
    RunState,
    Status,
    read_status,
    record_failure,
    run_status,
    write_status,
)
from rrmctl.store.sweeps import remove_unused
from tests.rrmctl.running.standin import prepare

A, B = Machine("a", "boot of a"), Machine("b", "boot of b")


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    """A run that says it is running, and that nobody has locked."""
    found = Layout(tmp_path).run("0" * 16)
    write_status(found, Status(state=RunState.RUNNING, attempt=1, host="elsewhere"))
    return found


def write_beat(folder: RunFolder, machine: Machine = A) -> Beat:
    beat = Beat("another", 1, machine)
    folder.lease.write_bytes(beat.encoded())
    return beat


@pytest.mark.parametrize(
    ("machine", "locked", "silent", "expected"),
    [
        (A, True, False, True),
        (B, True, False, True),
        (None, True, False, True),
        (A, False, False, False),
        (None, False, False, False),
        (Machine("a", "an earlier boot"), False, False, False),
        (Machine("another name", A.boot), False, False, False),
        (Machine("a", ""), False, False, False),
        (B, False, False, True),
        (Machine("b", ""), False, False, True),
        (B, False, True, False),
        (B, True, True, False),
        (A, True, True, False),
    ],
)
def test_who_owns_a_run(machine: Machine | None, locked: bool, silent: bool, expected: bool) -> None:
    """As seen from A. A free lock is believed of owners on A, also before a restart; of others silence alone is."""
    beat = None if machine is None else Beat("o", 5, machine)
    last = Beat("o", 5 if silent else 4, B)
    assert owned(beat, locked=locked, here=A, silent=last) is expected
    if not silent:
        assert owned(beat, locked=locked, here=A) is expected


def test_a_system_without_boot_ids_goes_by_names() -> None:
    """Two machines that tell no boot are not one for that."""
    assert Machine("a", "").tells_of(Machine("a", ""))
    assert not Machine("a", "").tells_of(Machine("b", ""))


def test_a_lease_says_where_its_owner_lives(folder: RunFolder) -> None:
    """Host and boot are in the file; one of an earlier version is taken for this machine's."""
    lease = Lease.take(folder)
    assert lease is not None
    value = json.loads(folder.lease_of(1).read_text())
    assert (value["host"], value["boot"]) == (HERE.host, HERE.boot)
    lease.release()
    folder.lease_of(1).unlink()
    folder.lease.write_text('{"owner": "o", "count": 1}')
    assert read_beat(folder) == Beat("o", 1)
    assert not is_owned(folder)


def test_a_run_of_another_machine_is_left_alone(folder: RunFolder) -> None:
    """Nobody holds its lock here; it is running, nobody takes it, records its failure or removes it."""
    before = write_beat(folder)
    assert run_status(folder).state is RunState.RUNNING
    assert Lease.take(folder) is None
    record_failure(folder, RunError(kind=ErrorKind.KILLED, type="SIGKILL", message="killed"))
    assert read_status(folder).state is RunState.RUNNING
    assert remove_unused(Layout(folder.results), [folder.id]) == []
    assert read_beat(folder) == before


@pytest.mark.parametrize("host", ["node7", "\x1b[31m"])
def test_status_names_the_other_machine(tmp_path: Path, host: str) -> None:
    """And says what to do should it be gone; whatever the name, it is text. Nothing of one's own machine."""
    layout, (job,) = prepare(tmp_path, range(1))
    folder = layout.run(job.id)
    for machine, named in ((A, True), (HERE, False)):
        write_status(folder, Status(state=RunState.RUNNING, attempt=1, host=host))
        write_beat(folder, machine)
        told = CliRunner().invoke(app, ["status", "--results", str(tmp_path)])
        assert told.exit_code == 0
        assert ("should one be gone, this takes its runs over" in told.stdout) is named
        assert ("Running on node7;" in told.stdout) is (named and host == "node7")
        assert "\x1b" not in told.stdout


def test_a_run_of_another_machine_is_taken_once_it_was_silent(folder: RunFolder) -> None:
    """What was watched must be the last sign of life still."""
    before = write_beat(folder)
    assert Lease.take(folder, stale=Beat("another", 0)) is None
    lease = Lease.take(folder, stale=before)
    assert lease is not None
    assert not try_lock(folder.lock)
    lease.release()
    assert run_status(folder).state is RunState.INTERRUPTED


def test_what_died_on_this_machine_is_free_at_once(folder: RunFolder) -> None:
    """With the lease that it left, before a restart or after it."""
    for machine in (HERE, Machine(HERE.host, "an earlier boot")):
        write_beat(folder, machine)
        assert run_status(folder).state is RunState.INTERRUPTED
        lock = try_lock(folder.lock)
        assert lock is not None
        assert run_status(folder).state is RunState.RUNNING
        os.close(lock)
    assert remove_unused(Layout(folder.results), [folder.id]) == [folder.id]
