"""--executor, the user's file for it, and `stop`, where there is no cluster; tests/cluster has one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from rrmctl.cli.user_config import RaySite, ray_site, slurm_site
from rrmctl.errors import UserError
from rrmctl.running.slurm import Submission, write_submission
from rrmctl.running.slurm_arrays import Site
from rrmctl.running.supervisor import Terms
from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, run_status
from rrmctl.store.sweeps import read_sweeps
from tests.rrmctl.cli.test_run import PLAN, call, numbers, settle, start

RUN = ["run", *PLAN, "--methods", "oracle", "--seeds", "1"]


@pytest.fixture(autouse=True)
def _no_slurm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever this machine has, and no settings."""
    (tmp_path / "bin").mkdir()
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--executor", "slrum"], 'there is no executor "slrum"; did you mean "slurm"?'),
        (["--executor", "slurm", "--workers", "2"], "--workers means nothing with --executor slurm"),
        (["--executor", "slurm", "--memory", "2"], "--memory means nothing with --executor slurm"),
        (["--executor", "slurm", "--hang-after", "5"], "--hang-after means nothing with --executor slurm"),
        (["--executor", "slurm", "--label"], "--label means nothing with --executor slurm"),
        (["--slurm=--account=x"], "--slurm means nothing with --executor local"),
        (["--at-once", "3"], "--at-once means nothing with --executor local"),
        (["--pack", "3"], "--pack means nothing with --executor local"),
        (["--gpus", "0.5"], "--gpus is 0.5, not a list of cards hint: with --executor local it lists cards"),
        (["--gpus", ""], "--gpus is , not a list of cards"),
        (["--gpus=-1"], "--gpus is -1, not a list of cards"),
        (["--executor", "ray", "--gpus", "0,1"], "--gpus is 0,1, not a share of a card"),
        (
            ["--executor", "slurm", "--gpus", "1"],
            "--gpus means nothing with --executor slurm hint: it is for local, ray",
        ),
        (["--executor", "slurm", "--per-gpu", "2"], "--per-gpu means nothing with --executor slurm"),
        (["--executor", "ray", "--mps"], "--mps means nothing with --executor ray"),
        (["--executor", "slurm", "--address", "head:6379"], "--address means nothing with --executor slurm"),
        (["--executor", "ray", "--workers", "2"], "--workers means nothing with --executor ray"),
        (["--executor", "ray", "--pack", "2"], "--pack means nothing with --executor ray"),
    ],
)
def test_options_that_mean_nothing_are_refused(tmp_path: Path, options: list[str], message: str) -> None:
    """In one line, before anything is written."""
    result = call(*RUN, *options, "--results", tmp_path / "results")
    assert result.exit_code == 2
    assert message in " ".join(result.stderr.split())
    assert not (tmp_path / "results").exists()


def test_where_there_is_no_slurm(tmp_path: Path) -> None:
    """The sweep is recorded, nothing is submitted, one line says so; what is done needs none."""
    asked = [*RUN, "--executor", "slurm", "--results", tmp_path]
    result = call(*asked)
    assert result.exit_code == 2
    assert "there is no scontrol on this machine" in result.stderr
    assert "Traceback" not in result.stderr
    assert Layout(tmp_path).submissions() == []
    assert len(read_sweeps(Layout(tmp_path))) == 1
    settle(tmp_path, RunState.DONE, "1")
    assert call(*asked).exit_code == 0


def test_status_does_without_squeue(tmp_path: Path) -> None:
    """A note where something is left of what was submitted; none where all is done, or nothing was submitted."""
    (run,) = settle(tmp_path, RunState.INTERRUPTED, "1")
    call(*RUN, "--executor", "slurm", "--results", tmp_path)
    assert "what is queued" not in call("status", "--results", tmp_path).stdout
    write_submission(Layout(tmp_path), Submission(name="x-1", tasks=({run: Terms()},), asked=()))
    result = call("status", "--results", tmp_path)
    assert result.exit_code == 0
    assert "note: what is queued or lost is not known: there is no squeue" in result.stdout
    assert f"this goes on: rrmctl resume --executor slurm --results {tmp_path}" in result.stdout
    settle(tmp_path, RunState.DONE, "1")
    assert "note:" not in call("status", "--results", tmp_path).stdout


