"""What the store tells: states, sweeps and the tidy table."""

from __future__ import annotations

import dataclasses
import fcntl
import hashlib
import json
import os
import threading
from collections import Counter
from pathlib import Path

import pytest

from rrm.tuning import OTHERWISE
from rrmctl.errors import UserError
from rrmctl.store import load, planned
from rrmctl.store.curve import CurveWriter
from rrmctl.store.files import DamagedError, VersionError, try_lock
from rrmctl.store.layout import Layout, find_run
from rrmctl.store.provenance import collect, read_config, read_provenance, record_config
from rrmctl.store.provenance import record as record_provenance
from rrmctl.store.schema import LABELS, MEASURED
from rrmctl.store.snapshot import Snapshot
from rrmctl.store.status import (
    ErrorKind,
    RunError,
    RunState,
    Status,
    log_tail,
    read_status,
    record_failure,
    run_status,
    write_status,
)
from rrmctl.store.sweeps import Job, SweepRecord, read_sweeps, readable_sweeps, record_sweep
from rrmctl.store.trials import Trial, begin_trial, read_trial
from tests.rrmctl.running.standin import prepare, row


def job(seed: int, method: str = "pebble") -> Job:
    return Job(
        id=hashlib.sha256(f"{method}{seed}".encode()).hexdigest()[:16],
        cell=method,
        task="t",
        method=method,
        teacher="oracle",
        feedback="f",
        seed=seed,
        steps=100,
    )


def sweep(*jobs: Job, variant: str = "smoke") -> SweepRecord:
    return SweepRecord(experiment="e", variant=variant, profile="smoke", overrides={"steps": 5}, jobs=jobs)


def with_rows(layout: Layout, run: str, *steps: int) -> None:
    config = json.loads(layout.run(run).config.read_text())
    curve = CurveWriter(layout.run(run), config | {"run": run})
    for step in steps:
        curve.add(row(step, config["seed"]).columns())


def test_a_sweep_asked_for_twice_is_the_union(tmp_path: Path) -> None:
    """Five more seeds are five more jobs; what was there stays first; another variant is another record."""
    layout = Layout(tmp_path)
    record_sweep(layout, sweep(job(0), job(1)))
    union = record_sweep(layout, sweep(job(1), job(2)))
    record_sweep(layout, sweep(job(7), variant="paper"))
    assert [j.seed for j in union.jobs] == [0, 1, 2]
    assert {s.variant: [j.seed for j in s.jobs] for s in read_sweeps(layout, "e")} == {"smoke": [0, 1, 2], "paper": [7]}
    assert read_sweeps(layout) == read_sweeps(layout, "e")


def test_what_writers_of_rules_and_sweeps_left_goes(tmp_path: Path) -> None:
    """The next writer removes what is too old to be anybody's work."""
    layout = Layout(tmp_path)
    left = [layout.trial("e", "smoke").with_name(".smoke.json.1.tmp"), layout.sweep("e", "smoke").with_name(".x.tmp")]
    for path in left:
        path.parent.mkdir(parents=True)
        path.touch()
        os.utime(path, (0, 0))
    begin_trial(layout, "e", "smoke", Trial(group=1, looks=1, alpha=0.1, pairs=()))
    record_sweep(layout, sweep(job(0)))
    assert not any(path.exists() for path in left)


