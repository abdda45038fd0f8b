"""People's answers on the command line: counted, taken along, kept where runs are removed, and replayed."""

from __future__ import annotations

import io
import json
import os
import random
import signal
import time
from pathlib import Path

import pytest

from rrm.teachers.labels import FIRST, SECOND, SKIPPED, read_labels
from rrmctl.cli.live import Bars, Lines
from rrmctl.cli.request import Request
from rrmctl.errors import UserError
from rrmctl.planning.manifest import load as load_manifest
from rrmctl.planning.plan import make_plan
from rrmctl.running.config_file import MissingFileError, config_content, load_config
from rrmctl.store import load, planned
from rrmctl.store.labels import OpenSession
from rrmctl.store.layout import Layout
from rrmctl.store.provenance import record_config
from rrmctl.store.schema import TIMINGS
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, read_status, run_status, write_status
from rrmctl.terminal import console
from tests.rrm.teachers.people import answer
from tests.rrmctl.cli.test_live import JOBS
from tests.rrmctl.cli.test_run import EXPERIMENTS, PLAN, call, start
from tests.rrmctl.running.standin import prepare
from tests.rrmctl.running.test_supervisor import until
from tests.rrmctl.store.test_labels import ask, asked

WAITING = Status(
    state=RunState.WAITING, attempt=1, step=25, steps=40,
    error=RunError(kind=ErrorKind.WAITING, type="WaitingError", message="3 answers of its teacher"),
)  # fmt: skip


def test_status_says_who_is_waited_for(tmp_path: Path) -> None:
    """One line an experiment, with what lacks and the command; what else is waited for is said as before."""
    one, other, third = asked(tmp_path, range(3))
    for folder in (one, other, third):
        write_status(folder, WAITING)
    for path in (third.path / "queries").iterdir():
        path.unlink()
    answer(one.path, most=2)
    told = " ".join(call("status", "--results", tmp_path).stdout.split())
    assert f"2 runs wait for 4 answers: rrmctl label stand-in --results {tmp_path}" in told
    assert "1 run waiting for 3 answers of its teacher" in told
    assert json.loads(call("status", "--json", "--results", tmp_path).stdout)["answers_missing"] == 4
    for folder in (one, other):
        answer(folder.path, seal=False)
    told = " ".join(call("status", "--results", tmp_path).stdout.split())
    assert "2 runs wait until no answer can be undone" in told


@pytest.mark.parametrize("kind", [Lines, Bars])
def test_the_view_says_who_is_waited_for(kind: type[Lines], tmp_path: Path) -> None:
    """Once for each session, with the command; at a terminal the count goes down."""
    out = io.StringIO()
    view = kind(console(out, width=200), Layout(tmp_path), JOBS, dict.fromkeys("ab", "study"))
    for missing in (17, 16, 15):
        view.asked([OpenSession("a", 100, 20, missing)])
        view.tick()
    assert out.getvalue().count("1 run waits for 17 answers: rrmctl label study") == 1
    if isinstance(view, Bars):
        assert view.progress.tasks[0].description == "0 of 2 runs; 1 wait for 15 answers"


def test_answers_are_counted_and_taken_along(tmp_path: Path) -> None:
    """By run and person; into a file and from there into another folder, once."""
    here, there = tmp_path / "here", tmp_path / "there"
    one, other = asked(here, range(2))
    answer(one.path, lambda query: [FIRST, SKIPPED, SECOND][query.index], annotator="ann")
    answer(other.path, most=1, annotator="ben")
    told = call("labels", "show", "--results", here).stdout
    rows = [line.split() for line in told.splitlines()[1:]]
    assert [row[-5:] for row in rows] == [["ann", "3", "1", "-", "3"], ["ben", "1", "-", "-", "-"]]
    assert call("labels", "export", "stand-in", tmp_path / "a.parquet", "--results", here).exit_code == 0
    assert call("labels", "export", tmp_path / "b.parquet", "--results", here).exit_code == 0
    assert read_labels(tmp_path / "a.parquet") == read_labels(tmp_path / "b.parquet")
    prepare(there, range(2))
    for new in (4, 0):
        done = call("labels", "import", tmp_path / "a.parquet", "--results", there)
        assert f"{new} answers are new, of 4 to 2 runs" in done.stdout
    assert call("labels", "show", "--results", there).stdout == told


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["export", "other", "f.parquet"], 'holds no runs of "other"'),
        (["export", "f.parquet"], "holds no answers of people"),
        (["export", "stand-in"], "no file was named"),
        (["import", "none.parquet"], "holds no answers"),
        (["import", str(EXPERIMENTS / "toy-car.toml")], "cannot be read as labels"),
    ],
)
def test_what_cannot_be_taken_along(tmp_path: Path, words: list[str], told: str) -> None:
    """One message, exit code 2."""
    prepare(tmp_path, range(1))
    done = call("labels", *words, "--results", tmp_path)
    assert done.exit_code == 2
    assert told in done.output
    assert "holds no answers of people" in call("labels", "show", "--results", tmp_path).stdout


def test_clean_keeps_what_people_said(tmp_path: Path) -> None:
    """A run that nothing asks for is listed with its answers, and goes only where that is said."""
    one, other = asked(tmp_path, range(2))
    answer(one.path)
    for sweep in (tmp_path / "sweeps").rglob("*.json"):
        sweep.unlink()
    assert f"{one.id}  holds answers of people and stays" in call("clean", "--results", tmp_path).stdout
    call("clean", "--yes", "--results", tmp_path)
    assert (one.path.exists(), other.path.exists()) == (True, False)
    assert "--yes removes them" in call("clean", "--labels", "--results", tmp_path).stdout
    call("clean", "--labels", "--yes", "--results", tmp_path)
    assert not one.path.exists()


