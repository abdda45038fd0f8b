"""The state machine of a sweep, without processes or clocks."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rrmctl.errors import Exit
from rrmctl.running.scheduler import KILLED_RETRIES, Outcome, Scheduler, Stage
from rrmctl.store.status import ErrorKind, RunError

DONE, STOPPED, ELSEWHERE = (Outcome(ending) for ending in (Stage.DONE, Stage.STOPPED, Stage.ELSEWHERE))


def failed(kind: ErrorKind) -> Outcome:
    return Outcome(Stage.FAILED, RunError(kind=kind, type="x", message="x"))


def start_all(scheduler: Scheduler) -> list[str]:
    started = []
    while (job := scheduler.next()) is not None:
        scheduler.start(job)
        started.append(job)
    return started


def test_no_more_jobs_run_than_there_are_slots() -> None:
    """A slot that becomes free takes the next job in order."""
    scheduler = Scheduler("abcd", slots=2)
    assert start_all(scheduler) == ["a", "b"]
    assert scheduler.end("a", DONE) is Stage.DONE
    assert start_all(scheduler) == ["c"]
    assert not scheduler.finished


def test_places_on_cards_are_few() -> None:
    """Those that need one wait for it while others overtake them; a place that becomes free is taken in order."""
    scheduler = Scheduler("abcde", slots=4, on_cards="abc", places=1)
    assert start_all(scheduler) == ["a", "d", "e"]
    scheduler.end("d", DONE)
    assert start_all(scheduler) == []
    scheduler.end("a", failed(ErrorKind.CRASHED))
    assert start_all(scheduler) == ["b"]
    scheduler.end("b", DONE)
    assert start_all(scheduler) == ["c"]
    scheduler.end("c", STOPPED)
    assert start_all(scheduler) == ["a"]


def test_all_done_is_exit_0() -> None:
    """Nothing to do is done as well."""
    assert Scheduler((), slots=1).finished
    scheduler = Scheduler("ab", slots=2)
    for job in start_all(scheduler):
        scheduler.end(job, DONE)
    assert scheduler.finished
    assert scheduler.exit_code() is Exit.DONE


@pytest.mark.parametrize("kind", [ErrorKind.CRASHED, ErrorKind.HUNG, ErrorKind.MEMORY])
def test_a_crash_is_tried_again_behind_the_others_and_not_for_ever(kind: ErrorKind) -> None:
    """Two retries: the third crash is the end, and costs no other job."""
    scheduler = Scheduler("ab", slots=1)
    order = []
    while not scheduler.finished:
        (job,) = start_all(scheduler)
        order.append(job)
        scheduler.end(job, failed(kind) if job == "a" else DONE)
    assert order == ["a", "b", "a", "a"]
    assert scheduler.exit_code() is Exit.FAILED


def test_a_file_that_is_missing_stops_its_run_alone() -> None:
    """Neither failed nor tried again; the others run, and the sweep is incomplete."""
    scheduler = Scheduler("abc", slots=1, requires={"c": ["a"]})
    assert start_all(scheduler) == ["a"]
    assert scheduler.end("a", failed(ErrorKind.MISSING)) is Stage.STOPPED
    assert start_all(scheduler) == ["b"]
    scheduler.end("b", DONE)
    assert scheduler.finished
    assert scheduler.exit_code() is Exit.INCOMPLETE


def test_a_mistake_is_not_tried_again() -> None:
    """The same configuration would fail in the same way."""
    scheduler = Scheduler("a", slots=1)
    start_all(scheduler)
    assert scheduler.end("a", failed(ErrorKind.REFUSED)) is Stage.FAILED
    assert scheduler.exit_code() is Exit.FAILED


def test_a_broken_program_costs_no_job() -> None:
    """Three jobs in a row that were not even taken up end the command, not the jobs; one by itself fails as ever."""
    scheduler = Scheduler("abcdef", slots=2)
    stillborn = dataclasses.replace(failed(ErrorKind.CRASHED), stillborn=True)
    for job in "ab":
        start_all(scheduler)
        assert scheduler.end(job, stillborn) is Stage.WAITING
    start_all(scheduler)
    scheduler.resumed("c", 0)
    assert scheduler.end("c", failed(ErrorKind.CRASHED)) is Stage.WAITING
    assert not scheduler.stopping
    for job, stage in zip("def", (Stage.WAITING, Stage.WAITING, Stage.STOPPED), strict=True):
        start_all(scheduler)
        assert scheduler.end(job, stillborn) is stage
    assert (scheduler.broken, scheduler.stopping, scheduler.exit_code()) == (True, True, Exit.INCOMPLETE)
    alone = Scheduler("a", slots=1)
    for expected in (Stage.WAITING, Stage.WAITING, Stage.FAILED):
        start_all(alone)
        assert alone.end("a", stillborn) is expected


def test_progress_forgives_crashes() -> None:
    """A job that keeps crashing but comes further every time is never given up; one that repeats itself is."""
    scheduler = Scheduler("a", slots=1)
    for rows in range(10):
        start_all(scheduler)
        scheduler.resumed("a", rows)
        assert scheduler.end("a", failed(ErrorKind.CRASHED)) is Stage.WAITING
    for _ in range(2):
        start_all(scheduler)
        scheduler.resumed("a", 9)
        last = scheduler.end("a", failed(ErrorKind.CRASHED))
    assert last is Stage.FAILED


def test_being_killed_is_not_the_job_s_fault() -> None:
    """Somebody who kills what they can find must go on for long before a job is given up; its own crashes count."""
    scheduler = Scheduler("a", slots=1)
    for _ in range(2 * KILLED_RETRIES):
        start_all(scheduler)
        assert scheduler.end("a", failed(ErrorKind.KILLED)) is Stage.WAITING
    for expected in (Stage.WAITING, Stage.WAITING, Stage.FAILED):
        start_all(scheduler)
        assert scheduler.end("a", failed(ErrorKind.CRASHED)) is expected


def test_a_full_disk_stops_the_sweep_without_failing_anything() -> None:
    """No job starts into it, running ones may try to end, and the command can be repeated."""
    scheduler = Scheduler("abc", slots=2)
    start_all(scheduler)
    assert scheduler.end("a", failed(ErrorKind.STORAGE)) is Stage.STOPPED
    assert scheduler.next() is None
    assert not scheduler.finished
    scheduler.end("b", DONE)
    assert scheduler.finished
    assert scheduler.exit_code() is Exit.INCOMPLETE


def test_after_stop_nothing_starts_and_crashes_are_not_tried_again() -> None:
    """A stopped sweep ends when its workers have left, incomplete."""
    scheduler = Scheduler("abc", slots=2)
    start_all(scheduler)
    scheduler.stop()
    scheduler.end("a", STOPPED)
    scheduler.end("b", failed(ErrorKind.KILLED))
    assert scheduler.finished
    assert scheduler.exit_code() is Exit.INCOMPLETE


def test_a_job_elsewhere_takes_no_slot_and_is_waited_for() -> None:
    """It may be finished there, or be given up and start here before all others."""
    scheduler = Scheduler("abc", slots=1)
    start_all(scheduler)
    assert scheduler.end("a", ELSEWHERE) is Stage.ELSEWHERE
    assert scheduler.elsewhere == ["a"]
    assert start_all(scheduler) == ["b"]
    scheduler.end("b", ELSEWHERE)
    scheduler.free("a")
    assert start_all(scheduler) == ["a"]
    scheduler.end("a", DONE)
    start_all(scheduler)
    scheduler.end("c", DONE)
    assert not scheduler.finished
    scheduler.end("b", DONE)
    assert scheduler.finished
    assert scheduler.exit_code() is Exit.DONE


def test_what_failed_elsewhere_is_not_tried_again() -> None:
    """There it was tried as often as it should be, and here it may not even have been begun."""
    scheduler = Scheduler("ab", slots=1)
    assert scheduler.end("a", failed(ErrorKind.CRASHED)) is Stage.FAILED
    start_all(scheduler)
    scheduler.end("b", ELSEWHERE)
    assert scheduler.end("b", failed(ErrorKind.CRASHED)) is Stage.FAILED
    assert scheduler.exit_code() is Exit.FAILED


def test_a_job_ends_once() -> None:
    """Being told twice is a mistake of the caller's, not a second result."""
    scheduler = Scheduler("a", slots=1)
    start_all(scheduler)
    scheduler.end("a", DONE)
    with pytest.raises(ValueError, match="ended already"):
        scheduler.end("a", DONE)


