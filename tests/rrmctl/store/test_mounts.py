"""What a results folder is on: tables as Linux writes them, and what is made of them."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rrmctl.doctor import mounted
from rrmctl.store.mounts import Mount, mount_at, mount_of, parse_mounts
from rrmctl.store.owner import LEASE_S, NETWORK_LEASE_S, lease_s

NAMES = st.text(st.characters(exclude_characters="/\0", exclude_categories=["Cs"]), min_size=1, max_size=8).filter(
    lambda name: name not in (".", "..")
)
POINTS = st.lists(NAMES, max_size=4).map(lambda names: "/" + "/".join(names))
MOUNTS = st.builds(
    Mount, POINTS, st.sampled_from(["ext4", "nfs4", "fuse.sshfs", "tmpfs"]),
    st.frozensets(st.sampled_from(["rw", "noatime", "local_lock=none", "addr=10.0.0.1"]), min_size=1),
)  # fmt: skip


def line(mount: Mount) -> str:
    """As the kernel writes it: blanks, tabs, ends of lines and backslashes by their octal numbers."""
    point = "".join(f"\\{ord(sign):03o}" if sign in " \t\n\\#" else sign for sign in mount.point)
    return f"source {point} {mount.type} {','.join(mount.options)} 0 0\n"


@given(st.lists(MOUNTS, max_size=6))
def test_a_table_is_read_as_it_was_written(mounts: list[Mount]) -> None:
    """Whatever the folders are called."""
    assert parse_mounts("".join(map(line, mounts))) == mounts


@given(st.lists(MOUNTS, max_size=6), POINTS, st.lists(NAMES, max_size=2))
def test_a_file_is_on_the_deepest_mount_above_it(mounts: list[Mount], point: str, below: list[str]) -> None:
    """Of two at one place the later one hides the other; a name that merely begins alike is not above."""
    path = str(Path(point, *below))
    last = Mount(point, "xfs")
    assert mount_at(path, [*mounts, last]).point.startswith(point)
    assert mount_at(point, [*mounts, last]) == last
    assert mount_at(f"{point}-x/y", [last]) == (last if point == "/" else Mount("/", ""))


@given(st.text())
def test_no_table_is_too_odd(table: str) -> None:
    """Something comes of it."""
    assert isinstance(mount_at("/a", parse_mounts(table)), Mount)


def test_this_machine_tells(tmp_path: Path) -> None:
    """The folder need not be there."""
    assert mount_of(tmp_path / "not" / "yet") == mount_of(tmp_path)
    assert mount_of(Path("/proc/self")).type == "proc"
    assert lease_s(Path("/proc")) == LEASE_S


@pytest.mark.parametrize(
    ("kind", "options", "state", "lease", "said"),
    [
        ("ext4", "rw,relatime", "ok", 30, "local"),
        ("fuseblk", "rw", "ok", 30, "local"),
        ("nfs4", "rw,vers=4.2,local_lock=none", "ok", 120, "shared"),
        ("nfs", "rw,vers=3,nolock,local_lock=all", "note", 120, "local_lock=all: locks may keep no other machine out"),
        ("nfs", "rw,vers=3,local_lock=flock", "note", 120, "local_lock=flock: locks may"),
        ("nfs", "rw,vers=3,local_lock=posix", "ok", 120, "shared"),
        ("lustre", "rw,flock,lazystatfs", "ok", 120, "shared"),
        ("lustre", "rw,localflock", "note", 120, "localflock: locks may"),
        ("lustre", "rw,noflock", "note", 120, "noflock: locks may"),
        ("fuse", "rw", "note", 120, "fuse: locks may"),
        ("fuse.sshfs", "rw", "note", 120, "fuse.sshfs: locks may"),
        ("tmpfs", "rw", "note", 30, "goes with the machine"),
        ("overlay", "rw,lowerdir=/a", "note", 30, "goes with the container"),
    ],
)
def test_the_doctor_judges_the_mount(kind: str, options: str, state: str, lease: float, said: str) -> None:
    """A disk, a network's file system, locks that are only local, and what does not last."""
    (mount,) = parse_mounts(f"server:/data /my\\040results {kind} {options} 0 0\n")
    check = mounted(mount)
    assert (check.state, bool(check.fix)) == (state, state == "note")
    assert f"{kind} at /my results" in check.found
    assert said in check.found
    assert (NETWORK_LEASE_S if mount.network else LEASE_S) == lease
    assert mount.passing or f"{lease:g} s" in check.found
