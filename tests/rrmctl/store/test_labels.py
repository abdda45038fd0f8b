"""The answers of people in a results root: what is open, and how they are taken along."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rrm.errors import LabelError
from rrm.teachers.labels import FIRST, SECOND, SHARED, Label, live, read_labels, write_labels
from rrm.teachers.published import (
    PlayedEpisode,
    PublishedQuery,
    PublishedSession,
    ShownSegment,
    publish,
    read_session,
    session_path,
)
from rrmctl.errors import UserError
from rrmctl.store.files import try_lock
from rrmctl.store.labels import OpenSession, import_labels, open_sessions, stored_labels, waits_for
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.status import RunState, Status
from tests.rrm.teachers.people import answer, label, sealed
from tests.rrmctl.running.standin import prepare


def ask(folder: Path, run: str, step: int, queries: int = 3, first: int = 0) -> PublishedSession:
    """Publish a session of a run, about nothing."""
    segments = [ShownSegment(f"{number:016x}", 0, 0, float(number)) for number in range(2)]
    asked = tuple(PublishedQuery(i, f"{i:016x}", *segments) for i in range(first, first + queries))
    session = PublishedSession(run=run, task="toy-car", step=step, length=1, repeat=1, horizon=100, queries=asked)
    nothing = np.zeros((2, 15), np.float32)
    publish(folder, session, [PlayedEpisode({"steps": 0}, nothing, np.zeros((1, 2), np.float32))])
    return session


def asked(root: Path, seeds: range = range(1)) -> list[RunFolder]:
    """Runs that ask three questions each."""
    layout, jobs = prepare(root, seeds)
    folders = [layout.run(job.id) for job in jobs]
    for folder in folders:
        ask(folder.path, folder.id, 25)
    return folders


def test_what_is_open(tmp_path: Path) -> None:
    """A session is open until all its answers are sealed; older ones come first, sealed ones not at all."""
    (folder,) = asked(tmp_path)
    assert open_sessions(folder) == [OpenSession(folder.id, 25, 3, 3)]
    answer(folder.path, most=2)
    assert open_sessions(folder) == [OpenSession(folder.id, 25, 3, 1)]
    answer(folder.path, seal=False)
    assert open_sessions(folder) == [OpenSession(folder.id, 25, 3, 0)]
    sealed(folder.path)
    assert open_sessions(folder) == []
    ask(folder.path, folder.id, 50, first=3)
    ask(folder.path, folder.id, 100, first=6)
    assert [session.step for session in open_sessions(folder)] == [50, 100]
    waiting = Status(state=RunState.WAITING)
    assert waits_for(folder, waiting) == OpenSession(folder.id, 50, 3, 3)
    assert waits_for(folder, Status(state=RunState.RUNNING)) is None
    folder.labels.write_bytes(b"nothing")
    assert waits_for(folder, waiting) is None
    with pytest.raises(LabelError):
        open_sessions(folder)


def test_answers_of_another_run_answer_nothing(tmp_path: Path) -> None:
    """At one seed several runs ask the same questions at first."""
    one, other = asked(tmp_path, range(2))
    answer(one.path)
    other.labels.write_bytes(one.labels.read_bytes())
    assert open_sessions(other) == [OpenSession(other.id, 25, 3, 3)]


def test_answers_go_from_one_folder_to_another(tmp_path: Path) -> None:
    """All or none: to runs that are known, once, with those that belong to no run; what came later is taken over."""
    here, there = Layout(tmp_path / "here"), Layout(tmp_path / "there")
    folders, twins = asked(here.root, range(2)), asked(there.root, range(2))
    for folder in folders:
        answer(folder.path, most=2)
    session = read_session(session_path(folders[0].path, 25))
    extra = dataclasses.replace(label(session, session.queries[0], FIRST), run="", purpose=SHARED)
    here.extra_labels.parent.mkdir()
    write_labels(here.extra_labels, [extra])
    runs = [folder.id for folder in folders]
    assert import_labels(there, stored_labels(here, runs), "f") == {runs[0]: 2, runs[1]: 2, "": 1}
    assert stored_labels(there, runs) == stored_labels(here, runs)
    for folder in folders:
        answer(folder.path)
    assert sum(import_labels(there, stored_labels(here, runs), "f").values()) == 2
    assert stored_labels(there, runs) == stored_labels(here, runs)
    assert [open_sessions(twin) for twin in twins] == [[], []]
    before = stored_labels(there, runs)
    unsealed = [dataclasses.replace(each, sealed=False, undone=True) for each in before]
    assert sum(import_labels(there, unsealed, "f").values()) == 0
    assert [each for each in stored_labels(there, runs) if each.run] == [each for each in before if each.run]


def test_what_cannot_be_imported_changes_nothing(tmp_path: Path) -> None:
    """Another answer to the same question, an unknown run, or a server at work: one message each, and no half of it."""
    here, there = Layout(tmp_path / "here"), Layout(tmp_path / "there")
    folders, twins = asked(here.root, range(2)), asked(there.root, range(2))
    for folder in folders:
        answer(folder.path)
    answer(twins[1].path, lambda _: SECOND, annotator="b")
    labels, runs = stored_labels(here, [f.id for f in folders]), [f.id for f in twins]
    before = stored_labels(there, runs)
    with pytest.raises(UserError, match="was answered by b here, by a there"):
        import_labels(there, labels, "f")
    with pytest.raises(UserError, match=r"which .* does not know") as unknown:
        import_labels(there, [*labels, dataclasses.replace(labels[0], run="0" * 16)], "f")
    assert "begin the experiment there first" in str(unknown.value.hint)
    lock = try_lock(there.labels_lock)
    assert lock is not None
    with pytest.raises(UserError, match="collects answers"):
        import_labels(there, labels, "f")
    assert stored_labels(there, runs) == before


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> list[RunFolder]:
    """A run that asks three questions, in two results folders."""
    return [asked(tmp_path_factory.mktemp(name))[0] for name in ("here", "there")]


@settings(max_examples=25)
@given(
    st.lists(st.tuples(st.integers(0, 2), st.sampled_from([FIRST, SECOND, -1, -2, "undo"])), max_size=12),
    st.integers(0, 12),
)
def test_whatever_is_answered_and_undone_one_answer_counts(
    pair: list[RunFolder], said: list[tuple[int, int | str]], cut: int
) -> None:
    """Of every query the newest that is not undone; and likewise in another folder, whose import came half-way too."""
    here, there = pair
    session, labels, expected = read_session(session_path(here.path, 25)), list[Label](), dict[int, int]()
    for folder in pair:
        folder.labels.unlink(missing_ok=True)
    for at, (index, what) in enumerate(said):
        if isinstance(what, int) and index not in expected:
            labels.append(label(session, session.queries[index], what, at=float(at)))
            expected[index] = what
        elif what == "undo" and index in expected:
            del expected[index]
            labels = [dataclasses.replace(each, undone=True) if each.index == index else each for each in labels]
        if at == cut:
            import_labels(Layout(there.results), labels, "f")
    write_labels(here.labels, labels)
    import_labels(Layout(there.results), labels, "f")
    for folder in pair:
        rows = read_labels(folder.labels)
        assert {index: row.answer for (_, index), row in live(rows).items()} == expected
        assert sum(not row.undone for row in rows) == len(expected)
        assert len(rows) == len(labels)
