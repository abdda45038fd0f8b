"""`--executor slurm` on a real Slurm of three nodes: what is submitted, and what is said of it."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
from pathlib import Path

import pytest

from rrmctl.store.layout import Layout
from rrmctl.store.owner import Beat, Machine
from rrmctl.store.status import RunState, read_status, write_status
from rrmctl.store.sweeps import read_sweeps
from tests.cluster.slurm import Slurm, until
from tests.cluster.sweeps import same, told
from tests.rrmctl.cli.test_imitation import TOY
from tests.rrmctl.cli.test_run import PLAN, PROGRAM, call

pytestmark = pytest.mark.cluster


def test_a_sweep_of_several_levels(cluster: Slurm, tmp_path: Path) -> None:
    """Expert, demonstrations, prior, runs, one after the other; asked for twice, submitted once; as on this machine."""
    mine, twin = tmp_path / "mine", tmp_path / "twin"
    asked = ["run", *TOY, "--executor", "slurm", "--results", mine]
    first = call(*asked)
    assert first.exit_code == 75, first.output
    assert first.stdout.count("submitted as job") == 4
    assert f"Watch: rrmctl status toy-car --results {mine}" in first.stdout
    queued = len(cluster.queue())
    again = call(*asked)
    assert (again.exit_code, "submitted" in again.stdout) == (75, False)
    assert "5 runs queued or running there already" in again.stderr
    assert len(cluster.queue()) == queued == 5
    until(lambda: "tasks of 4 runs queued (Dependency 4)" in call("status", "--results", mine).stdout)
    assert "Slurm: tasks of 1 run running on n" in call("status", "--results", mine).stdout
    assert "Nothing is running" not in call("status", "--results", mine).stdout
    assert call("run", *TOY, "--results", twin).exit_code == 0
    until(lambda: not cluster.queue())
    assert told(mine)["done"] == 5
    last = call(*asked)
    assert last.exit_code == 0, last.output
    assert "All done" in last.stdout
    same(mine, twin)


def test_arrays_are_cut_and_packed(cluster: Slurm, tmp_path: Path) -> None:
    """Where the site takes five tasks an array, six become two arrays; packed by three, one of two tasks."""
    asked = ["run", *PLAN, "--set", "steps=300", "--seeds", "6", "--executor", "slurm", "--results", tmp_path]
    single = call(*asked, "--methods", "oracle", "--at-once", "1")
    assert [line.split(" submitted")[0] for line in single.stdout.splitlines()[:2]] == [
        "toy-car: 5 runs", "toy-car: 1 run"
    ]  # fmt: skip
    call("stop", "toy-car", "--results", tmp_path)
    packed = call(*asked, "--methods", "oracle", "--pack", "3")
    assert "6 runs submitted as job" in packed.stdout
    assert "2 tasks" in packed.stdout
    until(lambda: not cluster.queue())
    assert told(tmp_path)["done"] == 6


def test_a_run_that_needs_a_failed_one_is_blocked(cluster: Slurm, tmp_path: Path) -> None:
    """As on this machine: its task looks, says so and leaves; tried again on request."""
    strict = ["run", *TOY, "--set", "imitation.expert_success=1.0", "--executor", "slurm", "--results", tmp_path]
    assert call(*strict).exit_code == 75
    until(lambda: not cluster.queue())
    state = told(tmp_path)
    assert (state["done"], state["failed"], state["blocked"]) == (1, 1, 3)
    logs = "".join(path.read_text() for path in (tmp_path / "slurm").glob("*.log"))
    assert logs.count("not run: run") == 3
    again = call(*strict)
    assert (again.exit_code, "submitted" in again.stdout) == (1, False)


def test_what_sbatch_refuses_is_not_recorded(cluster: Slurm, tmp_path: Path) -> None:
    """Its words, exit code 2, and nothing that looks submitted."""
    asked = ["run", *PLAN, "--methods", "oracle", "--seeds", "1", "--executor", "slurm", "--results", tmp_path]
    refused = call(*asked, "--slurm=--partition=nowhere")
    assert refused.exit_code == 2
    assert "sbatch refused: sbatch: error: invalid partition specified: nowhere" in " ".join(refused.stderr.split())
    assert Layout(tmp_path).submissions() == []
    assert told(tmp_path)["slurm"] is None
    (tmp_path / "config" / "rrmctl").mkdir(parents=True)
    (tmp_path / "config" / "rrmctl" / "config.toml").write_text('[slurm]\nflags = ["--hold"]\nsetup = "export X=1"\n')
    assert call(*asked).exit_code == 75
    assert cluster.ask("squeue", "-h", "-o", "%T %r") == "PENDING JobHeldUser"
    assert told(tmp_path)["slurm"]["queued"].keys() == {"JobHeldUser"}


def test_killed_between_sbatch_and_the_record(cluster: Slurm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Slurm took the array and nobody wrote down its number: the same command finds it by its name."""
    deadly = tmp_path / "bin"
    deadly.mkdir()
    (deadly / "sbatch").write_text('#!/bin/sh\n/usr/bin/sbatch --hold "$@"\nkill -9 $PPID\n')
    (deadly / "sbatch").chmod(0o755)
    results = tmp_path / "results"
    asked = ["run", *PLAN, "--methods", "oracle", "--seeds", "2", "--executor", "slurm", "--results", str(results)]
    path = f"{deadly}:{os.environ['PATH']}"
    died = subprocess.run([*PROGRAM, *asked], env=os.environ | {"PATH": path}, capture_output=True, check=False)
    assert died.returncode == -signal.SIGKILL
    assert len(cluster.queue()) == 2
    again = call(*asked)
    assert (again.exit_code, "submitted" in again.stdout) == (75, False)
    assert len(cluster.queue()) == 2
    monkeypatch.setenv("PATH", str(tmp_path))
    said = call("status", "--results", results)
    assert said.exit_code == 0
    assert "what is queued or lost is not known: there is no squeue on this machine" in said.stdout
    assert call(*asked).exit_code == 2  # rather than twice


def test_a_lost_run(cluster: Slurm, tmp_path: Path) -> None:
    """It says that it runs on a machine that gives no sign of life, and no task of it is there."""
    asked = ["run", *PLAN, "--methods", "oracle", "--seeds", "1", "--executor", "slurm", "--results", tmp_path]
    call(*asked, "--slurm=--hold")
    call("stop", "toy-car", "--results", tmp_path)
    (sweep,) = read_sweeps(Layout(tmp_path))
    folder = Layout(tmp_path).run(sweep.jobs[0].id)
    folder.lease_of(1).write_bytes(Beat("o", 1, Machine("elsewhere", "boot")).encoded())
    write_status(folder, dataclasses.replace(read_status(folder), state=RunState.RUNNING, host="elsewhere"))
    assert "Lost: 1 run, last on elsewhere" in call("status", "--results", tmp_path).stdout
    assert "1 run submitted" in call(*asked, "--slurm=--hold").stdout
