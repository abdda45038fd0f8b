"""`rrmctl show --film`: an episode of the evaluation, as a video that other programs read."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from rrm.checkpoint import encode
from rrm.envs import make
from rrm.envs.observer import Observer
from rrm.robot.config import RigConfig
from rrm.seeding import Streams, evaluation_seed
from rrm.training.build import build_agent
from rrm.training.deployments import Laboratory
from rrm.training.episodes import evaluate
from rrm.training.kinds import DemosConfig
from rrm.training.run_config import RunConfig
from rrmctl.cli.run import _record
from rrmctl.planning.manifest import load
from rrmctl.planning.plan import make_plan
from rrmctl.running.config_file import config_content, load_config
from rrmctl.running.film import _deployed, _Reel
from rrmctl.store.curve import read_curve
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.provenance import record_config
from rrmctl.store.status import RunState, Status, write_status
from rrmctl.terminal import console
from tests.robot import robot
from tests.rrmctl.cli.test_pictures import PROGRAM, assert_refused
from tests.rrmctl.cli.test_run import call

MANIFEST = """
title = "What is filmed"
reproduces = ["nothing"]
rule = "none"
seeds = 1

[grid]
tasks = ["{task}"]
methods = ["oracle"]

[defaults]
steps = 200
horizon = 20
evaluation = {{ every = 100, episodes = 3 }}
exploration = {{ seed_steps = 100 }}
"""
SMALL = RigConfig(width=480, height=360, boards=8)


def recorded(folder: Path, task: str, more: str = "") -> RunFolder:
    """A run that was asked for and not begun."""
    path, layout = folder / "seen.toml", Layout(folder / "results")
    path.write_text(MANIFEST.format(task=task) + more)
    plan = make_plan(load(path))
    _record(console(stderr=True), layout, plan)
    return layout.run(plan.jobs[0].id)


def settings(run: RunFolder) -> RunConfig:
    config = load_config(run)
    assert isinstance(config, RunConfig)
    return config


def networks(config: RunConfig, seed: int = 0, fill: float | None = None) -> bytes:
    """Those of an agent that has learned nothing."""
    agent = build_agent(config, Streams(seed))
    if fill is not None:
        for weights in agent.weights().values():
            weights.fill_(fill)
    return encode({"agent": agent.state_dict()})


def untrained(folder: Path, task: str) -> RunFolder:
    run = recorded(folder, task)
    run.model.write_bytes(networks(settings(run)))
    write_status(run, Status(state=RunState.DONE))
    return run


def show(run: RunFolder, *words: str | Path):
    return call("show", run.id, *words, "--results", run.results)


def filmed(run: RunFolder, path: Path, *words: str) -> tuple[str, np.ndarray]:
    """What is said of a film, and its pictures [n, height, width, 3], RGB."""
    done = show(run, "--film", path, *words)
    assert done.exit_code == 0, done.output
    assert done.stderr == ""
    return done.stdout.strip().removeprefix(f"{path}: "), pictures(path)


def pictures(path: Path) -> np.ndarray:
    video, frames = cv2.VideoCapture(str(path)), []
    while (read := video.read())[0]:
        frames.append(read[1][..., ::-1])
    return np.array(frames)


def score(said: str) -> tuple[float, float]:
    """Return and success in what is said."""
    words = said.partition(": ")[2].partition(";")[0].split(", ")
    return float(words[0].removeprefix("return ")), float("success" in words)


@pytest.fixture(scope="module")
def car(tmp_path_factory) -> RunFolder:
    """A short run of the toy car, trained by a worker."""
    run = recorded(tmp_path_factory.mktemp("car"), "toy-car")
    subprocess.run([sys.executable, "-m", "rrmctl.running.worker", str(run.results), run.id], check=True)
    return run


def test_films_are_the_evaluation(car, tmp_path):
    """Of the last step's episodes: together they have the return and success that the curve's last row has."""
    films = [filmed(car, tmp_path / f"{number}.webm", "--episode", str(number)) for number in range(3)]
    returns, successes = np.mean([score(said) for said, _ in films], axis=0)
    last = read_curve(car).to_pylist()[-1]
    assert last["episodes"] == 3
    assert returns == pytest.approx(last["true_return"], abs=0.05)
    assert successes == pytest.approx(last["success"])
    for number, (said, seen) in enumerate(films):
        assert said.startswith(f"episode {number} after 200 steps: return ")
        assert said.endswith("; 21 pictures, in real time")
        assert seen.shape == (21, 386, 320, 3)
        assert np.abs(np.diff(seen.astype(int), axis=0)).max(axis=(1, 2, 3)).min() > 50  # the car moves, steps count
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.webm", "1.webm", "2.webm"]


def test_an_episode_of_a_step_whose_networks_are_kept(car, tmp_path):
    """Is the one of that step's evaluation, by the networks of then."""
    config = settings(car)
    (car.path / "networks").mkdir(exist_ok=True)
    (car.path / "networks" / "100.safetensors").write_bytes(networks(config, seed=1))
    said, _ = filmed(car, tmp_path / "then.mp4", "--checkpoint", "100")
    first = config.evaluation.model_copy(update={"episodes": 1})
    agent, env = build_agent(config, Streams(1)), Observer("toy-car", config.horizon)
    assert score(said)[0] == pytest.approx(evaluate(agent, env, first, seed=0, step=100).true_return, abs=0.05)
    assert said.startswith("episode 0 after 100 steps: ")
    done = show(car, "--film", tmp_path / "never.webm", "--checkpoint", "150")
    hint = "hint: --checkpoint takes 100, 200"
    assert done.exit_code == 2
    assert done.stderr == f"error: run {car.id} has kept no networks of step 150\n{hint}\n"


