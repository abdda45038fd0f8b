"""Whether anybody owns a run, as seen from this machine: judged by its lock and by its owner's signs of life.

Owners are numbered, and only the last one counts (`rrmctl.store.lease` says how one becomes that). A lock that is held
is held. One that is free means that the owner is dead, but only on the owner's own machine: some file systems keep
locks to the machine that took them. An owner elsewhere is dead when its signs of life have been watched to stand still.
What is watched is a count; times of two machines are never compared.
"""

from __future__ import annotations

import contextlib
import json
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from rrmctl.errors import UserError
from rrmctl.store.files import is_locked, unreadable
from rrmctl.store.layout import RunFolder
from rrmctl.store.mounts import mount_of
from rrmctl.store.records import read_json
from rrmctl.suspend_clock import WakingTime

#: How long others watch a count that does not change before they take the run over, seconds; `lease_s` says which.
LEASE_S = 30.0

#: The same where signs of life go over a network: a server that is started anew takes none for a minute or two.
NETWORK_LEASE_S = 120.0


def lease_s(results: Path) -> float:
    """How long the owner of a run in this results root may be silent, seconds."""
    return NETWORK_LEASE_S if mount_of(results).network else LEASE_S


class Machine(NamedTuple):
    """Where a process lives: what shares a kernel shares its locks."""

    host: str
    boot: str  #: another one after each start of the machine; empty where the system tells none

    def tells_of(self, other: Machine) -> bool:
        """Whether a free lock, seen here, means that the process there is dead: it was here, or before a restart."""
        return self.host == other.host or self.boot == other.boot != ""


_boot = ""  # the name alone has to do
with contextlib.suppress(OSError):
    _boot = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
HERE = Machine(socket.gethostname(), _boot)


@dataclass(frozen=True)
class Beat:
    """Contents of an owner's file; equal to another if it is the same owner's same sign of life."""

    owner: str
    count: int
    machine: Machine = field(default_factory=lambda: HERE, compare=False)  #: the owner's

    def encoded(self) -> bytes:
        """The file's bytes: a JSON object."""
        return json.dumps({"owner": self.owner, "count": self.count, **self.machine._asdict()}).encode()


def last_owner(folder: RunFolder) -> int:
    """The number of whoever took the run last, whether or not it owns it still; 0 where nobody has.

    That lists the folder, without which NFS may hold for half a minute that what others made is not there.
    """
    try:
        return max(folder.leases(), default=0)
    except OSError as error:
        raise unreadable(folder.path, error) from error


def read_beat(folder: RunFolder, number: int | None = None) -> Beat | None:
    """The last sign of life, of the owner of that number or of the last; None where there is none that can be read, as
    of one that has given the run back.
    """
    try:
        value = read_json(folder.lease_of(last_owner(folder) if number is None else number))
        if value is None:
            return None
        # Earlier versions named no machine: theirs is taken for this one.
        machine = Machine(str(value["host"]), str(value["boot"])) if "host" in value else HERE
        return Beat(str(value["owner"]), int(value["count"]), machine)
    except (UserError, ValueError, TypeError, KeyError):
        return None


def owned(beat: Beat | None, *, locked: bool, here: Machine, silent: Beat | None = None) -> bool:
    """Whether a run is somebody's: whose last sign of life is `beat`, whose lock is held as far as can be seen `here`,
    and not if it is `silent`: nothing has followed that for as long as a lease lasts.
    """
    if beat is None:
        return locked
    return beat != silent and (locked or not here.tells_of(beat.machine))


def is_free(beat: Beat | None, silent: Beat | None) -> bool:
    """Whether one who holds the lock here may take the run up. Arguments as in `owned`."""
    return not owned(beat, locked=False, here=HERE, silent=silent)


def is_owned(folder: RunFolder) -> bool:
    """Whether a run is somebody's now. Works on folders that cannot be written."""
    return owned(read_beat(folder), locked=is_locked(folder.lock), here=HERE)


class Watch:
    """Looks at the leases of other processes, by the clock of what this process has lived through."""

    def __init__(self, lease_s: float = LEASE_S, clock: Callable[[], float] | None = None) -> None:
        self._lease_s = lease_s
        self._clock = clock or WakingTime()
        self._seen: dict[str, tuple[Beat | None, float]] = {}

    def expired(self, folder: RunFolder) -> Beat | None:
        """The owner's last sign of life, if nothing has followed it for the length of a lease: once each time."""
        beat, now = read_beat(folder), self._clock()
        before, since = self._seen.get(folder.id, (None, now))
        silent = beat is not None and beat == before
        if silent and now - since < self._lease_s:
            return None
        self._seen[folder.id] = (beat, now)
        return beat if silent else None
