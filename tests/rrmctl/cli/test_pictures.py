"""Runs whose agents see pictures: refused before they begin where nothing draws; and what they see is shown."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from rrm.buffers.frames import Frames
from rrm.envs import make, task
from rrm.rendering import Renderer
from rrm.training.jobs import fingerprint
from rrmctl.cli.run import _record
from rrmctl.planning.manifest import load
from rrmctl.planning.plan import Plan, make_plan
from rrmctl.running.config_file import load_config
from rrmctl.running.worker import WorkerExit
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.terminal import console

PROGRAM = [sys.executable, "-c", "from rrmctl.cli.app import main; main()"]
MANIFEST = """
title = "What is seen"
reproduces = ["nothing"]
rule = "none"
seeds = 1

[grid]
tasks = ["{task}"]
methods = ["oracle"]

[defaults]
steps = 400
horizon = 20
action_repeat = 2
exploration = {{ seed_steps = 100 }}
agent = {{ kind = "{agent}" }}
"""


def program(folder: Path, *words: str, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    command = [*PROGRAM, *words, "--results", "results"]
    return subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True, check=False)


def manifest(folder: Path, name: str, agent: str = "drqv2") -> Plan:
    experiments = folder / "experiments"
    experiments.mkdir(exist_ok=True)
    path = experiments / "seen.toml"
    path.write_text(MANIFEST.format(task=name, agent=agent))
    return make_plan(load(path))


def recorded(folder: Path, name: str, agent: str = "drqv2") -> RunFolder:
    """A run that was asked for and not begun."""
    plan, layout = manifest(folder, name, agent), Layout(folder / "results")
    _record(console(stderr=True), layout, plan)
    return layout.run(plan.jobs[0].id)


def assert_refused(done: subprocess.CompletedProcess[str]) -> None:
    assert done.returncode == 2
    last = done.stderr.splitlines()[-1]
    assert last.startswith("error: nothing here draws pictures with OpenGL (egl: ")
    assert "apt-get install libegl1" in last
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_refused_before_it_begins(tmp_path: Path, no_opengl: dict[str, str]) -> None:
    """`run` and `resume` say what is missing and what to install, and leave nothing behind."""
    manifest(tmp_path, "button-press-image")
    assert_refused(program(tmp_path, "run", "seen", env=no_opengl))
    assert not (tmp_path / "results").exists()
    run = recorded(tmp_path, "button-press-image")
    assert_refused(program(tmp_path, "resume", env=no_opengl))
    assert [path.name for path in run.path.iterdir()] == ["config.json"]


@pytest.mark.slow
@pytest.mark.sim
def test_a_worker_by_itself_refuses(tmp_path: Path, no_opengl: dict[str, str]) -> None:
    """On another machine than the one it was planned on, say: a line in the log, no traceback."""
    run = recorded(tmp_path, "button-press-image")
    command = [sys.executable, "-m", "rrmctl.running.worker", str(tmp_path / "results"), run.id]
    done = subprocess.run(command, env=no_opengl, capture_output=True, text=True, check=False)
    assert done.returncode == WorkerExit.CRASHED
    assert done.stderr.startswith("--- RenderingError: nothing here draws")
    assert len(done.stderr.splitlines()) == 1
    assert json.loads(run.status.read_text())["state"] == "interrupted"  # it goes on where something draws


@pytest.mark.sim
@pytest.mark.parametrize(("name", "agent"), [("button-press-image", "sac"), ("toy-car-image", "drqv2")])
def test_only_what_looks_through_opengl_needs_it(tmp_path: Path, name: str, agent: str) -> None:
    """An agent of states on the same task does not, nor does the toy car, which is drawn otherwise."""
    config = load_config(recorded(tmp_path, name, agent))
    assert not config.needs_opengl
    assert "renderer" not in fingerprint(config)


@pytest.mark.sim
def test_the_renderer_is_recorded(tmp_path: Path, opengl: Renderer) -> None:
    """Pictures of another one may differ: its name is a fact about the run's environment."""
    config = load_config(recorded(tmp_path, "sweep-into-image"))
    assert fingerprint(config)["renderer"] == opengl.name


def shown(folder: Path, run: RunFolder) -> tuple[subprocess.CompletedProcess[str], np.ndarray]:
    """What `show --frames` says and draws: [moments, stack, height, width, 3], RGB."""
    done = program(folder, "show", run.id, "--frames", "seen.png")
    assert done.returncode == 0, done.stderr
    picture = cv2.imread(str(folder / "seen.png"))
    assert picture is not None
    stacks = picture[..., ::-1].reshape(3, picture.shape[0] // 3, 8, picture.shape[1] // 8, 3).transpose(2, 0, 1, 3, 4)
    return done, stacks


def test_what_a_run_that_has_not_begun_will_see(tmp_path: Path) -> None:
    """Eight moments of an episode; at the first the newest picture is the only one, later each is another."""
    done, stacks = shown(tmp_path, recorded(tmp_path, "toy-car-image"))
    assert done.stdout == "seen.png: 8 moments of an episode of random actions, each from its oldest picture down\n"
    env = make("toy-car-image")
    env.reset(seed=0)
    first = env.frame(task("toy-car-image").spaces.frames)  # type: ignore[arg-type]
    for picture in stacks[0]:
        np.testing.assert_array_equal(picture, first)
    assert len({picture.tobytes() for stack in stacks[1:] for picture in stack}) > 8


def test_what_a_run_has_stored(tmp_path: Path) -> None:
    """A checkpoint's pictures are shown and left as they are, whoever writes there meanwhile."""
    run = recorded(tmp_path, "toy-car-image")
    space = task("toy-car-image").spaces.frames
    assert space is not None
    frames = Frames(space)
    for row in range(40):
        frames.append(np.full(space.planar, row, np.uint8))
    run.checkpoint.mkdir()
    frames.save(run.checkpoint / "frames.bin")
    with (run.checkpoint / "frames.bin").open("ab") as file:
        file.write(b"half of a picture")
    before = (run.checkpoint / "frames.bin").read_bytes()
    done, stacks = shown(tmp_path, run)
    assert "pictures that the run has stored" in done.stdout
    assert stacks.max(axis=(2, 3, 4)).tolist() == [[b, b + 1, b + 2] for b in (0, 5, 11, 16, 21, 26, 32, 37)]
    assert (run.checkpoint / "frames.bin").read_bytes() == before


def test_runs_that_see_nothing(tmp_path: Path) -> None:
    """One line; the file is not made."""
    run = recorded(tmp_path, "toy-car-image", "sac")
    done = program(tmp_path, "show", run.id, "--frames", "seen.png")
    assert done.returncode == 2
    assert done.stderr == (
        f"error: run {run.id} (toy-car-image, oracle) sees no pictures\nhint: it learns from states alone\n"
    )
    assert not (tmp_path / "seen.png").exists()
    run = recorded(tmp_path, "toy-car-image")
    done = program(tmp_path, "show", run.id, "--frames", "none/seen.png")
    assert done.returncode == 2
    assert "none/seen.png" in done.stderr
