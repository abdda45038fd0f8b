"""Whole runs on the tasks with a camera, by an agent whose every action depends on every pixel."""

import math

import numpy as np
import pytest

import rrm
from rrm.agents import AGENTS
from rrm.config import DrqConfig, EvaluationConfig, RewardConfig
from rrm.envs import task
from tests.rrm.test_seams import Uniform, config, trained

RUNS = [
    pytest.param("button-press-image", "penalty", marks=[pytest.mark.sim, pytest.mark.slow]),
    pytest.param("sweep-into-image", "language", marks=[pytest.mark.sim, pytest.mark.slow]),
    ("toy-car-image", "proxy"),
]


class Seeing(Uniform):
    """Nothing is learned: another picture is another action."""

    def act(self, obs, *, explore):
        where = np.arange(1, 1 + obs.frames.size) % 997
        return np.cos((obs.frames.ravel() * where).sum() * np.arange(1, 1 + self._act_dim)).astype(np.float32)


def given(name, prior):
    return config(
        name, steps=100, horizon=40, agent=DrqConfig(kind="drqv2", batch=8), action_repeat=2,
        reward=RewardConfig(learner="prior", prior=prior), evaluation=EvaluationConfig(every=50, episodes=1),
    )  # fmt: skip


@pytest.fixture
def seeing(monkeypatch, request):
    """The agent in its place, where something draws what it sees."""
    if task(request.getfixturevalue("name")).needs_opengl:
        request.getfixturevalue("opengl")
    monkeypatch.setitem(AGENTS, "drqv2", f"{__name__}:Seeing")


@pytest.mark.usefixtures("seeing")
@pytest.mark.parametrize(("name", "prior"), RUNS)
def test_an_interruption_changes_nothing(tmp_path, name, prior):
    """In the middle of an episode: the rest of the run is seen, and goes, as it would have."""
    straight = trained(given(name, prior), tmp_path / "a")
    assert straight == trained(given(name, prior), tmp_path / "b", (31, None))


@pytest.mark.usefixtures("seeing")
@pytest.mark.parametrize("name", ["toy-car-image"])
def test_a_finished_run_is_evaluated_on_what_it_saw(tmp_path, name):
    """`Finished.evaluate` shows the agent its camera, and lets its actions last as long as they did."""
    run = given(name, "proxy")
    rrm.train(run, tmp_path / "run")
    first, again = (rrm.load(tmp_path / "run").evaluate(2) for _ in range(2))
    assert first == again
    assert math.isfinite(first.true_return)
