"""Whether anybody owns a run, as seen from this machine: judged by its lock and by its owner's signs of life.

A lock that is held is held. One that is free means that the owner is dead, but only on the owner's own machine: some
file systems keep locks to the machine that took them. An owner elsewhere is dead when its signs of life have been
watched to stand still. What is watched is a count; times of two machines are never compared.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from rrmctl.errors import UserError
from rrmctl.store.files import is_locked, try_lock
from rrmctl.store.layout import RunFolder
from rrmctl.store.records import read_json
from rrmctl.suspend_clock import WakingTime

#: How long others watch a count that does not change before they take the run over, seconds.
LEASE_S = 30.0


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
    """Contents of `lease.json`; equal to another if it is the same owner's same sign of life."""

    owner: str
    count: int
    machine: Machine = field(default_factory=lambda: HERE, compare=False)  #: the owner's

    def to_json(self) -> dict[str, Any]:
        """A JSON object."""
        return {"owner": self.owner, "count": self.count, **self.machine._asdict()}


def read_beat(folder: RunFolder) -> Beat | None:
    """The last sign of life; None where there is none, or none that can be read."""
    try:
        value = read_json(folder.lease)
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


def is_owned(folder: RunFolder) -> bool:
    """Whether a run is somebody's now. Works on folders that cannot be written."""
    return owned(read_beat(folder), locked=is_locked(folder.lock), here=HERE)


def lock_free(folder: RunFolder, patience_s: float = 0.0, silent: Beat | None = None) -> int | None:
    """Take the lock of a run that is nobody's; None where it is somebody's. Arguments as in `try_lock` and `owned`."""
    lock = try_lock(folder.lock, patience_s)
    if lock is None:
        return None
    with contextlib.suppress(OSError):
        list(folder.path.iterdir())  # NFS may hold for half a minute that there is no lease, unless it is listed
    if owned(read_beat(folder), locked=False, here=HERE, silent=silent):
        os.close(lock)
        return None
    return lock


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
