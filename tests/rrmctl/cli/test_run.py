"""`run`, `resume`, `status` and `show`, from the command line to what the store holds."""

from __future__ import annotations

import dataclasses
import json
import os
import random
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from rrmctl.cli import request as requests
from rrmctl.cli.app import app
from rrmctl.cli.request import Request, forecast
from rrmctl.store import load, planned
from rrmctl.store.curve import CurveWriter
from rrmctl.store.files import try_lock
from rrmctl.store.layout import Layout
from rrmctl.store.schema import TIMINGS
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, read_status, run_status, write_status
from rrmctl.store.sweeps import read_sweeps
from rrmctl.terminal import console
from tests.rrmctl.running.standin import prepare, row

EXPERIMENTS = Path(__file__).parents[3] / "experiments"
PLAN = ["toy-car", "--experiments", str(EXPERIMENTS), "--profile", "smoke"]
PROGRAM = [sys.executable, "-c", "from rrmctl.cli.app import main; main()"]
ERROR = RunError(kind=ErrorKind.REFUSED, type="PriorError", message="the prior returned NaN")


def call(*arguments: str | Path) -> Result:
    return CliRunner().invoke(app, list(map(str, arguments)))


def settle(root: Path, state: RunState, seeds: str = "2", error: RunError | None = None) -> list[str]:
    """Pretend that toy-car's oracle has run for these seeds; the ids."""
    jobs = Request("toy-car", EXPERIMENTS, profile="smoke", seeds=seeds, methods=["oracle"]).plan().jobs
    for job in jobs:
        steps = job.steps
        write_status(
            Layout(root).run(job.id), Status(state=state, attempt=1, step=steps, steps=steps, wall_s=6.0, error=error)
        )
    return [job.id for job in jobs]