def test_sweeps_asked_for_at_once_lose_no_job(tmp_path: Path) -> None:
    """Many writers of one record end in the union of all they asked for."""
    layout = Layout(tmp_path)
    threads = [threading.Thread(target=record_sweep, args=(layout, sweep(job(n)))) for n in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    (union,) = read_sweeps(layout)
    assert set(range(16)) == {j.seed for j in union.jobs}


@pytest.mark.parametrize("name", ["../out", "/etc/x", "a/b", ".hidden", "", "a\nb", "x" * 200])
def test_names_cannot_leave_the_results_folder(tmp_path: Path, name: str) -> None:
    """A name that would be a path elsewhere is refused."""
    with pytest.raises(UserError, match="cannot name a file"):
        Layout(tmp_path).sweep(name, "smoke")
    with pytest.raises(UserError, match="cannot name a file"):
        Layout(tmp_path).run(name)


def test_running_without_a_process_is_interrupted(tmp_path: Path) -> None:
    """A status that says running counts only while somebody holds the run's lock."""
    folder = Layout(tmp_path).run("r")
    write_status(folder, Status(state=RunState.RUNNING, attempt=1))
    assert run_status(folder).state is RunState.INTERRUPTED
    lock = try_lock(folder.lock)
    assert lock is not None
    assert run_status(folder).state is RunState.RUNNING
    os.close(lock)
    assert run_status(folder).state is RunState.INTERRUPTED


def test_a_status_survives_its_file(tmp_path: Path) -> None:
    """Every field comes back, the error among them."""
    folder = Layout(tmp_path).run("r")
    error = RunError(kind=ErrorKind.KILLED, type="SIGKILL", message="killed")
    status = Status(
        state=RunState.FAILED, attempt=3, step=5, steps=9, rows=1, success=0.5, pid=1, host="h", error=error
    )
    write_status(folder, status)
    assert status == read_status(folder)


@pytest.mark.parametrize(
    "content", ["{", "[]", "{}", '{"schema_version": "1"}', '{"schema_version": 1, "state": "odd"}']
)
def test_a_damaged_status_is_told_not_guessed(tmp_path: Path, content: str) -> None:
    """Such a run is unreadable, with the file's name; reading it directly raises."""
    folder = Layout(tmp_path).run("r")
    folder.path.mkdir(parents=True)
    folder.status.write_text(content)
    status = run_status(folder)
    assert status.state is RunState.UNREADABLE
    assert "status.json" in str(status.error)
    with pytest.raises(DamagedError):
        read_status(folder)


def test_another_version_is_not_damage(tmp_path: Path) -> None:
    """It is said with both numbers, by every record, and nobody goes on as if there were none."""
    layout, jobs = prepare(tmp_path, range(1))
    folder = layout.run(jobs[0].id)
    write_status(folder, Status())
    begin_trial(layout, "stand-in", "smoke", Trial(group=1, looks=1, alpha=0.1, pairs=()))
    record_provenance(folder, collect(read_config(folder), {}, {OTHERWISE: "torch"}, [], 1))
    looks = {
        folder.status: [lambda: read_status(folder), lambda: run_status(folder), lambda: load(tmp_path)],
        folder.provenance: [lambda: read_provenance(folder), lambda: Snapshot(tmp_path).runs()],
        layout.sweep("stand-in", "smoke"): [lambda: readable_sweeps(layout), lambda: load(tmp_path)],
        layout.trial("stand-in", "smoke"): [lambda: read_trial(layout, "stand-in", "smoke")],
    }
    for path, each in looks.items():
        whole = path.read_bytes()
        path.write_text(json.dumps(json.loads(whole) | {"schema_version": 99}))
        for look in each:
            with pytest.raises(VersionError, match=rf"{path} is of schema version 99, this program reads 1"):
                look()
        path.write_bytes(whole)


STATUS = Status(state=RunState.DONE, step=5, wall_s=1.0, error=RunError(kind=ErrorKind.KILLED, type="K", message="k"))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"step": "x"}, "step is 'x', not a whole number"),
        ({"rows": True}, "rows is True, not a whole number"),
        ({"wall_s": "y"}, "wall_s is 'y', not a number"),
        ({"error": [1]}, r"error is \[1\], not an object"),
        ({"error": {"kind": "killed"}}, "lacks error.type, error.message"),
        ({"state": None}, "state is None: Input should be 'queued', 'running'"),
    ],
)
def test_a_status_with_a_field_of_another_kind_is_damaged(tmp_path: Path, change: object, told: str) -> None:
    """File and field are named, before anybody reckons with it."""
    folder = Layout(tmp_path).run("r")
    folder.path.mkdir(parents=True)
    folder.status.write_text(json.dumps({"schema_version": 1, **dataclasses.asdict(STATUS)} | change))
    with pytest.raises(DamagedError, match=rf"r/status\.json is damaged: .*{told}"):
        read_status(folder)
    assert run_status(folder).state is RunState.UNREADABLE


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"overrides": [1]}, r"overrides is \[1\], not an object"),
        ({"jobs": {}}, "jobs is {}, not a list"),
        ({"jobs": [1]}, r"jobs\[0\] is 1, not an object"),
        ({"jobs": [dataclasses.asdict(job(0)) | {"seed": "x"}]}, r"jobs\[0\].seed is 'x', not a whole number"),
        ({"jobs": [dataclasses.asdict(job(0)) | {"id": "../x"}]}, r"jobs\[0\].id is '../x', not 16 hexadecimal digits"),
        ({"experiment": "../../x"}, r"it is the record of '../../x' \('smoke'\)"),
        ({"variant": "../x"}, r"it is the record of 'e' \('../x'\)"),
        ({"jobs": [dataclasses.asdict(job(0)) | {"requires": [job(0).id]}]}, "runs need each other in a circle"),
        (
            {"jobs": [dataclasses.asdict(job(n)) | {"requires": [job(1 - n).id]} for n in (0, 1)]},
            "runs need each other",
        ),
    ],
)
def test_a_sweep_with_a_field_of_another_kind_is_damaged(tmp_path: Path, change: object, told: str) -> None:
    """It is named with the command that makes it again; the other sweeps can still be read."""
    layout = Layout(tmp_path)
    for variant in ("smoke", "paper"):
        record_sweep(layout, sweep(job(0), variant=variant))
    path = layout.sweep("e", "smoke")
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(DamagedError, match=rf"e/smoke\.json is damaged: {told}") as caught:
        read_sweeps(layout)
    assert "`rrmctl run e ...`" in str(caught.value.hint)
    good, (bad,) = readable_sweeps(layout)
    assert [each.variant for each in good] == ["paper"]
    assert str(bad) == str(caught.value)


