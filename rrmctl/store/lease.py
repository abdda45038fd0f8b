"""Who may write into a run's folder: the holder of its lock, for as long as it shows signs of life.

    lock        held by the owner until it ends; the system frees the lock of a process that dies, at once
    lease.json  the owner's token, its machine, and a count that it raises every few seconds
    guard       held for the moment of every write into the folder, under which the owner sees that it still owns it

A process that is stopped (SIGSTOP, a frozen container) does not die and keeps its lock, and that of one on another
machine may not be seen here (`rrmctl.store.owner`). Whoever has watched one and the same count for `LEASE_S` of its own
clock may take the run over: under the guard it puts its own token into the lease and, where the lock is held, a new
file in its place. Should the other one wake, its next write finds a foreign token and does not happen.

The guard is not taken from anybody: what its holder writes must be whole first. One that was stopped in the middle of
it is waited for until it wakes or dies.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import secrets
import threading
from collections.abc import Callable, Iterator

from rrm.files import replace
from rrmctl.store.files import StorageError, is_open_at, open_lock, storage_error, try_lock, wait_for
from rrmctl.store.layout import RunFolder
from rrmctl.store.owner import Beat, lock_free, read_beat

#: How often the owner raises its count, seconds.
BEAT_S = 2.0


class LeaseLostError(Exception):
    """Another process owns the run by now: what this one did since its last write is not worth keeping."""


#: Why a sign of life may be left out: the next row finds out what is the matter, and nobody's run ends for a beat.
_NO_MATTER = (LeaseLostError, StorageError, OSError)


class Lease:
    """Ownership of a run, from `take` until `release`. Signs of life are given by a thread of its own."""

    def __init__(self, folder: RunFolder, waiting: Callable[[], None]) -> None:
        """Puts its token into the lease. Under the guard, and `_hold` makes it the owner."""
        self.folder = folder  #: of the run
        self._waiting = waiting
        self._owner = secrets.token_hex(8)
        self._count = 0
        self._released = threading.Event()
        self._inside = False  # of a write
        self._ending = threading.Lock()  # around its end, and signs of life inside it
        self._umask = os.umask(0o077)  # to be asked it has to be set
        os.umask(self._umask)
        self._write()

    def _hold(self, lock: int) -> Lease:
        self._lock = lock
        threading.Thread(target=self._live, daemon=True).start()
        return self

    @classmethod
    def take(
        cls,
        folder: RunFolder,
        *,
        patience_s: float = 0.0,
        stale: Beat | None = None,
        waiting: Callable[[], None] = lambda: None,
    ) -> Lease | None:
        """Become the owner, or None where another process is.

        Args:
            patience_s: to wait for the lock, seconds; readers hold it for an instant.
            stale: the sign of life that nothing has followed for `LEASE_S`: its owner is not waited for.
            waiting: called again and again while somebody else holds the guard, now and in `writing`.
        """
        lock = lock_free(folder, patience_s, stale)
        if lock is not None:
            with _guarded(folder, waiting):
                if is_open_at(lock, folder.lock):
                    return cls(folder, waiting)._hold(lock)
            os.close(lock)  # the run was taken over while nobody had it
        guard = None if stale is None else try_lock(folder.guard)
        if guard is None:
            return None  # it is writing, or was stopped in the middle of it: what it writes must be whole first
        try:
            if read_beat(folder) != stale:
                return None  # it lives, or somebody else was quicker
            lease = cls(folder, waiting)  # where there is no space for it everything stays as it is
            folder.lock.unlink(missing_ok=True)
            lock = try_lock(folder.lock)
            return None if lock is None else lease._hold(lock)
        finally:
            os.close(guard)

    @contextlib.contextmanager
    def writing(self, *, brief: bool = False) -> Iterator[None]:
        """Around every write into the run's folder, and not inside another one. Waits for the guard; in `brief` no
        longer than from one sign of life to the next.

        Raises LeaseLostError where the run belongs to another process: nothing may be written.
        """
        with _guarded(self.folder, *((lambda: None, BEAT_S) if brief else (self._waiting, math.inf))):
            self._see_ownership()
            os.umask(self._umask)  # code of the user's may have set another
            self._inside = True
            try:
                yield
            finally:
                with self._ending:
                    self._inside = False

    def release(self) -> None:
        """Leave the run to others."""
        self._released.set()
        with contextlib.suppress(*_NO_MATTER), self.writing(brief=True):
            self.folder.lease.unlink(missing_ok=True)
        os.close(self._lock)

    def _live(self) -> None:
        while not self._released.wait(BEAT_S):
            with contextlib.suppress(*_NO_MATTER):
                with self._ending:
                    if inside := self._inside:  # a write that takes long; where the guard is not seen, silence is death
                        self._see_ownership()
                        self._write()
                if not inside:
                    with self.writing(brief=True):
                        self._write()

    def _see_ownership(self) -> None:
        beat = read_beat(self.folder)
        # One that is gone is not ours either: whoever took the run over has finished with it.
        if beat is None or beat.owner != self._owner:
            raise LeaseLostError(f"{self.folder.id} belongs to another process by now")

    def _write(self) -> None:
        self._count += 1
        try:
            replace(self.folder.lease, json.dumps(Beat(self._owner, self._count).to_json()).encode())
        except OSError as error:
            raise storage_error(self.folder.lease, error) from error


@contextlib.contextmanager
def _guarded(folder: RunFolder, waiting: Callable[[], None], patience_s: float = math.inf) -> Iterator[None]:
    """Hold the guard. Raises TimeoutError where others held it all the while, StorageError where it cannot be made."""
    descriptor = open_lock(folder.guard)
    try:
        if not wait_for(descriptor, patience_s, waiting):
            raise TimeoutError(f"{folder.guard} is held by another process")
        yield
    finally:
        os.close(descriptor)