HUMAN = ("teacher.kind=human",)


def test_people_and_their_answers_in_a_plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The study is the experiment's; a replay takes what the same run was told, and refuses what that was not."""
    manifest = load_manifest(EXPERIMENTS / "toy-car.toml")
    wanted = {"profile": "smoke", "methods": ["pebble"], "seeds": "1"}
    live = make_plan(manifest, **wanted, overrides=HUMAN)
    (run,) = live.configs
    assert (live.configs[run].teacher.study, live.jobs[0].teacher) == ("toy-car", "human")
    assert make_plan(manifest, **wanted).jobs[0].id != run
    monkeypatch.chdir(tmp_path)
    ask(Path("run"), run, 200)
    answer(Path("run"))
    replay = ["teacher.kind=replay", "teacher.labels=run/labels.parquet"]
    again = make_plan(manifest, **wanted, overrides=replay)
    (config,) = again.configs.values()
    assert (config.answered, config.teacher.labels) == (run, str(tmp_path / "run" / "labels.parquet"))
    for wrong in ({"seeds": "2"}, {"profile": "paper"}, {"overrides": [*replay, "teacher.study=other"]}):
        with pytest.raises(UserError, match="has no answers to pebble on toy-car with seed"):
            make_plan(manifest, **wanted | {"overrides": replay} | wrong)
    folder = Layout(tmp_path).run(config.identity)
    record_config(folder, config_content(config))
    assert load_config(folder).identity == config.identity
    (tmp_path / "run" / "labels.parquet").unlink()
    with pytest.raises(MissingFileError, match="cannot read the answers"):
        load_config(folder)
    answer(Path("run"), lambda query: SECOND if query.index else FIRST)
    with pytest.raises(MissingFileError, match="has changed since this run was planned"):
        load_config(folder)


def test_the_study_is_the_papers() -> None:
    """Window-open, 400 questions in sessions of 20 every 10,000 steps, five seeds, people; alike in small."""
    plan = Request("human-study", EXPERIMENTS).plan()
    assert {(job.task, job.teacher, job.feedback) for job in plan.jobs} == {("window-open", "human", "20@10000/400")}
    assert {job.method for job in plan.jobs} == {"pebble", "rrm-h2o"}
    assert len(plan.jobs) == 10
    assert {config.steps for config in plan.configs.values()} == {500_000}
    smoke = Request("human-study", EXPERIMENTS, profile="smoke").plan()
    assert sum(config.queries() for config in smoke.configs.values()) == 60


def numbers(root: Path, experiment: str = "toy-car") -> str:
    """Every evaluation, but for timings and what names the run."""
    frame = load(root, experiment).sort_values(["method", "seed", "step"])
    named = [*TIMINGS, "run", "cell", "variant", "teacher"]
    return frame.drop(columns=named).to_csv(index=False)


def networks(root: Path, experiment: str = "toy-car") -> list[bytes]:
    ordered = planned(root, experiment).sort_values(["method", "seed"])["run"]
    return [Layout(root).run(run).model.read_bytes() for run in ordered]


@pytest.mark.slow
@pytest.mark.long
def test_a_study_through_kills_and_ctrl_c_and_in_another_folder(tmp_path: Path) -> None:
    """Curves and networks are the scripted teacher's, whoever dies; and those of imported and replayed answers."""
    sweep = [*PLAN, "--seeds", "1", "--methods", "pebble", "--workers", "1"]
    people = [*sweep, "--set", "teacher.kind=human"]
    roots = {name: tmp_path / name for name in ("scripted", "live", "imported", "replayed")}
    assert call("run", *sweep, "--results", roots["scripted"]).exit_code == 0
    live = Layout(roots["live"])
    program, rng = start("run", *people, "--results", live.root), random.Random(0)
    until(lambda: bool(live.run_ids()))
    folder = live.run(live.run_ids()[0])
    for trouble in ("kill", "interrupt", "kill"):  # a session each
        until(lambda: run_status(folder).state is RunState.WAITING)
        if trouble == "interrupt":
            program.send_signal(signal.SIGINT)
            out, _ = program.communicate(timeout=120)
            assert (program.returncode, "Not complete" in out) == (75, True)
            program = start("resume", "--results", live.root)
        assert answer(folder.path)
        until(lambda: run_status(folder).state is not RunState.WAITING)
        if trouble == "kill":
            time.sleep(rng.uniform(0, 5))
            if (pid := read_status(folder).pid) is not None and run_status(folder).state is RunState.RUNNING:
                os.kill(pid, signal.SIGKILL)
    program.communicate(timeout=300)
    assert program.returncode == 0
    file = tmp_path / "answers.parquet"
    assert call("labels", "export", "toy-car", file, "--results", live.root).exit_code == 0
    again = start("run", *people, "--results", roots["imported"])
    until(lambda: bool(Layout(roots["imported"]).run_ids() and list(roots["imported"].glob("sweeps/*/*.json"))))
    assert call("labels", "import", file, "--results", roots["imported"]).exit_code == 0
    again.communicate(timeout=300)
    assert again.returncode == 0
    replay = ["--set", "teacher.kind=replay", "--set", f"teacher.labels={file}"]
    assert call("run", *sweep, *replay, "--results", roots["replayed"]).exit_code == 0
    assert len({numbers(root) for root in roots.values()}) == 1
    assert all(networks(root) == networks(roots["scripted"]) for root in roots.values())