@pytest.mark.parametrize("content", ["{}", '{"threads": "1"}', "{"])
def test_a_damaged_configuration_is_told_and_written_anew(tmp_path: Path, content: str) -> None:
    """Reading it names the file; recording the run again repairs it."""
    layout, jobs = prepare(tmp_path, range(1))
    folder = layout.run(jobs[0].id)
    good = read_config(folder)
    folder.config.write_text(content)
    with pytest.raises(DamagedError, match=r"config\.json"):
        read_config(folder)
    record_config(folder, good)
    assert read_config(folder) == good


def test_what_is_nobody_s_run_or_sweep_is_not_looked_at(tmp_path: Path) -> None:
    """Files and folders that lie around in the results folder stop nothing."""
    layout, jobs = prepare(tmp_path, range(1))
    with_rows(layout, jobs[0].id, 10)
    for folder in ("runs/copy of a run", "runs/notes", "sweeps/bad name!", "sweeps/stand-in/sub.json"):
        (tmp_path / folder).mkdir()
    for file in ("runs/stray", "runs/feedfacefeedface", "sweeps/notes.txt", "sweeps/stand-in/bad name!.json"):
        (tmp_path / file).touch()
    assert layout.run_ids() == [jobs[0].id]
    assert layout.experiments() == ["stand-in"]
    assert len(load(tmp_path)) == 1


def test_the_curve_of_another_run_is_refused(tmp_path: Path) -> None:
    """A copy in the wrong folder does not become that run's result."""
    layout, jobs = prepare(tmp_path, range(2))
    with_rows(layout, jobs[0].id, 10)
    layout.run(jobs[1].id).curve.write_bytes(layout.run(jobs[0].id).curve.read_bytes())
    with pytest.raises(DamagedError, match=f"is the curve of run {jobs[0].id}, not of {jobs[1].id}"):
        load(tmp_path)


def test_a_failure_is_recorded_unless_somebody_else_has_the_run(tmp_path: Path) -> None:
    """The owner of a run is the only one to write its status."""
    folder = Layout(tmp_path).run("r")
    error = RunError(kind=ErrorKind.KILLED, type="SIGKILL", message="killed")
    write_status(folder, Status(state=RunState.RUNNING))
    lock = try_lock(folder.lock)
    assert lock is not None
    record_failure(folder, error)
    assert read_status(folder).state is RunState.RUNNING
    os.close(lock)
    record_failure(folder, error)
    assert error == read_status(folder).error
    write_status(folder, Status(state=RunState.DONE))
    record_failure(folder, error)
    assert read_status(folder).state is RunState.DONE


def test_a_failure_is_recorded_while_somebody_looks(tmp_path: Path) -> None:
    """A reader holds the lock for an instant: that makes nobody the owner of the run."""
    folder = Layout(tmp_path).run("r")
    write_status(folder, Status(state=RunState.RUNNING))
    folder.lock.touch()
    reader = os.open(folder.lock, os.O_RDONLY)
    fcntl.flock(reader, fcntl.LOCK_SH)
    leaves = threading.Timer(0.1, os.close, [reader])
    leaves.start()
    record_failure(folder, RunError(kind=ErrorKind.KILLED, type="SIGKILL", message="killed"))
    leaves.join()
    assert read_status(folder).state is RunState.FAILED


def test_load_is_one_row_per_label_and_evaluation(tmp_path: Path) -> None:
    """Labels come from the sweep, measurements from the curve; a run that two experiments share appears in both."""
    layout, jobs = prepare(tmp_path, range(3))
    with_rows(layout, jobs[0].id, 10, 20)
    with_rows(layout, jobs[1].id, 10)
    (record,) = read_sweeps(layout)
    renamed = dataclasses.replace(record.jobs[0], method="teacher-free")
    record_sweep(layout, dataclasses.replace(record, experiment="other", jobs=(renamed,)))
    frame = load(tmp_path, "stand-in")
    assert [*LABELS, "run", "cell", "state", *MEASURED] == list(frame.columns)
    assert list(frame[["seed", "step", "true_return"]].itertuples(index=False, name=None)) == [
        (0, 10, 10.0),
        (0, 20, 20.0),
        (1, 10, 1010.0),
    ]
    everything = load(tmp_path)
    assert everything.groupby("experiment").size().to_dict() == {"stand-in": 3, "other": 2}
    assert {"teacher-free"} == set(everything[everything["experiment"] == "other"]["method"])


