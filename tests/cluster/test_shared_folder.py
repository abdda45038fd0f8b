"""Two machines on one results folder whose locks do not reach each other: nobody shares a run, nothing is lost.

The folder is mounted twice (bindfs), and FUSE keeps locks to the mount they were taken on, as NFS does with
`local_lock=flock` and Lustre with `localflock`. Machines are processes with a host name and a boot of their own.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import pytest

from rrmctl.store.files import try_lock
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.mounts import mount_of
from rrmctl.store.owner import NETWORK_LEASE_S, Beat, Machine, lease_s, read_beat
from rrmctl.store.schema import TIMINGS
from rrmctl.store.status import RunState, read_status

pytestmark = [pytest.mark.cluster, pytest.mark.slow]

RUN = "0" * 16
ROUNDS = 200

#: Begins a program as if on another machine: its name, a file with its boot's id, the program.
ON = (
    "unshare", "--map-root-user", "--uts", "--mount", "sh", "-c",
    'hostname "$1" && mount --bind "$2" /proc/sys/kernel/random/boot_id && shift 2 && exec "$@"', "sh",
)  # fmt: skip

#: Tries to become the owner of a run, at the moment it is told, and says whether it is; gives the run back when told.
RACER = """
import sys, time
from pathlib import Path
from rrmctl.store.layout import Layout
from rrmctl.store.lease import Lease
from rrmctl.store.owner import Beat
layout = Layout(Path(sys.argv[1]))
for line in iter(sys.stdin.readline, "end\\n"):
    run, stale, at = line.split()
    while time.time() < float(at):
        pass
    lease = Lease.take(layout.run(run), stale=Beat("gone", 1) if stale == "stale" else None)
    if lease is not None:
        with lease.writing():
            (layout.run(run).path / "owner").write_text(sys.argv[2])
    print(int(lease is not None), flush=True)
    sys.stdin.readline()
    if lease is not None:
        lease.release()
    print("free", flush=True)
"""

#: Owns a run and is frozen, at `frozen` in what follows; leaves with 3 when it finds the run taken.
OWNER = """
import os, signal, sys, time
from pathlib import Path
from rrm import files
from rrmctl.store import lease as module
from rrmctl.store.layout import Layout
module.BEAT_S = 0.1
folder = Layout(Path(sys.argv[1])).run("0" * 16)
lease = module.Lease.take(folder)
def frozen(*_):
    os.fsync = print
    os.kill(os.getpid(), signal.SIGSTOP)
def write(data=b"theirs"):
    with lease.writing():
        files.write_atomically(folder.curve, data)
try:
    {}
except module.LeaseLostError:
    sys.exit(3)
"""

#: Watches a run for two seconds of silence, takes it over, writes, says so, and gives it back when told.
SUCCESSOR = """
import sys, time
from pathlib import Path
from rrm.files import write_atomically
from rrmctl.store.layout import Layout
from rrmctl.store.lease import Lease
from rrmctl.store.owner import Watch
folder, watch, tries = Layout(Path(sys.argv[1])).run("0" * 16), Watch(lease_s=2.0), 0
while (beat := watch.expired(folder)) is None:
    tries += Lease.take(folder) is not None
    time.sleep(0.05)
while (lease := Lease.take(folder, stale=beat)) is None:
    time.sleep(0.05)  # its lock is held until the server gives up who has it
with lease.writing():
    write_atomically(folder.curve, b"mine")
print("early" if tries else "taken", flush=True)
sys.stdin.readline()
with lease.writing():
    print(folder.curve.read_text(), flush=True)
