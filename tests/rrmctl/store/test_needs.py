"""Runs that need others, as the store tells of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from rrmctl.store.files import DamagedError
from rrmctl.store.layout import Layout
from rrmctl.store.snapshot import planned
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, statuses, write_status
from rrmctl.store.sweeps import Job, SweepRecord, read_sweeps, record_sweep

ERROR = RunError(kind=ErrorKind.REFUSED, type="DemosError", message="the expert fails")


def job(digit: str, *requires: str, method: str = "rrm-imitation") -> Job:
    return Job(
        id=digit * 16, cell=digit * 16, task="toy-car", method=method, teacher="-", feedback="-", seed=int(digit, 16),
        steps=10, requires=tuple(each * 16 for each in requires),
    )  # fmt: skip


def chain(root: Path) -> tuple[Layout, SweepRecord]:
    """A sweep of two runs on one prior, which needs two further ones."""
    asked = SweepRecord(
        experiment="e", variant="smoke", profile="smoke", jobs=(job("3", "2"), job("4", "2")),
        needed=(job("0", method="expert"), job("1", "0", method="demos"), job("2", "1", method="airl")),
    )  # fmt: skip
    layout = Layout(root)
    return layout, record_sweep(layout, asked)


def test_a_record_keeps_what_is_needed(tmp_path: Path) -> None:
    """Through the file, and through a second request; one that is asked for as well is there once."""
    layout, record = chain(tmp_path)
    assert read_sweeps(layout) == [record]
    oracle = replace(record.needed[0], method="oracle")
    union = record_sweep(layout, SweepRecord(experiment="e", variant="smoke", profile="smoke", jobs=(oracle,)))
    assert [each.id[0] for each in union.everything] == ["1", "2", "3", "4", "0"]
    assert union.needed == record.needed


def test_what_is_superseded_may_still_be_needed(tmp_path: Path) -> None:
    """An oracle that is the expert of others gives way to another as a job, and stays as their need."""
    oracle = job("0", method="oracle")
    asked = SweepRecord(
        experiment="e", variant="smoke", profile="smoke", jobs=(oracle, job("2", "1")), needed=(job("1", "0"),)
    )
    record_sweep(Layout(tmp_path), asked)
    other = replace(oracle, id="f" * 16)
    union = record_sweep(Layout(tmp_path), replace(asked, jobs=(other,), needed=()))
    assert union.superseded == (oracle,)
    assert union.everything == (oracle, job("1", "0"), other, job("2", "1"))


def test_a_record_from_before_there_were_needs(tmp_path: Path) -> None:
    """Is read: nothing in it needs anything."""
    layout, _ = chain(tmp_path)
    path = layout.sweep("e", "smoke")
    content = json.loads(path.read_text())
    del content["needed"]
    for each in content["jobs"]:
        del each["requires"]
    path.write_text(json.dumps(content))
    (sweep,) = read_sweeps(layout)
    assert sweep.everything == (job("3"), job("4"))


@pytest.mark.parametrize("requires", ["0" * 16, [3], ["../.."], {"a": 1}])
def test_a_damaged_need_is_refused(tmp_path: Path, requires: object) -> None:
    """With file and field."""
    layout, _ = chain(tmp_path)
    path = layout.sweep("e", "smoke")
    content = json.loads(path.read_text())
    content["needed"][1]["requires"] = requires
    path.write_text(json.dumps(content))
    with pytest.raises(DamagedError, match=r"needed\[1\]\.requires"):
        read_sweeps(layout)


def test_what_needs_a_failed_run_is_blocked(tmp_path: Path) -> None:
    """Down the chain, with the first cause; what was done before stays done, and what the others lack is their own."""
    layout, record = chain(tmp_path)
    write_status(layout.run("0" * 16), Status(state=RunState.DONE))
    write_status(layout.run("1" * 16), Status(state=RunState.FAILED, error=ERROR))
    write_status(layout.run("4" * 16), Status(state=RunState.DONE))
    states = statuses(layout, record.everything)
    assert [states[digit * 16].state for digit in "01234"] == ["done", "failed", "blocked", "blocked", "done"]
    assert str(states["3" * 16].error) == f"run {'1' * 16}, which it needs, failed: DemosError: the expert fails"
    assert planned(tmp_path, "e")["state"].tolist() == ["blocked", "done"]
    write_status(layout.run("1" * 16), Status(state=RunState.INTERRUPTED))
    assert {str(status.state) for status in statuses(layout, record.everything).values()} == {
        "done", "interrupted", "queued"
    }  # fmt: skip


def test_runs_that_need_each_other_in_a_circle_wait(tmp_path: Path) -> None:
    """Two records put together by hand can say so, which neither does alone; looking at them ends."""
    states = statuses(Layout(tmp_path), (job("a", "b"), job("b", "a")))
    assert {status.state for status in states.values()} == {RunState.QUEUED}