def test_runs_that_no_sweep_names_appear_without_experiment(tmp_path: Path) -> None:
    """A run folder copied in by hand is not skipped."""
    layout, jobs = prepare(tmp_path, range(1))
    with_rows(layout, jobs[0].id, 10)
    (tmp_path / "sweeps").rename(tmp_path / "elsewhere")
    frame = load(tmp_path)
    assert list(frame[["experiment", "method", "seed", "step"]].itertuples(index=False, name=None)) == [
        ("", "oracle", 0, 10)
    ]


def test_a_run_that_is_just_being_recorded_stops_no_reader(tmp_path: Path) -> None:
    """Its folder is there before its configuration; who dies in between leaves it so."""
    layout, jobs = prepare(tmp_path, range(1))
    with_rows(layout, jobs[0].id, 10)
    layout.run("feedfacefeedface").path.mkdir()
    assert load(tmp_path)["run"].tolist() == [jobs[0].id]


def test_planned_tells_what_is_missing(tmp_path: Path) -> None:
    """Every job asked for has a line, whether or not anything of it exists."""
    layout, jobs = prepare(tmp_path, range(2))
    error = RunError(kind=ErrorKind.REFUSED, type="PriorError", message="NaN")
    write_status(layout.run(jobs[1].id), Status(state=RunState.FAILED, attempt=1, step=7, steps=40, error=error))
    frame = planned(tmp_path, "stand-in")
    assert frame["state"].tolist() == ["queued", "failed"]
    assert frame["error"].tolist() == ["", "PriorError: NaN"]
    assert frame["steps"].tolist() == [40, 40]


def test_a_damaged_curve_stops_load_with_its_name(tmp_path: Path) -> None:
    """No row is left out silently."""
    layout, jobs = prepare(tmp_path, range(1))
    with_rows(layout, jobs[0].id, 10)
    layout.run(jobs[0].id).curve.write_bytes(b"PAR1 torn")
    with pytest.raises(DamagedError, match=f"{jobs[0].id}/curve.parquet is damaged"):
        load(tmp_path)


def test_an_experiment_that_never_ran_is_answered_with_those_that_did(tmp_path: Path) -> None:
    """So are a folder that does not exist, and ids that fit no run or several."""
    layout, jobs = prepare(tmp_path, range(30))
    with pytest.raises(UserError, match=r'holds no runs of "stand-inn"; did you mean "stand-in"\?') as error:
        read_sweeps(layout, "stand-inn")
    assert error.value.hint == "it holds: stand-in"
    with pytest.raises(UserError, match="there is no results folder"):
        planned(tmp_path / "nowhere")
    assert jobs[0].id == find_run(layout, jobs[0].id[:10]).id
    with pytest.raises(UserError, match="no run in"):
        find_run(layout, "zzz")
    with pytest.raises(UserError, match="no run was named"):
        find_run(layout, "")
    first, count = Counter(job.id[0] for job in jobs).most_common(1)[0]
    with pytest.raises(UserError, match=f"stands for {count} runs: "):
        find_run(layout, first)
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="file is a file, not a folder"):
        planned(tmp_path / "file")


def test_readers_never_meet_a_curve_half_written(tmp_path: Path) -> None:
    """While a writer replaces the curve over and over, every look gives a whole one, never with fewer rows."""
    layout, jobs = prepare(tmp_path, range(1))
    writer = threading.Thread(target=with_rows, args=(layout, jobs[0].id, *range(1, 50)))
    writer.start()
    seen = 0
    while writer.is_alive():
        rows = len(load(tmp_path, "stand-in"))
        assert rows >= seen
        seen = rows
    writer.join()
    assert len(load(tmp_path, "stand-in")) == 49


def test_the_end_of_a_log(tmp_path: Path) -> None:
    """The last lines, whatever bytes they hold; nothing where there is no log."""
    folder = Layout(tmp_path).run("r")
    assert log_tail(folder) == []
    folder.path.mkdir(parents=True)
    folder.log.write_bytes(b"\n".join(b"line %d \xff" % n for n in range(5000)))
    assert log_tail(folder, 2) == ["line 4998 �", "line 4999 �"]