lease.release()
"""


class Side(NamedTuple):
    """One of the machines."""

    name: str
    results: Path  #: the folder as it is mounted there
    boot: Path

    @contextlib.contextmanager
    def start(self, *command: str) -> Iterator[subprocess.Popen[str]]:
        """A program on it, for as long as the block lasts."""
        words, pipe = (*ON, self.name, str(self.boot), *command), subprocess.PIPE
        with subprocess.Popen(words, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
            try:
                yield process
            finally:
                process.kill()

    def python(self, script: str, *arguments: str) -> contextlib.AbstractContextManager[subprocess.Popen[str]]:
        """A script on it, which is given the results folder."""
        return self.start(sys.executable, "-c", textwrap.dedent(script), str(self.results), *arguments)


@pytest.fixture
def sides(tmp_path: Path) -> Iterator[list[Side]]:
    """Two machines on one folder; the test is skipped where FUSE or namespaces are not there."""
    with contextlib.ExitStack() as afterwards:
        given = os.environ.get("SHARED_FOLDER")
        mounts = [Path(at, tmp_path.name) for at in given.split(":")] if given else _mounted(tmp_path, afterwards)
        found = [Side(name, at, tmp_path / f"boot-of-{name}") for name, at in zip(("one", "two"), mounts, strict=True)]
        for side in found:
            side.results.mkdir(exist_ok=True)
            side.boot.write_text(f"boot of {side.name}\n")
            with side.start("true") as process:
                _, problem = process.communicate()
            if process.returncode != 0:
                pytest.skip(f"no namespaces: {problem.strip()}")
        yield found


def _mounted(tmp_path: Path, afterwards: contextlib.ExitStack) -> list[Path]:
    """One folder, mounted twice."""
    if shutil.which("bindfs") is None:
        pytest.skip("no bindfs: apt-get install bindfs")
    unmount = shutil.which("fusermount3") or "fusermount"
    real, *places = [tmp_path / name for name in ("real", "one", "two")]
    real.mkdir()
    for place in places:
        place.mkdir()
        # What one machine has replaced the other sees at once, as NFS does for who opens a file.
        mount = ["bindfs", "--no-allow-other", "-o", "attr_timeout=0,entry_timeout=0", str(real), str(place)]
        mounted = subprocess.run(mount, capture_output=True, text=True, check=False)
        if mounted.returncode != 0:
            pytest.skip(f"no FUSE: {mounted.stderr.strip()}")
        afterwards.callback(subprocess.run, [unmount, "-u", "-z", str(place)], check=False)
    return places


@pytest.fixture
def folder(sides: list[Side]) -> RunFolder:
    """The run, as the first machine sees it."""
    found = Layout(sides[0].results).run(RUN)
    found.path.mkdir(parents=True)
    return found


def said(process: subprocess.Popen[str]) -> str:
    """Its next line."""
    assert process.stdout is not None
    line = process.stdout.readline().strip()
    assert line, process.communicate()[1]
    return line


def tell(process: subprocess.Popen[str], line: str = "") -> None:
    assert process.stdin is not None
    process.stdin.write(f"{line}\n")
    process.stdin.flush()


def frozen(process: subprocess.Popen[str]) -> None:
    """Wait until it has stopped itself."""
    while Path(f"/proc/{process.pid}/stat").read_text().rsplit(") ", 1)[1][0] != "T":
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.02)


def test_the_mount_tells_whether_locks_reach_the_other_machine(sides: list[Side], folder: RunFolder) -> None:
    """Those of FUSE do not: that is what is tested here."""
    lock = try_lock(folder.lock)
    other = try_lock(Layout(sides[1].results).run(RUN).lock)
    assert lock is not None
    assert (other is not None) is bool(mount_of(sides[0].results).unsure_locks)
    assert try_lock(folder.lock) is None
    for descriptor in filter(None, (lock, other)):
        os.close(descriptor)
    assert lease_s(sides[0].results) == NETWORK_LEASE_S


@pytest.mark.parametrize("stale", ["free", "stale"])
def test_of_many_on_two_machines_one_takes_the_run(sides: list[Side], folder: RunFolder, stale: str) -> None:
    """A run that is free, and one whose owner, on a third machine, was silent: every time, exactly one."""
    with contextlib.ExitStack() as stack:
        racers = [stack.enter_context(side.python(RACER, f"{side.name}-{n}")) for side in sides for n in range(2)]
        owners = set()
        for number in range(ROUNDS):
            if stale == "stale":
                folder.lease_of(number + 1000).write_bytes(Beat("gone", 1, Machine("third", "?")).encoded())
            at = time.time() + 0.003
            for racer in racers[:: (-1) ** number]:  # on a busy machine who is told first may have it
                tell(racer, f"{RUN} {stale} {at}")
            assert [said(racer) for racer in racers].count("1") == 1, number
            owners.add((folder.path / "owner").read_text())
            for racer in racers:
                tell(racer)
            assert [said(racer) for racer in racers] == ["free"] * len(racers)
            assert read_beat(folder) is None
    assert {name.partition("-")[0] for name in owners} == {"one", "two"}
    assert len(folder.leases()) == 1
    assert not list(folder.path.glob(".*.tmp"))


@pytest.mark.parametrize(
    "where",
    [
        "while True: write(); frozen(); write()",
        # Its bytes are on the disk, and not yet under the name.
        "write(); os.fsync = frozen; write(b'later')",
    ],
    ids=["between writes", "in a write"],
)
def test_a_frozen_owner_wakes_and_writes_nothing(sides: list[Side], folder: RunFolder, where: str) -> None:
    """Nobody takes the run while it lives; after a lease of silence the other machine does."""
    one, two = sides
    if "fsync" in where and not mount_of(one.results).unsure_locks:
        pytest.skip("its locks reach the other machine, which waits for the end of the write")
    with one.python(OWNER.format(where)) as owner:
        frozen(owner)
        with two.python(SUCCESSOR) as successor:
            assert said(successor) == "taken"
            owner.send_signal(signal.SIGCONT)
            _, error = owner.communicate(timeout=20)
            assert owner.returncode == 3, error
            tell(successor)
            assert said(successor) == "mine"
    assert folder.curve.read_bytes() == b"mine"


def test_a_living_owner_is_left_alone(sides: list[Side], folder: RunFolder) -> None:
    """Its signs of life are seen on the other machine, for longer than a lease."""
    one, two = sides
    with one.python(OWNER.format("write(); time.sleep(4); write(); os._exit(0)")) as owner:
        while read_beat(folder) is None:
            time.sleep(0.02)
        with two.python(SUCCESSOR) as successor:
            assert said(successor) == "taken"  # when it had gone
            assert owner.wait() == 0
            tell(successor)


def test_two_programs_share_a_sweep(tmp_path: Path, sides: list[Side]) -> None:
    """`rrmctl run` of the same on both: every run is done once, and ends as in a sweep of one machine."""
    sweep = ("run", "toy-car", "--profile", "smoke", "--seeds", "2", "--workers", "1", "--results")
    program = (sys.executable, "-m", "rrmctl")
    with contextlib.ExitStack() as stack:
        programs = [stack.enter_context(side.start(*program, *sweep, str(side.results))) for side in sides]
        ends = [process.communicate(timeout=300) for process in programs]
    assert [process.returncode for process in programs] == [0, 0], ends
    subprocess.run([*program, *sweep, str(tmp_path / "twin")], check=True, capture_output=True)
    shared, twin = Layout(sides[0].results), Layout(tmp_path / "twin")
    assert shared.run_ids() == twin.run_ids()
    for run in twin.run_ids():
        folder = shared.run(run)
        status = read_status(folder)
        assert (status.state, status.attempt) == (RunState.DONE, 1)
        assert folder.log.read_text().count("--- attempt") == 1
        curves = [pd.read_parquet(each.run(run).curve).drop(columns=[*TIMINGS]) for each in (shared, twin)]
        pd.testing.assert_frame_equal(*curves)
        assert folder.model.read_bytes() == twin.run(run).model.read_bytes()