@given(st.data(), st.integers(1, 8), st.integers(1, 4))
def test_whatever_happens_every_job_ends_in_one_phase(data: st.DataObject, jobs: int, slots: int) -> None:
    """Under any order of events the counts add up, no slot is overbooked, and the exit code says what is left."""
    scheduler = Scheduler(map(str, range(jobs)), slots=slots)
    running: list[str] = []
    outcomes = st.sampled_from([DONE, STOPPED, ELSEWHERE, *map(failed, ErrorKind)])
    for _ in range(200):
        running += start_all(scheduler)
        assert len(running) <= slots
        assert sum(scheduler.counts().values()) == jobs
        if scheduler.finished:
            break
        if running:
            scheduler.end(running.pop(data.draw(st.integers(0, len(running) - 1))), data.draw(outcomes))
        for job in scheduler.elsewhere:
            scheduler.end(job, DONE)
    assert scheduler.finished
    counts = scheduler.counts()
    incomplete = counts[Stage.STOPPED] + counts[Stage.WAITING] + counts[Stage.ELSEWHERE]
    expected = Exit.INCOMPLETE if incomplete else Exit.FAILED if counts[Stage.FAILED] else Exit.DONE
    assert expected is scheduler.exit_code()


def test_a_job_waits_for_those_it_needs() -> None:
    """Others go first meanwhile; two that share a need start together once it is done."""
    scheduler = Scheduler("cdab", slots=2, requires={"c": "a", "d": "a", "a": "x"})
    assert start_all(scheduler) == ["a", "b"]
    scheduler.end("b", DONE)
    assert start_all(scheduler) == []
    assert not scheduler.finished
    scheduler.end("a", DONE)
    assert start_all(scheduler) == ["c", "d"]