@pytest.mark.slow
def test_a_film_is_there_as_a_whole_or_not_at_all(tmp_path):
    """What was there before stays where a film comes to nothing, and nothing else is left; nobody else hears OpenCV."""
    run, path = untrained(tmp_path, "toy-car"), tmp_path / "films" / "car.WebM"
    path.parent.mkdir()
    path.write_bytes(b"another film")
    whole, broken = run.model.read_bytes(), networks(settings(run), fill=float("nan"))
    run.model.write_bytes(broken)
    done = show(run, "--film", path)
    assert done.exit_code == 2
    assert "the action after 0 updates is [nan, nan]" in done.stderr
    assert path.read_bytes() == b"another film"
    assert list(path.parent.iterdir()) == [path]
    run.model.write_bytes(whole)
    command = [*PROGRAM, "show", run.id, "--film", str(path), "--results", str(run.results)]
    outcome = subprocess.run(command, capture_output=True, text=True, check=True)
    assert outcome.stderr == ""
    assert len(pictures(path)) == 21
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--film", "car.gif"), "car.gif: a film's name ends in .webm or .mp4"),
        (("--film", "none/car.webm"), "cannot write none/car.webm: No such file"),
        (("--film", "none/car.webm"), "make the folder writable, or name another (of results"),
        (("--film", ""), "--film is empty"),
        (("--film", "car.webm", "--cameras"), "a policy of toy-car has nothing to do at an arm"),
        (("--film", "car.webm", "--episode", "-1"), "--episode"),
        (("--film", "car.webm", "--checkpoint", "0"), "--checkpoint"),
        (("--cameras",), "say what to film"),
        (("--episode", "0"), "say what to film"),
    ],
)
def test_films_that_cannot_be(car, tmp_path, monkeypatch, words, message):
    """Exit code 2, one message, no file."""
    monkeypatch.chdir(tmp_path)
    done = show(car, *words)
    assert done.exit_code == 2, done.output
    assert message in done.stderr
    assert "Traceback" not in done.output
    assert list(tmp_path.iterdir()) == []