def _config(tmp_path: Path, text: str) -> None:
    file = tmp_path / "config" / "rrmctl" / "config.toml"
    file.parent.mkdir(parents=True)
    file.write_text(text)


def test_settings_of_the_users_file(tmp_path: Path) -> None:
    """What was typed comes later, and so wins at sbatch; of numbers it stands alone."""
    assert slurm_site([], None, None) == Site()
    _config(tmp_path, '[slurm]\nflags = ["-A", "x"]\nsetup = "module load cuda"\nat_once = 20\npack = 4\n')
    assert slurm_site(["-A", "y"], 5, None) == Site(("-A", "x", "-A", "y"), "module load cuda", 5, 4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[slrum]\n", 'unknown table [slrum]; did you mean "slurm"?'),
        ("slurm = 3\n", "slurm is 3, not a table"),
        ("[slurm]\nflag = []\n", 'unknown key "flag" in [slurm]; did you mean "flags"?'),
        ('[slurm]\nflags = "-A x"\n', "slurm.flags is '-A x', not a list of texts"),
        ("[slurm]\nflags = [1]\n", "slurm.flags is [1], not a list of texts"),
        ("[slurm]\nsetup = 1\n", "slurm.setup is 1, not text"),
        ("[slurm]\nat_once = 0\n", "slurm.at_once is 0, not a whole number above 0"),
        ("[slurm]\npack = true\n", "slurm.pack is True, not a whole number above 0"),
        ("[slurm\n", "config.toml: "),
        ("[ray]\naddress = 6379\n", "ray.address is 6379, not text"),
        ("[ray]\ngpus = 0\n", "ray.gpus is 0, not a number from 0.0001"),
        ("[ray]\npack = 2\n", 'unknown key "pack" in [ray]'),
    ],
)
def test_mistakes_in_the_users_file(tmp_path: Path, text: str, message: str) -> None:
    """One line that names the file."""
    _config(tmp_path, text)
    with pytest.raises(UserError) as caught:
        (ray_site if "[ray]" in text else slurm_site)(None, None, None)
    assert str(tmp_path / "config" / "rrmctl" / "config.toml") in str(caught.value)
    assert message in str(caught.value)


def test_ray_as_the_user_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is typed wins over the file, and the file over the environment."""
    monkeypatch.setenv("RAY_ADDRESS", "elsewhere:1")
    assert ray_site(None, None, None) == RaySite("elsewhere:1")
    _config(tmp_path, '[ray]\naddress = "head:6379"\ngpus = 0.25\nat_once = 8\n')
    assert ray_site(None, None, None) == RaySite("head:6379", 0.25, 8)
    assert ray_site("other:6379", 1.0, 2) == RaySite("other:6379", 1.0, 2)


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("head", '"head" is not the address of a Ray cluster'),
        ("ray://head:10001", '"ray://head:10001" is not the address of a Ray cluster'),
        ("auto", '"auto" is not the address'),
        ("127.0.0.1:1", "there is no Ray cluster at 127.0.0.1:1: "),
        ("127.0.0.1:99999", "there is no Ray cluster at 127.0.0.1:99999: "),
        ("head:6379 --gpus nan", "--gpus is nan, not a number from 0.0001"),
        ("head:6379 --gpus 0", "--gpus is 0, not a number from 0.0001"),
    ],
)
def test_where_there_is_no_ray_cluster(tmp_path: Path, address: str, message: str) -> None:
    """One line, at once: Ray itself would try for long."""
    result = call(*RUN, "--executor", "ray", "--address", *address.split(), "--results", tmp_path)
    assert (result.exit_code, message in result.stderr) == (2, True), result.output


def test_where_ray_is_not_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One line says how to install it."""
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.delitem(sys.modules, "rrmctl.running.ray_executor", raising=False)
    result = call(*RUN, "--executor", "ray", "--results", tmp_path)
    assert (result.exit_code, "pip install 'rrmctl[ray]'" in result.stderr) == (2, True), result.output


