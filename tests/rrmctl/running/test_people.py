"""Runs that ask people, in real processes: who waits for whom, and for how long."""

from __future__ import annotations

import signal
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rrm.teachers.labels import read_labels
from rrmctl.cli.app import app
from rrmctl.errors import Exit
from rrmctl.running.supervisor import Terms
from rrmctl.store.labels import OpenSession
from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState
from tests.rrm.teachers.people import answer
from tests.rrmctl.running.standin import expected, prepare
from tests.rrmctl.running.test_supervisor import (  # noqa: F401 (a fixture)
    Record,
    attempts,
    behave,
    meanwhile,
    parent,
    pool,
    rows,
    states,
    until,
)
from tests.rrmctl.store.test_labels import ask


class Heard(Record):
    """Keeps what people are asked."""

    def __init__(self) -> None:
        super().__init__()
        self.sessions: list[list[OpenSession]] = []

    def asked(self, sessions: Sequence[OpenSession]) -> None:
        self.sessions.append(list(sessions))


def asking(root: Path, seeds: range) -> Layout:
    """A results folder in which the run of seed 0 will ask three questions half-way."""
    layout, assigned = prepare(root, seeds)
    ask(root / "asked" / assigned[0].id, assigned[0].id, step=25)
    return layout


@pytest.mark.slow
def test_a_run_goes_on_when_people_have_answered(tmp_path: Path, behave: Callable[..., None]) -> None:  # noqa: F811
    """It leaves its slot to the others; the command stays up, says what lacks, and starts the run once it is sealed."""
    behave(s0="ask")
    layout, assigned = asking(tmp_path, range(2)), prepare(tmp_path, range(2))[1]
    folder, heard = layout.run(assigned[0].id), Heard()

    def people() -> None:
        until(lambda: states(layout, assigned) == [RunState.WAITING, RunState.DONE])
        told = CliRunner().invoke(app, ["status", "--results", str(tmp_path)]).stdout
        assert f"1 run waits for 3 answers: rrmctl label stand-in --results {tmp_path}" in told.replace("\n", " ")
        assert "waiting for" not in told
        answer(folder.path, most=2)
        until(lambda: [OpenSession(folder.id, 25, 3, 1)] in heard.sessions)
        assert attempts(layout, assigned) == [1, 1]
        answer(folder.path)

    with meanwhile(people):
        assert pool(layout, assigned, heard, slots=1).run() is Exit.DONE
    assert attempts(layout, assigned) == [2, 1]
    assert rows(tmp_path) == expected(range(2))
    assert heard.sessions[-1] == []


@pytest.mark.slow
def test_what_waits_already_is_not_started(tmp_path: Path, behave: Callable[..., None]) -> None:  # noqa: F811
    """A command that finds a run with open questions starts nothing, and leaves with 75 when it is told to."""
    behave(s0="ask")
    with parent(tmp_path, 1, 1) as program:
        layout, assigned = asking(tmp_path, range(1)), prepare(tmp_path, range(1))[1]
        until(lambda: states(layout, assigned) == [RunState.WAITING])
        program.send_signal(signal.SIGINT)
        assert program.wait(60) == Exit.INCOMPLETE
    heard = Heard()
    with meanwhile(lambda: (until(lambda: len(heard.sessions) > 1), answer(layout.run(assigned[0].id).path))):
        assert pool(layout, assigned, heard).run() is Exit.DONE
    assert heard.sessions[0] == [OpenSession(assigned[0].id, 25, 3, 3)]
    assert attempts(layout, assigned) == [2]
    assert rows(tmp_path) == expected(range(1))


@pytest.mark.slow
def test_training_anew_keeps_what_people_said(tmp_path: Path, behave: Callable[..., None]) -> None:  # noqa: F811
    """`--force` removes what was trained and what was published, and the run finds its answers again."""
    behave(s0="ask")
    layout, assigned = asking(tmp_path, range(1)), prepare(tmp_path, range(1))[1]
    folder = layout.run(assigned[0].id)
    ask(folder.path, folder.id, step=25)
    answer(folder.path)
    labels = read_labels(folder.labels)
    assert pool(layout, assigned).run() is Exit.DONE
    anew = {folder.id: Terms(attempt=1, fresh=True)}
    assert pool(layout, assigned, terms=anew).run() is Exit.DONE
    assert (read_labels(folder.labels), folder.queries.exists()) == (labels, False)
    assert rows(tmp_path) == expected(range(1))


@pytest.mark.slow
def test_a_file_that_cannot_be_read_is_left_to_the_run(tmp_path: Path, behave: Callable[..., None]) -> None:  # noqa: F811
    """Damaged answers stop no command: the run is started, and it says what is wrong."""
    behave(s0="ask")
    layout, assigned = asking(tmp_path, range(2)), prepare(tmp_path, range(2))[1]
    folder = layout.run(assigned[0].id)
    watcher = Record()

    def damage() -> None:
        until(lambda: states(layout, assigned) == [RunState.WAITING, RunState.DONE])
        folder.labels.write_bytes(b"PAR1 and no more")

    with meanwhile(damage):
        assert pool(layout, assigned, watcher).run() is Exit.FAILED
    assert "cannot be read as labels" in watcher.errors[-1]
    assert folder.labels.read_bytes() == b"PAR1 and no more"
