"""The simulated arm where PyBullet is not installed: planned as ever, refused before anything begins."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from rrmctl.cli.run import _record
from rrmctl.planning.manifest import load
from rrmctl.planning.plan import make_plan
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.terminal import console

#: A process that does not find the package.
WITHOUT = """
import sys
from importlib import metadata
real = metadata.version
def version(name):
    if name == "pybullet":
        raise metadata.PackageNotFoundError(name)
    return real(name)
metadata.version = version
"""
PROGRAM = WITHOUT + "from rrmctl.cli.app import main; main()"
WORKER = WITHOUT + "from rrmctl.running.worker import main; sys.exit(main(sys.argv[1:]))"
MANIFEST = """
title = "The arm"
reproduces = ["nothing"]
rule = "none"
seeds = 1

[grid]
tasks = ["panda-reach"]
methods = ["oracle", "rrm-1d"]
"""


def python(folder: Path, code: str, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", code, *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.fixture
def workshop(tmp_path: Path) -> Path:
    (tmp_path / "experiments").mkdir()
    (tmp_path / "experiments" / "arm.toml").write_text(MANIFEST)
    return tmp_path


def recorded(folder: Path) -> RunFolder:
    """A run that was asked for and not begun."""
    plan, layout = make_plan(load(folder / "experiments" / "arm.toml")), Layout(folder / "results")
    _record(console(stderr=True), layout, plan)
    return layout.run(plan.jobs[0].id)


@pytest.mark.slow
def test_planned_and_refused(workshop: Path) -> None:
    """`plan` needs no simulator; `run` and `resume` say what to install, and leave nothing behind."""
    planned = python(workshop, PROGRAM, "plan", "arm")
    assert (planned.returncode, planned.stderr) == (0, "")
    assert "rrm-1d" in planned.stdout
    refused = [python(workshop, PROGRAM, "run", "arm")]
    assert not (workshop / "results").exists()
    run = recorded(workshop)
    refused.append(python(workshop, PROGRAM, "resume"))
    assert [path.name for path in run.path.iterdir()] == ["config.json"]
    for done in refused:
        assert done.returncode == 2
        last = done.stderr.splitlines()[-1]
        assert last.startswith("error: panda-reach needs pybullet, which is not installed")
        assert last.endswith("pip install 'rrmctl[robot]'")
        assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_worker_by_itself_refuses(workshop: Path) -> None:
    """A line in the log, no traceback."""
    run = recorded(workshop)
    done = python(workshop, WORKER, str(workshop / "results"), run.id)
    assert done.returncode == 2
    assert done.stderr.startswith("--- ConfigError: panda-reach needs pybullet")
    assert len(done.stderr.splitlines()) == 1
    assert json.loads(run.status.read_text())["state"] == "failed"