def test_what_needs_a_failed_job_is_blocked() -> None:
    """Down the whole chain, once each; the rest goes on, and the exit code says that something failed."""
    scheduler = Scheduler("abcde", slots=1, requires={"b": "a", "c": "ab", "d": "c"})
    assert start_all(scheduler) == ["a"]
    assert scheduler.end("a", failed(ErrorKind.REFUSED)) is Stage.FAILED
    assert sorted(scheduler.block("a")) == ["b", "c", "d"]
    assert start_all(scheduler) == ["e"]
    scheduler.end("e", DONE)
    assert scheduler.finished
    assert scheduler.counts() == {Stage.FAILED: 1, Stage.BLOCKED: 3, Stage.DONE: 1}
    assert scheduler.exit_code() is Exit.FAILED


def test_what_needs_a_stopped_job_is_left_for_later() -> None:
    """It is not waited for, and the command is not complete."""
    scheduler = Scheduler("ab", slots=1, requires={"b": "a"})
    (job,) = start_all(scheduler)
    scheduler.end(job, STOPPED)
    assert scheduler.finished
    assert scheduler.exit_code() is Exit.INCOMPLETE


def test_a_need_that_is_met_elsewhere_is_waited_for() -> None:
    """Another process owns it; when it is done there, its dependent starts here."""
    scheduler = Scheduler("ab", slots=1, requires={"b": "a"})
    scheduler.end("a", ELSEWHERE)
    assert start_all(scheduler) == []
    assert not scheduler.finished
    scheduler.end("a", DONE)
    assert start_all(scheduler) == ["b"]
