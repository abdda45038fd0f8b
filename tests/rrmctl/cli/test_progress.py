"""How far groups of runs are, and what is left of them."""

from __future__ import annotations

import pytest

from rrmctl.cli.progress import Group, errors, group_by_row, group_by_sweep
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, speeds
from rrmctl.store.sweeps import Job, SweepRecord


def job(run: str, method: str = "pebble", seed: int = 0) -> Job:
    return Job(
        id=run, cell=method, task="t", method=method, teacher="-", feedback="-", seed=seed, steps=1000
    )  # fmt: skip


def failed(message: str) -> Status:
    return Status(state=RunState.FAILED, error=RunError(kind=ErrorKind.CRASHED, type="E", message=message))


DONE = Status(state=RunState.DONE, step=1000, steps=1000, wall_s=10.0, steps_per_s=1.0)
RUNNING = Status(state=RunState.RUNNING, step=600, steps=1000, steps_per_s=50.0)


def test_the_speed_of_a_finished_run_counts_its_evaluations() -> None:
    """1000 steps in 10 s are 100 steps/s, whatever its last beat said; the median goes over runs of one kind."""
    jobs = [job("a"), job("b"), job("c", "oracle"), job("d", "rrm")]
    states = {"a": DONE, "b": RUNNING, "c": RUNNING, "d": Status()}
    assert speeds(jobs, states) == {("t", "pebble"): 75.0, ("t", "oracle"): 50.0}


def test_time_left_is_steps_left_at_the_speed_of_their_kind() -> None:
    """400 steps of the running one and 1000 of the one that waits, at 50 a second, by one worker."""
    group = Group("g", [job("a"), job("b")], {"a": RUNNING, "b": Status()})
    assert group.seconds_left == 28.0
    assert group.open == 2
    assert group.left == "28 s"


@pytest.mark.parametrize(
    ("states", "told"),
    [
        ({"a": DONE, "b": failed("x")}, ""),
        ({"a": DONE, "b": Status()}, "10 s of one core"),
        ({"a": Status(), "b": Status()}, ""),
        ({"a": RUNNING, "b": RUNNING}, "8 s"),
    ],
)
def test_what_is_left_in_words(states: dict[str, Status], told: str) -> None:
    """Nothing once all is over or nothing is known; core time while nothing runs; shared time while workers do."""
    assert Group("g", [job("a"), job("b")], states).left == told


def test_groups() -> None:
    """A sweep counts a run that two of its rows share once; a row stands for all seeds."""
    shared = job("a")
    jobs = (shared, job("b", seed=1), job("c", "oracle"), job("a", "other-name"))
    states = {"a": DONE, "b": RUNNING, "c": failed("x")}
    sweep = SweepRecord(experiment="e", variant="smoke", profile="smoke", jobs=jobs)
    (whole,) = group_by_sweep([sweep], states)
    assert (whole.name, len(whole.jobs), dict(whole.counts)) == (
        "e (smoke)",
        3,
        {"done": 1, "running": 1, "failed": 1},
    )
    rows = group_by_row([sweep], states)
    assert [(row.name, len(row.jobs)) for row in rows] == [
        ("smoke  t  pebble", 2),
        ("smoke  t  oracle", 1),
        ("smoke  t  other-name", 1),
    ]


def test_errors_are_grouped_and_the_most_frequent_comes_first() -> None:
    """One line for each thing that went wrong, not for each run."""
    jobs = [job(run) for run in "abcd"]
    states = {"a": failed("rare"), "b": failed("often"), "c": failed("often"), "d": DONE}
    found = errors(jobs, states)
    assert [(message, [j.id for j in runs]) for message, runs in found.items()] == [
        ("E: often", ["b", "c"]),
        ("E: rare", ["a"]),
    ]
