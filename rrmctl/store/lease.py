"""Who may write into a run's folder: its last owner, for as long as it shows signs of life.

    lease-N.json  the Nth owner's token, its machine, and a count that it raises every few seconds
    lock          held by the owner until it ends; the system frees the lock of a process that dies, at once
    guard         held for the moment of every write into the folder, under which the owner sees that it is the last

Owner N is whoever makes `lease-N.json`: of many who try, on whatever machine, one does (`rrm.files.create`). It may be
tried where the owner before has given the run back, is dead (`rrmctl.store.owner`), or was watched to be silent for a
lease. Numbers only rise. That a run has one owner therefore hangs on no lock and no clock: both say only when it is
time to try, and if that was a mistake the earlier owner loses the work since its last write, and nothing else.

A process that is stopped (SIGSTOP, a frozen container) does not die and keeps its lock: one who takes its run over puts
a new file in the lock's place. Should it wake, it finds a later owner before its next write, which does not happen.

The guard is not taken from anybody: what its holder writes must be whole first. One that was stopped in the middle of
it is waited for until it wakes or dies. Where locks do not reach the other machine (`rrmctl.store.mounts`) nobody sees
that, and both can be inside. Its files are replaced as a whole, so that nothing is torn, by bytes of the same run at an
earlier step; and its successor removes those that it had begun and not yet put in place, so that its write fails with
LeaseLostError. One that had looked and begun no file, or was about to add to a log of the checkpoint or to remove
something, still does so when it wakes: that one write, and no other. Checksums tell where it matters to a checkpoint.
"""

from __future__ import annotations

import contextlib
import math
import os
import secrets
import threading
from collections.abc import Callable, Iterator

from rrm.files import beside, create, replace
from rrmctl.store.files import StorageError, is_open_at, open_lock, storing, try_lock, wait_for
from rrmctl.store.layout import RunFolder
from rrmctl.store.owner import Beat, is_free, last_owner, read_beat

#: How often the owner raises its count, seconds.
BEAT_S = 2.0


class LeaseLostError(Exception):
    """Another process owns the run by now: what this one did since its last write is not worth keeping."""


#: Why a sign of life may be left out: the next row finds out what is the matter, and nobody's run ends for a beat.
_NO_MATTER = (LeaseLostError, StorageError, OSError)


class Lease:
    """Ownership of a run, from `take` until `release`. Signs of life are given by a thread of its own."""

    def __init__(self, folder: RunFolder, number: int, token: str, lock: int, waiting: Callable[[], None]) -> None:
        """What `take` has won."""
        self.folder = folder  #: of the run
        self._number, self._token, self._count = number, token, 1
        self._lock = lock
        self._waiting = waiting
        self._released = threading.Event()
        self._inside = False  # of a write
        self._ending = threading.Lock()  # around its end, and signs of life inside it
        self._umask = os.umask(0o077)  # to be asked it has to be set
        os.umask(self._umask)
        threading.Thread(target=self._live, daemon=True).start()

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
            stale: the sign of life that nothing has followed for as long as a lease lasts: its owner is not waited for.
            waiting: called again and again while somebody else holds the guard, now and in `writing`.
        """
        lock = try_lock(folder.lock, patience_s)
        if lock is None:
            return None if stale is None else cls._take_over(folder, stale, waiting)
        lease = None
        try:
            number = last_owner(folder)
            if is_free(read_beat(folder, number), stale):
                with _guarded(folder, waiting):
                    # Not open there: the run was taken over while nobody had it.
                    if is_open_at(lock, folder.lock) and (token := _claim(folder, number + 1)):
                        lease = cls(folder, number + 1, token, lock, waiting)
        finally:
            if lease is None:
                os.close(lock)
        return lease

    @classmethod
    def _take_over(cls, folder: RunFolder, stale: Beat, waiting: Callable[[], None]) -> Lease | None:
        """Of one that is stopped and holds the lock."""
        guard = try_lock(folder.guard)
        if guard is None:
            return None  # it is writing, or was stopped in the middle of it: what it writes must be whole first
        try:
            number = last_owner(folder)
            if read_beat(folder, number) != stale:
                return None  # it lives, or somebody else was quicker
            return cls._relocked(folder, number + 1, waiting)
        finally:
            os.close(guard)

    @classmethod
    def _relocked(cls, folder: RunFolder, number: int, waiting: Callable[[], None]) -> Lease | None:
        """Claim a run whose lock is another's. The new one is held before it stands in the old one's place: somebody
        who came between would have the lock of a run that is not theirs.
        """
        new = beside(folder.lock)
        lock, lease = try_lock(new), None
        try:
            if lock is not None and (token := _claim(folder, number)):  # without space for it all stays as it is
                with storing(folder.lock):
                    new.replace(folder.lock)
                lease = cls(folder, number, token, lock, waiting)
        finally:
            if lease is None:
                new.unlink(missing_ok=True)
                if lock is not None:
                    os.close(lock)
        return lease

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
            except (OSError, StorageError):
                self._see_ownership()  # a later owner removes what this one was about to put in place
                raise
            finally:
                with self._ending:
                    self._inside = False

    def release(self) -> None:
        """Leave the run to others."""
        self._released.set()
        with contextlib.suppress(*_NO_MATTER), self.writing(brief=True):
            os.truncate(self.folder.lease_of(self._number), 0)  # for which a full disk has room
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
        if last_owner(self.folder) != self._number:
            raise LeaseLostError(f"{self.folder.id} belongs to another process by now")

    def _write(self) -> None:
        self._count += 1
        path = self.folder.lease_of(self._number)
        with storing(path):
            replace(path, Beat(self._token, self._count).encoded())


def _claim(folder: RunFolder, number: int) -> str | None:
    """Become the owner of that number: the token of its signs of life; None where another is, or there is a later one.

    Under the guard, so that where that works everywhere a write before it is whole.
    """
    token, path = secrets.token_hex(8), folder.lease_of(number)
    with storing(path):
        if not create(path, Beat(token, 1).encoded()):
            return None
        if last_owner(folder) != number:  # others had the run, and gave it back, since one looked
            path.unlink()
            return None
        for earlier in folder.leases():
            if earlier < number:
                folder.lease_of(earlier).unlink(missing_ok=True)
        begun = tuple(f".{file.name}." for file in (folder.status, *folder.trained()))
        for temporary in folder.path.glob(".*.tmp"):
            if temporary.name.startswith(begun):
                temporary.unlink(missing_ok=True)
    return token


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