def test_runs_of_which_there_is_no_film(tmp_path):
    """They are under way, or play another run's policy: the message says which steps, and which run, there are."""
    run = recorded(tmp_path, "panda-reach")
    config = settings(run)
    done = show(run, "--film", tmp_path / "arm.webm")
    assert (done.exit_code, done.stderr) == (2, f"error: run {run.id} is queued\nhint: it has kept none so far\n")
    (run.path / "networks").mkdir()
    (run.path / "networks" / "100.safetensors").touch()
    done = show(run, "--film", tmp_path / "arm.webm")
    assert done.stderr == f"error: run {run.id} is queued\nhint: --checkpoint takes 100\n"
    job = DemosConfig(task="panda-reach", expert=config)
    other = Layout(run.results).run(job.identity)
    record_config(other, config_content(job))
    done = show(other, "--film", tmp_path / "arm.webm")
    assert done.exit_code == 2
    assert f"run {other.id} (panda-reach, demos) trains no policy" in done.stderr
    assert f"whose policy plays there: {run.id}" in done.stderr
    done = show(recorded(tmp_path, "panda-reach", "action_repeat = 2"), "--film", tmp_path / "arm.webm", "--cameras")
    assert done.exit_code == 2
    assert "an arm is told what to do at every step; its action_repeat is not 1" in done.stderr
    assert not (tmp_path / "arm.webm").exists()


@pytest.mark.slow
@pytest.mark.sim
def test_without_opengl(tmp_path, no_opengl):
    """Said as everywhere, and no film."""
    run = untrained(tmp_path, "button-press")
    command = [*PROGRAM, "show", run.id, "--film", str(tmp_path / "press.webm"), "--results", str(run.results)]
    assert_refused(subprocess.run(command, env=no_opengl, capture_output=True, text=True, check=False))
    assert not list(tmp_path.glob("*.webm"))


@pytest.mark.parametrize(
    ("name", "count", "rate"),
    [
        *(pytest.param(name, 6, 20, marks=pytest.mark.sim) for name in ("button-press", "sweep-into-image")),
        pytest.param("walker-walk", 11, 20, marks=pytest.mark.sim),
        pytest.param("quadruped-walk", 11, 25, marks=pytest.mark.sim),
        pytest.param("panda-push", 21, 20, marks=robot),
        ("toy-car-image", 21, 10),
    ],
)
def test_every_suite_as_people_see_it(tmp_path, name, count, rate, opengl):
    """Upright and in its colours, above the strip: at the beginning what the environment draws then. At the end it is
    another picture; as many are shown as life has time for.
    """
    run = untrained(tmp_path, name)
    _, seen = filmed(run, tmp_path / "seen.webm")
    env = make(name, horizon=20, render_mode="rgb_array")
    env.reset(seed=evaluation_seed(0, 200, 0))
    drawn = env.render()
    env.close()
    height, width, _ = drawn.shape
    assert seen.shape == (count, height + 66, width, 3)
    assert cv2.VideoCapture(str(tmp_path / "seen.webm")).get(cv2.CAP_PROP_FPS) == pytest.approx(rate)
    first, last = seen[0, :height].astype(int), seen[-1, :height].astype(int)

    def off(other):
        return np.abs(first - other).mean()

    assert off(drawn) < 5
    assert off(drawn) < 0.9 * min(off(drawn[::-1]), off(drawn[..., ::-1]))
    assert np.abs(first - last).max() > 50
    strips = seen[:, height:].astype(int)
    assert (strips.max(axis=(1, 2, 3)) > 180).all()  # something is written there
    assert np.abs(strips[0] - strips[-1]).max() > 100


@robot
@pytest.mark.slow
def test_what_the_cameras_of_the_workplace_see(tmp_path):
    """Both side by side, with green around the markers; it is the episode that `deploy` plays, undisturbed."""
    run = untrained(tmp_path, "panda-push")
    config = settings(run)
    reel = _Reel(tmp_path / "film.webm", ("an arm",))
    said = _deployed(reel, config, run.model, 1, SMALL)
    reel.developed()
    (alone,) = Laboratory(SMALL).play(config, run.model, 1, 2, lambda: False)
    assert said == f"return {alone.total:.1f}, {'success' if alone.success else 'no success'}"
    seen = pictures(tmp_path / "film.webm").astype(int)
    assert seen.shape == (21, 360 + 48, 960, 3)
    for camera in (seen[:, :360, :480], seen[:, :360, 480:]):
        red, green, blue = np.moveaxis(camera, -1, 0)
        assert ((green - np.maximum(red, blue) > 60).sum(axis=(1, 2)) > 10).all()
    assert np.abs(seen[0] - seen[-1]).max() > 100