@pytest.mark.slow
def test_stop_ends_an_rrmctl_on_this_machine(tmp_path: Path) -> None:
    """As Ctrl-C does: checkpoints, exit code 75; and `resume` ends as one that was left alone."""
    sweep = [*RUN, "--set", "steps=3000", "--results", str(tmp_path / "stopped")]
    program = start(*sweep, "--workers", "1")
    (run,) = _running(tmp_path / "stopped", program)
    stopped = call("stop", "toy-car", "--results", tmp_path / "stopped")
    assert stopped.exit_code == 0, stopped.output
    assert "Stopped; this goes on: rrmctl resume toy-car" in stopped.stdout
    assert program.wait() == 75
    program.communicate()
    assert run_status(Layout(tmp_path / "stopped").run(run)).state is RunState.INTERRUPTED
    assert call("resume", "--results", tmp_path / "stopped").exit_code == 0
    assert call(*sweep[:-1], tmp_path / "twin").exit_code == 0
    assert numbers(tmp_path / "stopped") == numbers(tmp_path / "twin")
    nothing = call("stop", "toy-car", "--results", tmp_path / "stopped")
    assert (nothing.exit_code, nothing.stdout) == (0, "Nothing of toy-car is queued or running.\n")


def _running(root: Path, program: object) -> list[str]:
    """The runs that train, once there are some."""
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        runs = Layout(root).run_ids()
        if active := [run for run in runs if run_status(Layout(root).run(run)).rows > 0]:
            return active
        time.sleep(0.1)
    raise AssertionError(program)


def _task(root: Path, *sweep: str) -> subprocess.Popen[str]:
    """The first task of an array of these runs, as its batch script starts it."""
    assert call("run", *PLAN, *sweep, "--executor", "slurm", "--results", root).exit_code == 2  # recorded, no more
    runs = {job.id: Terms() for record in read_sweeps(Layout(root)) for job in record.everything}
    write_submission(Layout(root), Submission(name="x-1", tasks=(runs,), asked=()))
    return subprocess.Popen(
        [sys.executable, "-P", "-m", "rrmctl.running.slurm_task", str(root), "x-1"], text=True, stdout=subprocess.PIPE,
        env=os.environ | {"SLURM_ARRAY_JOB_ID": "7", "SLURM_ARRAY_TASK_ID": "0"},
    )  # fmt: skip


@pytest.mark.slow
def test_a_task_keeps_no_node_for_people(tmp_path: Path) -> None:
    """Where nothing is left but to wait for answers, it leaves; and nothing is submitted before they are there."""
    human = ["--methods", "pebble", "--seeds", "1", "--set", "teacher.kind=human"]
    task = _task(tmp_path, *human)
    printed, _ = task.communicate()
    assert task.returncode == 75, printed
    (run,) = Layout(tmp_path).run_ids()
    assert run_status(Layout(tmp_path).run(run)).state is RunState.WAITING
    Layout(tmp_path).submission("x-1").unlink()
    again = call("run", *PLAN, *human, "--executor", "slurm", "--results", tmp_path)
    assert (again.exit_code, "1 run waiting for people" in again.stderr) == (75, True), again.output


@pytest.mark.slow
def test_a_task_that_is_told_to_leave_again_and_again(tmp_path: Path) -> None:
    """It checkpoints in its own time; where it cannot be queued again its log says what to do."""
    task = _task(tmp_path, "--methods", "oracle", "--seeds", "1", "--set", "steps=20000")
    (run,) = _running(tmp_path, task)
    for _ in range(5):
        task.send_signal(signal.SIGTERM)
        time.sleep(0.05)
    printed, _ = task.communicate()
    assert task.returncode == 75, printed
    assert run_status(Layout(tmp_path).run(run)).state is RunState.INTERRUPTED
    assert "SIGTERM: 1 running, checkpoints are written" in printed
    assert "not queued again: there is no scontrol on this machine; `rrmctl resume --executor slurm`" in printed
