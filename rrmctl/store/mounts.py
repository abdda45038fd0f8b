"""What kind of file system a folder is on, and what that means for the locks and the files in it."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

#: Types of file systems that several machines can have mounted; those that are programs (`fuse.*`) may be any.
_NETWORK = re.compile(
    r"nfs4?|lustre|cifs|smb3|ceph|gpfs|beegfs|panfs|afs|pvfs2|wekafs|gfs2|ocfs2|9p|virtiofs|fuse(\.\S+)?"
)

#: Mount options with which `flock` reaches no other machine, or is refused.
_LOCAL_LOCKS = frozenset({"localflock", "noflock", "nolock", "local_lock=flock", "local_lock=all"})


@dataclass(frozen=True)
class Mount:
    """One line of `/proc/self/mounts`."""

    point: str  #: the folder it is at
    type: str  #: "ext4", "nfs4", "fuse.sshfs", ...
    options: frozenset[str] = frozenset()

    @property
    def network(self) -> bool:
        """Whether other machines may have it mounted."""
        return _NETWORK.fullmatch(self.type) is not None

    @property
    def unsure_locks(self) -> str:
        """Why its locks may keep no other machine out: an option, or a type that does not tell; empty where they do."""
        return min(self.options & _LOCAL_LOCKS, default=self.type if re.match(r"fuse(\.|$)", self.type) else "")

    @property
    def passing(self) -> bool:
        """Whether it goes with the machine or the container."""
        return self.type in ("tmpfs", "ramfs", "overlay")


def parse_mounts(table: str) -> list[Mount]:
    r"""The mounts in a table as Linux writes it, in which a blank in a name is `\040`; odd lines are left out."""
    lines = (line.split(" ") for line in table.split("\n"))
    return [Mount(_plain(line[1]), line[2], frozenset(line[3].split(","))) for line in lines if len(line) > 3]


def mount_at(path: str, mounts: list[Mount]) -> Mount:
    """The one that an absolute path without links lies on: the deepest, and of several at one place the last."""
    above = [mount for mount in mounts if f"{path}/".startswith(f"{mount.point.rstrip('/')}/")]
    return max(reversed(above), key=lambda mount: len(mount.point), default=Mount("/", ""))


def mount_of(path: Path) -> Mount:
    """What a file or folder is on, or will be once it is there; of type "" where the system does not tell."""
    try:
        table = os.fsdecode(Path("/proc/self/mounts").read_bytes())
    except OSError:
        table = ""
    return mount_at(os.path.realpath(path), parse_mounts(table))


def _plain(name: str) -> str:
    return re.sub(r"\\([0-7]{3})", lambda match: chr(int(match[1], 8)), name)
