"""What people are asked in a results root and what they said: the sessions that are open, and all answers as one."""

from __future__ import annotations

import contextlib
import dataclasses
import os
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from rrm.errors import LabelError
from rrm.files import make_folder, refresh
from rrm.teachers.labels import TRAIN, Label, live, read_labels, write_labels
from rrm.teachers.published import published_steps, read_session, session_path
from rrmctl.errors import UserError
from rrmctl.store.files import storage_error, try_lock
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.status import RunState, Status


@dataclass(frozen=True)
class OpenSession:
    """Queries that a run has put before people, whose answers are not all there and sealed."""

    run: str
    step: int  #: environment step before which they are asked
    asked: int  #: queries
    missing: int  #: of them that have no answer


def open_sessions(folder: RunFolder) -> list[OpenSession]:
    """Of one run, the oldest first. Where nothing has changed since the last look, files are not read again.

    Raises LabelError, or OSError, where a file cannot be read.
    """
    found: list[OpenSession] = []
    for step in reversed(published_steps(folder.path)):  # behind one that is sealed all are
        asked = _asked(*_stamped(session_path(folder.path, step)))
        sealed = _answered(*_stamped(folder.labels), folder.id)
        answers = [sealed[step, index] for index in asked if (step, index) in sealed]
        if len(answers) == len(asked) and all(answers):
            break
        found.append(OpenSession(folder.id, step, len(asked), len(asked) - len(answers)))
    return found[::-1]


def waits_for(folder: RunFolder, status: Status) -> OpenSession | None:
    """What people are asked by a run that waits for it: its oldest open session.

    None also where that cannot be read; its worker will say why.
    """
    if status.state is not RunState.WAITING:
        return None
    try:
        return next(iter(open_sessions(folder)), None)
    except (LabelError, OSError):
        return None


def published(folder: RunFolder) -> bool:
    """Whether the run has put anything before people."""
    return bool(published_steps(folder.path))


def _stamped(path: Path) -> tuple[Path, tuple[int, int] | None]:
    """A file as it is now: one that is replaced is another; None where there is none."""
    try:
        refresh(path.parent)
        stat = path.stat()
    except FileNotFoundError:
        return path, None
    return path, (stat.st_mtime_ns, stat.st_ino)


@lru_cache(4096)
def _asked(path: Path, _stamp: object) -> tuple[int, ...]:
    return tuple(query.index for query in read_session(path).queries)


@lru_cache(256)
def _answered(path: Path, _stamp: object, run: str) -> dict[tuple[int, int], bool]:
    """Step and index of every query of the run that has an answer, and whether that is sealed."""
    own = live(label for label in read_labels(path) if label.run == run)
    return {key: label.sealed for key, label in own.items()}


def stored_labels(layout: Layout, runs: Iterable[str]) -> list[Label]:
    """Every answer to these runs, in their order, then those that belong to no run. Raises LabelError."""
    paths = [*(layout.run(run).labels for run in runs), layout.extra_labels]
    return [label for path in paths for label in read_labels(path)]


def import_labels(layout: Layout, labels: Iterable[Label], where: str) -> dict[str, int]:
    """Add answers to the runs they belong to, all of them or none; how many were new, by run, "" for those of none.

    An answer that is there is not added again. What its file says in addition, that it was undone or sealed, is taken
    over where it is not sealed here.

    Raises:
        UserError: they are of runs that the store does not know, or a question has another answer here already.
        LabelError: a file of the store cannot be read.
        StorageError: the store takes no write.
    """
    by_run: defaultdict[str, list[Label]] = defaultdict(list)
    for label in labels:
        by_run[label.run].append(label)
    if unknown := [run for run in by_run if run and not layout.run(run).config.exists()]:
        more = f" and {len(unknown) - 1} more" if len(unknown) > 1 else ""
        raise UserError(
            f"{where} answers run {unknown[0]}{more}, which {layout.root} does not know",
            "begin the experiment there first, with the profile, seeds and settings of those runs: they wait for "
            "people; then import again",
        )
    with _writing(layout):
        paths = {run: layout.run(run).labels if run else layout.extra_labels for run in by_run}
        before = {run: read_labels(path) for run, path in paths.items()}
        after = {run: _united(before[run], new, where) for run, new in by_run.items()}
        for run, path in paths.items():
            try:
                make_folder(path.parent)
                write_labels(path, after[run])
            except OSError as error:
                raise storage_error(path, error) from error
    return {run: len(after[run]) - len(before[run]) for run in by_run}


@contextlib.contextmanager
def _writing(layout: Layout) -> Iterator[None]:
    lock = try_lock(layout.labels_lock)
    if lock is None:
        raise UserError(f"a server of labels collects answers in {layout.root} just now", "end it first")
    try:
        yield
    finally:
        os.close(lock)


def _united(here: list[Label], new: list[Label], where: str) -> list[Label]:
    """Answers to one run, those that are here first; of one in both, what happened to it in either."""
    rows = {_same(label): label for label in here}
    for label in new:
        before = rows.get(_same(label), label)
        flags = {name: getattr(before, name) or getattr(label, name) for name in ("undone", "sealed")}
        rows[_same(label)] = before if before.sealed else dataclasses.replace(before, **flags)
    counted: dict[tuple[int, int], Label] = {}
    for label in rows.values():
        if label.purpose != TRAIN or label.undone:
            continue
        other = counted.setdefault((label.step, label.index), label)
        if other is not label:
            raise UserError(
                f"{where} and the store differ in run {label.run}: query {label.index} before step {label.step} was "
                f"answered by {other.annotator} here, by {label.annotator} there",
                "nothing was imported; answers to one run come from one study",
            )
    return list(rows.values())


def _same(label: Label) -> Label:
    """What an answer is, whatever became of it."""
    return dataclasses.replace(label, undone=False, sealed=False)
