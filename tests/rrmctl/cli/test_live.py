"""What a person reads while a sweep runs."""

from __future__ import annotations

import io
import re
from pathlib import Path

import pytest

from rrmctl.cli.live import Bars, Lines, score
from rrmctl.running.scheduler import Outcome, Stage
from rrmctl.store.layout import Layout
from rrmctl.store.status import ErrorKind, RunError
from rrmctl.store.sweeps import Job
from rrmctl.terminal import console

JOBS = [
    Job(id=run, cell="", task="t", method="pebble", teacher="-", feedback="-", seed=seed, steps=1000)
    for seed, run in enumerate("ab")
]


def failure(kind: ErrorKind = ErrorKind.CRASHED) -> Outcome:
    return Outcome(Stage.FAILED, RunError(kind=kind, type="RuntimeError", message="boom [not markup]"))


def tell(view: Lines) -> None:
    """A short sweep: one run is done, one crashes twice."""
    view.started("a", 1)
    view.row("a", 100, 0.5, 12.0)
    view.row("a", 200, 0.6, 12.0)
    view.note("a", "prior [odd]")
    view.ended("a", Outcome(Stage.DONE), Stage.DONE)
    view.started("b", 2)
    view.ended("b", failure(), Stage.WAITING)
    view.ended("b", failure(), Stage.FAILED)
    view.stopping(1, 60.0)


def lines(tmp_path: Path, **options: object) -> list[str]:
    out = io.StringIO()
    layout = Layout(tmp_path)
    layout.run("b").path.mkdir(parents=True)
    layout.run("b").log.write_text("first\nTraceback: boom\n")
    tell(Lines(console(out, width=60, **options), layout, JOBS))
    return [re.sub(r"\d\d:\d\d:\d\d", "TIME", line) for line in out.getvalue().splitlines()]


def test_plain_lines(tmp_path: Path) -> None:
    """One whole line an event, evaluations no more often than every few seconds, crashes with the end of their log."""
    tail = ["    first", "    Traceback: boom", f"    log: {tmp_path}/runs/b/log.txt"]
    assert lines(tmp_path) == [
        "TIME t pebble seed 0: started",
        "TIME t pebble seed 0: step 100 of 1,000, success 50%",
        "TIME t pebble seed 0: prior [odd]",
        "TIME t pebble seed 0: done (1 of 2)",
        "TIME t pebble seed 1: started, attempt 2",
        "TIME t pebble seed 1: will be tried again: RuntimeError: boom [not markup]",
        *tail,
        "TIME t pebble seed 1: failed: RuntimeError: boom [not markup]",
        *tail,
        "stopping: 1 running job writes a checkpoint, in at most 60 s; Ctrl-C again ends everything at once",
    ]


def test_no_colour_where_none_is_wanted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """NO_COLOR at a terminal leaves no colour codes."""
    monkeypatch.setenv("NO_COLOR", "1")
    assert not any("\x1b[3" in line for line in lines(tmp_path, force_terminal=True))


def test_a_mistake_is_told_without_its_log(tmp_path: Path) -> None:
    """The message says it all."""
    out = io.StringIO()
    view = Lines(console(out, width=200), Layout(tmp_path), JOBS)
    view.ended("a", failure(ErrorKind.REFUSED), Stage.FAILED)
    assert out.getvalue().count("\n") == 1


def test_bars(tmp_path: Path) -> None:
    """A bar per running job with step rate, last score and time left; one for all; gone when the job is over."""
    out = io.StringIO()
    view = Bars(console(out, width=120, force_terminal=True), Layout(tmp_path), JOBS)
    view.started("a", 1)
    view.started("b", 1)
    view.beat("a", 500, 10.0)
    view.row("a", 500, None, 12.34)
    view.tick()
    shown = {task.description: task for task in view.progress.tasks}
    assert list(shown) == ["0 of 2 runs", "t pebble seed 0", "t pebble seed 1"]
    bar = shown["t pebble seed 0"]
    assert (bar.completed, bar.total) == (500, 1000)
    assert bar.fields == {"rate": "10 steps/s", "score": "return 12.3", "left": "50 s"}
    assert shown["0 of 2 runs"].fields["left"] == "2 min"
    view.ended("a", Outcome(Stage.DONE), Stage.DONE)
    view.tick()
    assert [task.description for task in view.progress.tasks] == ["1 of 2 runs", "t pebble seed 1"]
    assert view.progress.tasks[0].completed == 1


@pytest.mark.parametrize(
    ("success", "true_return", "told"),
    [(0.8, 5.0, "success 80%"), (None, 1234.56, "return 1,234.6"), (None, None, "")],
)
def test_score(success: float | None, true_return: float | None, told: str) -> None:
    """Success where the task has it, else the return."""
    assert score(success, true_return) == told