@pytest.mark.slow
def test_paths_hold_wherever_the_code_of_a_user_goes(tmp_path: Path) -> None:
    """A prior that changes folder and umask disturbs no write; a project that was moved is told so, and goes on."""
    home, moved = tmp_path / "project", tmp_path / "moved"
    home.mkdir()
    (home / "mine.py").write_text("import os\n\ndef p(step):\n    os.chdir('/')\n    os.umask(0o777)\n    return 0.0\n")
    sweep = ["run", *PLAN, "--seeds", "1", "--methods", "rrm-p", "--prior", "mine.py:p", "--results", "res"]

    def program(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run([*PROGRAM, *arguments], cwd=folder, capture_output=True, text=True, check=False)

    ran = program(home, *sweep)
    assert ran.returncode == 0, ran.stderr
    (run,) = (home / "res" / "runs").iterdir()
    files = [path for path in run.iterdir() if path.is_file()]
    assert all(path.stat().st_mode & 0o400 for path in files), files
    folder = Layout(home / "res").run(run.name)
    write_status(folder, dataclasses.replace(read_status(folder), state=RunState.INTERRUPTED))
    home.rename(moved)
    ran = program(moved, "resume", "--results", "res")
    assert ran.returncode == 75, ran.stderr
    assert f"stopped: cannot read {home / 'mine.py'}" in ran.stderr
    assert "bring it back" in ran.stderr
    assert "Traceback" not in ran.stderr
    assert run_status(Layout(moved / "res").run(run.name)).state is RunState.INTERRUPTED
    ran = program(moved, *sweep)
    assert ran.returncode == 0, ran.stderr
    assert [path.name for path in (moved / "res" / "runs").iterdir()] == [run.name]


def test_a_sweep_that_is_done_is_not_run_again(tmp_path: Path) -> None:
    """Exit code 0, no process, and the next command by name."""
    ids = settle(tmp_path, RunState.DONE)
    result = call("run", *PLAN, "--methods", "oracle", "--seeds", "2", "--results", tmp_path)
    assert result.exit_code == 0
    assert "2 runs, 2 done already" in result.stderr
    assert f"rrmctl report iqm toy-car --results {tmp_path}" in result.stdout
    assert sorted(path.name for path in Layout(tmp_path).run(ids[0]).path.iterdir()) == ["config.json", "status.json"]


def test_the_manifests_closing_is_said_where_all_is_done(tmp_path: Path) -> None:
    """Below the next commands, once everything is there; after a failure there is nothing yet to be read."""
    manifest = tmp_path / "toy-car.toml"
    manifest.write_text('closing = """\nOne line [/b],\nanother."""\n' + (EXPERIMENTS / "toy-car.toml").read_text())
    asked = ["run", manifest, *PLAN[3:], "--methods", "oracle", "--seeds", "1", "--results", tmp_path]
    settle(tmp_path, RunState.DONE, "1")
    said = call(*asked)
    assert (said.exit_code, said.stdout.splitlines()[-4:]) == (0, ["", "One line [/b],", "another.", ""])
    settle(tmp_path, RunState.FAILED, "1", error=ERROR)
    assert "another" not in call(*asked).stdout


def test_the_introduction_bears_profiles_that_cannot_hold_the_request(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`run` advises on a large sweep without stumbling over other profiles, and notes a budget too large to spend."""
    monkeypatch.setattr(requests, "LARGE_H", 0.0)
    request = Request("toy-car", EXPERIMENTS, "smoke", overrides=["steps=450", "feedback.budget=1000000"])
    requests.introduce(console(sys.stderr), request, forecast(request.plan(), Layout(tmp_path)), slots=1)
    said = capsys.readouterr().err
    assert "of 1,000,000 questions fit into 450 steps: toy-car pebble" in said
    assert "smaller: a part of it" in said
    assert "--profile" not in said


def test_asking_for_more_seeds_adds_to_the_record(tmp_path: Path) -> None:
    """The sweep's record is the union; each run's configuration names its seed."""
    for seeds in ("2", "1,", "5"):
        settle(tmp_path, RunState.DONE, seeds)
        call("run", *PLAN, "--methods", "oracle", "--seeds", seeds, "--results", tmp_path)
    (sweep,) = read_sweeps(Layout(tmp_path))
    assert (sweep.experiment, sweep.variant, sweep.profile) == ("toy-car", "smoke", "smoke")
    assert [job.seed for job in sweep.jobs] == [0, 1, 2, 3, 4]
    config = json.loads(Layout(tmp_path).run(sweep.jobs[3].id).config.read_text())
    assert (config["id"], config["seed"], config["method"]) == (sweep.jobs[3].id, 3, "oracle")


def test_failed_runs_stay_failed_until_asked_for(tmp_path: Path) -> None:
    """Neither run nor resume starts them; both leave with 1 and say how to try again."""
    settle(tmp_path, RunState.FAILED, error=ERROR)
    result = call("run", *PLAN, "--methods", "oracle", "--seeds", "2", "--results", tmp_path)
    assert result.exit_code == 1
    assert "--retry-failed" in result.stdout
    result = call("resume", "--results", tmp_path)
    assert result.exit_code == 1
    assert "toy-car (smoke): 0 of 2 runs to go" in result.stderr


def test_a_results_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    """One message with path and way out, exit code 2, no traceback."""
    (tmp_path / "taken").touch()
    result = call("run", *PLAN, "--seeds", "1", "--results", tmp_path / "taken" / "results")
    assert result.exit_code == 2
    assert f"cannot write {tmp_path}/taken/results" in result.stderr
    assert "--results" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("command", ["status", "resume", "show"])
def test_a_results_folder_that_is_not_there(tmp_path: Path, command: str) -> None:
    """Commands that need one say so."""
    result = call(command, *(["abc"] if command == "show" else []), "--results", tmp_path / "nowhere")
    assert result.exit_code == 2
    assert "there is no results folder" in result.stderr


def test_status_of_everything(tmp_path: Path) -> None:
    """A line per sweep with its counts; a run whose process is gone is interrupted, one whose lock is held runs."""
    layout, jobs = prepare(tmp_path, range(5))
    for job, state in zip(jobs, (RunState.DONE, RunState.RUNNING, RunState.RUNNING, RunState.FAILED), strict=False):
        write_status(layout.run(job.id), Status(state=state, attempt=1, steps_per_s=10.0, error=ERROR))
    lock = try_lock(layout.run(jobs[1].id).lock)
    assert lock is not None
    result = call("status", "--results", tmp_path)
    told = json.loads(call("status", "stand-in", "--json", "--results", tmp_path).stdout)
    os.close(lock)
    assert result.exit_code == 0
    assert result.stdout.splitlines()[0].split() == [
        "experiment", "done", "running", "interrupted", "queued", "failed", "of", "left"
    ]  # fmt: skip
    assert result.stdout.splitlines()[1].split()[:8] == ["stand-in", "(smoke)", "1", "1", "1", "1", "1", "5"]
    assert "rrmctl status --failed" in result.stdout
    assert (told["runs"], told["done"], told["running"], told["interrupted"]) == (5, 1, 1, 1)
    assert told["core_seconds_left"] == 3 * 4.0
    assert told["errors"] == {"PriorError: the prior returned NaN": [jobs[3].id]}


def test_status_of_an_empty_folder(tmp_path: Path) -> None:
    """Nothing is no mistake."""
    result = call("status", "--results", tmp_path)
    assert result.exit_code == 0
    assert "holds no sweep yet" in result.stdout


def test_status_of_failures_groups_them(tmp_path: Path) -> None:
    """One paragraph for each thing that went wrong, with the ids that `show` takes."""
    layout, jobs = prepare(tmp_path, range(3))
    assert "No run failed." in call("status", "--failed", "--results", tmp_path).stdout
    for job in jobs[:2]:
        write_status(layout.run(job.id), Status(state=RunState.FAILED, attempt=3, error=ERROR))
    layout.run(jobs[2].id).status.write_text("{")
    out = call("status", "--failed", "--results", tmp_path).stdout
    assert "2 runs: PriorError: the prior returned NaN" in out
    assert all(job.id in out for job in jobs)
    assert "status.json cannot be read" in out


def test_watching_ends_when_nothing_is_left(tmp_path: Path) -> None:
    """Without a terminal it is a line whenever something changed."""
    layout, jobs = prepare(tmp_path, range(2))
    for job in jobs:
        write_status(layout.run(job.id), Status(state=RunState.DONE))
    assert call("status", "--watch", "--results", tmp_path).stdout == "2 done of 2 runs\n"


def test_status_of_an_experiment_that_never_ran(tmp_path: Path) -> None:
    """Exit code 2, and what is there instead."""
    prepare(tmp_path, range(1))
    result = call("status", "toy-carr", "--results", tmp_path)
    assert result.exit_code == 2
    assert "it holds: stand-in" in result.stderr


def test_show(tmp_path: Path) -> None:
    """By the first digits of its id: state, configuration, last rows, log, and the command that repeats it."""
    layout, jobs = prepare(tmp_path, range(2))
    folder = layout.run(jobs[1].id)
    config = json.loads(folder.config.read_text())
    curve = CurveWriter(folder, config | {"run": folder.id})
    for step in range(10, 80, 10):
        curve.add(row(step, success=0.8).columns())
    folder.log.write_text("".join(f"line {n}\n" for n in range(50)))
    write_status(folder, Status(state=RunState.FAILED, attempt=2, step=70, steps=400, error=ERROR))
    out = call("show", folder.id[:8], "--lines", "3", "--results", tmp_path).stdout
    assert "failed, attempt 2, step 70 of 400" in out
    assert "PriorError: the prior returned NaN" in out
    assert '"task": "toy-car"' in out
    assert "step        70  success 80%" in out
    assert "step        20" not in out
    assert "line 47\nline 48\nline 49\n" in out
    assert "line 46" not in out
    assert (
        "rrmctl run stand-in --profile smoke --tasks toy-car --methods oracle --seeds 1, "
        f"--results {tmp_path} --force" in out
    )


def test_show_for_programs(tmp_path: Path) -> None:
    """Valid JSON, with null for what is no number, and with what could not be read."""
    layout, ids = finished(tmp_path)
    folder = layout.run(ids[0])
    curve = CurveWriter(folder, json.loads(folder.config.read_text()) | {"run": folder.id})
    curve.add(row(30).columns() | {"critic_loss": float("nan"), "actor_loss": float("inf")})
    folder.log.write_text("one\ntwo\n")
    told = json.loads(call("show", ids[0], "--json", "--results", tmp_path).stdout, parse_constant=pytest.fail)
    assert (told["run"], told["state"]["state"], told["config"]["method"]) == (ids[0], "done", "oracle")
    assert (told["evaluations"][-1]["step"], told["evaluations"][-1]["critic_loss"]) == (30, None)
    assert told["evaluations"][-1]["actor_loss"] is None
    assert (told["log"], told["damage"], told["provenance"]) == (["one", "two"], {}, None)
    assert [(use["experiment"], use["seed"], use["superseded"]) for use in told["uses"]] == [("toy-car", 0, False)]
    assert told["again"][0].startswith("rrmctl run toy-car")
    folder.config.write_text("{")
    told = json.loads(call("show", ids[0], "--json", "--results", tmp_path).stdout)
    assert told["config"] is None
    assert "config.json cannot be read" in told["damage"]["config"]


def test_show_what_is_not_there(tmp_path: Path) -> None:
    """An id that fits nothing is refused."""
    prepare(tmp_path, range(1))
    result = call("show", "zz", "--results", tmp_path)
    assert result.exit_code == 2
    assert "starts with 'zz'" in result.stderr


def finished(root: Path) -> tuple[Layout, list[str]]:
    """Two oracle runs of toy-car with their curves, asked for by `run`; the ids."""
    ids = settle(root, RunState.DONE)
    call("run", *PLAN, "--methods", "oracle", "--seeds", "2", "--results", root)
    layout = Layout(root)
    for run in ids:
        folder = layout.run(run)
        config = json.loads(folder.config.read_text())
        curve = CurveWriter(folder, config | {"run": run})
        for step in (10, 20):
            curve.add(row(step, config["seed"]).columns())
        write_status(folder, dataclasses.replace(read_status(folder), rows=2))
    return layout, ids


def test_the_end_of_a_sweep_writes_its_aggregates(tmp_path: Path) -> None:
    """Once; ended again with the same curves, it leaves the file alone."""
    layout, _ = finished(tmp_path)
    assert call("resume", "--results", tmp_path).exit_code == 0
    path = layout.aggregate("toy-car")
    told, when = path.read_bytes(), path.stat().st_mtime_ns
    assert call("resume", "--results", tmp_path).exit_code == 0
    assert (path.read_bytes(), path.stat().st_mtime_ns) == (told, when)


@pytest.mark.parametrize("command", ["run", "resume"])
def test_a_done_run_without_its_curve_is_not_all_done(tmp_path: Path, command: str) -> None:
    """It is named with the command that trains it again, and the exit code is 1."""
    layout, ids = finished(tmp_path)
    layout.run(ids[1]).curve.unlink()
    plan = [*PLAN, "--methods", "oracle", "--seeds", "2"] if command == "run" else []
    result = call(command, *plan, "--results", tmp_path)
    assert result.exit_code == 1
    assert "All done" not in result.stdout
    assert f"{ids[1]}/curve.parquet is missing" in result.stdout
    assert "rrmctl run toy-car --profile smoke --tasks toy-car --methods oracle --seeds 1," in result.stdout
    assert "--force" in result.stdout


@pytest.mark.slow
def test_a_damaged_sweep_stops_only_its_own_experiment(tmp_path: Path) -> None:
    """The others go on with one line that names it; asked for by name it is refused."""
    layout, ids = finished(tmp_path)
    prepare(tmp_path, range(1))
    layout.sweep("stand-in", "smoke").write_text("{")
    for command in (["run", *PLAN, "--methods", "oracle", "--seeds", "2"], ["status"], ["show", ids[0]]):
        result = call(*command, "--results", tmp_path)
        assert result.exit_code == 0, result.output
        assert "stand-in/smoke.json cannot be read" in result.stderr
        assert "`rrmctl run stand-in ...`" in result.stderr
    result = call("status", "stand-in", "--results", tmp_path)
    assert result.exit_code == 2
    assert "`rrmctl run stand-in ...`" in result.stderr


def test_show_tells_what_can_be_told(tmp_path: Path) -> None:
    """Each damaged file is named in its place."""
    layout, ids = finished(tmp_path)
    folder = layout.run(ids[0])
    for path in (folder.curve, folder.provenance, folder.config):
        path.write_text("{")
    result = call("show", ids[0], "--results", tmp_path)
    assert result.exit_code == 0
    assert "done, attempt 1" in result.stdout
    for name in ("curve.parquet is damaged", "provenance.json cannot be read", "config.json cannot be read"):
        assert name in result.stdout


def test_a_damaged_configuration_of_a_done_run_stops_nothing(tmp_path: Path) -> None:
    """`run` writes it anew and says so."""
    layout, ids = finished(tmp_path)
    layout.run(ids[0]).config.write_text("{")
    result = call("run", *PLAN, "--methods", "oracle", "--seeds", "2", "--results", tmp_path)
    assert result.exit_code == 0
    assert "config.json.corrupt-1 and written anew" in result.stderr


@pytest.mark.parametrize("command", [["run", *PLAN], ["status"], ["resume"], ["show", "a"]], ids=lambda c: c[0])
def test_results_that_are_a_file(tmp_path: Path, command: list[str]) -> None:
    """Said in these words."""
    (tmp_path / "file").touch()
    result = call(*command, "--results", tmp_path / "file")
    assert result.exit_code == 2
    assert "file is a file, not a folder" in result.stderr


def test_one_run_is_one_run(tmp_path: Path) -> None:
    """Not "1 runs"."""
    prepare(tmp_path, range(1))
    assert "1 queued of 1 run\n" in call("status", "--results", tmp_path).stdout


def numbers(root: Path) -> str:
    """Every row as text; the time it took and whether its run is complete are left out."""
    frame = load(root, "toy-car").drop(columns=[*TIMINGS, "state"])
    return str(frame.sort_values(["method", "seed", "step"]).to_csv(index=False))


def start(*arguments: str | Path) -> subprocess.Popen[str]:
    """The program in a session of its own, its workers quick to restart."""
    return subprocess.Popen(
        [*PROGRAM, *map(str, arguments)],
        start_new_session=True,
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


@pytest.mark.slow
def test_killed_at_random_moments_and_resumed_ends_in_the_same_curves(tmp_path: Path) -> None:
    """SIGKILL of workers and of the parent, several times: the same rows as undisturbed, bit for bit."""
    sweep = [*PLAN, "--seeds", "2", "--methods", "oracle,rrm-sparse", "--workers", "2"]
    quiet, loud = tmp_path / "quiet", tmp_path / "loud"
    assert call("run", *sweep, "--results", quiet).exit_code == 0
    rng = random.Random(0)
    for _ in range(4):
        program = start("run", *sweep, "--results", loud)
        time.sleep(rng.uniform(3.0, 9.0))
        now = [run_status(Layout(loud).run(run)) for run in planned(loud, "toy-car")["run"]]
        workers = [status.pid for status in now if status.state is RunState.RUNNING and status.pid is not None]
        for pid in rng.sample(workers, len(workers) // 2):
            os.kill(pid, signal.SIGKILL)
        os.killpg(program.pid, signal.SIGKILL)
        program.communicate()
    result = call("resume", "--results", loud)
    assert result.exit_code == 0, result.output
    assert set(planned(loud, "toy-car")["state"]) == {"done"}
    assert numbers(loud) == numbers(quiet)


@pytest.mark.slow
def test_ctrl_c_leaves_with_75_and_resume_ends_it(tmp_path: Path) -> None:
    """The message says how to go on, and going on does."""
    program = start("run", *PLAN, "--seeds", "2", "--methods", "oracle", "--results", tmp_path)
    while not list(tmp_path.glob("runs/*/status.json")):
        time.sleep(0.1)
        assert program.poll() is None
    program.send_signal(signal.SIGINT)
    out, _ = program.communicate(timeout=120)
    assert program.returncode == 75
    assert f"this goes on where it stopped: rrmctl resume toy-car --results {tmp_path}" in out
    assert call("resume", "toy-car", "--results", tmp_path).exit_code == 0
    assert set(planned(tmp_path, "toy-car")["state"]) == {"done"}


@pytest.mark.slow
def test_a_job_that_hangs_is_ended_and_goes_on(tmp_path: Path) -> None:
    """A prior of the user's that never comes back, once: with --hang-after the sweep does not wait half an hour."""
    (tmp_path / "mine.py").write_text(
        "import pathlib, time\n\n\ndef stuck(step):\n"
        f"    mark = pathlib.Path({str(tmp_path / 'hung')!r})\n"
        "    if not mark.exists():\n        mark.touch()\n        time.sleep(100_000)\n    return 0.0\n"
    )
    sweep = [*PLAN, "--seeds", "1", "--prior", f"{tmp_path / 'mine.py'}:stuck", "--methods", "rrm-stuck"]
    result = call("run", *sweep, "--hang-after", "0.5", "--results", tmp_path / "results")
    assert result.exit_code == 0, result.output
    assert "gave no sign of life and was ended" in " ".join(result.stderr.split())
    (run,) = planned(tmp_path / "results", "toy-car")["run"]
    assert read_status(Layout(tmp_path / "results").run(run)).attempt == 2


def test_nothing_hangs_after_no_time(tmp_path: Path) -> None:
    """Zero minutes are refused."""
    result = call("run", *PLAN, "--hang-after", "0", "--results", tmp_path)
    assert result.exit_code == 2
    assert "--hang-after" in result.stderr


@pytest.mark.slow
def test_no_room_for_a_checkpoint_is_said_and_overcome(tmp_path: Path) -> None:
    """A real limit on the size of files: the sweep stops incomplete, says what to do, and goes on when it is lifted."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        result = call("run", *PLAN, "--seeds", "1", "--methods", "oracle", "--results", tmp_path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert result.exit_code == 75
    assert "File too large" in result.stderr
    assert "rrmctl resume" in result.stderr
    assert planned(tmp_path, "toy-car")["state"].tolist() == ["interrupted"]
    assert call("resume", "--results", tmp_path).exit_code == 0


@pytest.mark.slow
@pytest.mark.long
def test_a_full_disk_in_the_middle_of_a_write(tmp_path: Path) -> None:
    """A real file system of two megabytes: it says what to do, keeps what there was, and goes on given space."""
    quiet, small = tmp_path / "quiet", tmp_path / "small"
    small.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", small]
    if subprocess.run(mount, check=False, capture_output=True).returncode:
        pytest.skip("only the superuser can make a file system")
    sweep = [*PLAN, "--seeds", "3", "--methods", "oracle", "--workers", "2", "--set", "agent.hidden=96"]
    try:
        result = call("run", *sweep, "--results", small)
        assert result.exit_code == 75, result.output
        assert "No space left on device" in result.stderr
        assert f"make space, then `rrmctl resume --results {small}` goes on" in " ".join(result.stderr.split())
        assert "Traceback" not in result.output
        assert call("status", "--results", small).exit_code == 0
        before = load(small, "toy-car")
        subprocess.run(["mount", "-o", "remount,size=64m", small], check=True)
        result = call("resume", "--results", small)
        assert result.exit_code == 0, result.output
        assert call("run", *sweep, "--results", quiet).exit_code == 0
        assert numbers(small) == numbers(quiet)
        assert len(before) <= len(load(small, "toy-car"))
    finally:
        subprocess.run(["umount", "-l", small], check=True)
