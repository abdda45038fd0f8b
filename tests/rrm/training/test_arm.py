"""Whole runs on the simulated arm."""

import pytest

from rrm.config import EnvConfig, EvaluationConfig, ExplorationConfig, FeedbackConfig, RewardConfig, SacConfig
from rrm.training.jobs import train
from rrm.training.run_config import RunConfig
from tests.robot import robot
from tests.rrm.training.test_jobs import interrupted

pytestmark = robot


def run(task, reward, **fields):
    sizes = {"hidden": 16, "layers": 1}
    return RunConfig(
        profile="test", task=task, seed=0, steps=260, horizon=40,
        reward=RewardConfig(**reward, **sizes, epochs=2), agent=SacConfig(**sizes, batch=16),
        feedback=FeedbackConfig(every=60, batch=4, budget=8, segment=10),
        exploration=ExplorationConfig(seed_steps=80, unsupervised_steps=20, reset_updates=2),
        evaluation=EvaluationConfig(every=130, episodes=1, success="last"), **fields,
    ).canonical()  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "reward"),
    [
        ("panda-reach", {"prior": "1d"}),
        ("panda-push", {"learner": "true"}),
        ("panda-push", {}),
        ("panda-pick-and-reach", {"prior": "h2o"}),
    ],
)
def test_a_run_in_pieces_is_the_run(recorder, networks, tmp_path, task, reward):
    """Stopped in the middle of episodes and resumed, with everything varying: rows and networks are equal."""
    env = EnvConfig(cube_mass=(0.05, 0.2), cube_size=(0.04, 0.06), latency=(0, 2), noise=(0.001, 0.001))
    config, straight = run(task, reward, env=env), recorder()
    assert train(config, tmp_path / "a", straight)
    pieces, count = interrupted(config, tmp_path / "b", recorder, 93)
    assert count > 2
    assert straight.numbers() == pieces.numbers()
    assert networks(tmp_path / "a") == networks(tmp_path / "b")


@pytest.mark.slow
def test_what_varies_is_seen(recorder, tmp_path):
    """A run whose cube varies is another run, in its numbers too; saying what is so anyway is the same."""
    monitors = [recorder() for _ in range(3)]
    for monitor, env in zip(
        monitors, (EnvConfig(), EnvConfig(friction=(0.6, 0.6)), EnvConfig(noise=(0, 0.02))), strict=True
    ):
        train(run("panda-reach", {"learner": "true"}, env=env), tmp_path / str(id(monitor)), monitor)
    usual, same, varied = (monitor.numbers() for monitor in monitors)
    assert usual == same != varied


@pytest.mark.slow
@pytest.mark.long
def test_it_reaches_the_cube(recorder, tmp_path):
    """With the true reward, at the laptop's settings, nearly every episode ends at the cube after 10,000 steps."""
    rate = dict.fromkeys(("actor_lr", "critic_lr"), 1e-3)
    agent = SacConfig(hidden=128, batch=128, discount=0.95, critic_norm="layer", tau=0.01, target_every=1, **rate)
    monitor = recorder()
    config = RunConfig(
        profile="test", task="panda-reach", seed=0, steps=10_000, reward=RewardConfig(learner="true"), agent=agent,
        exploration=ExplorationConfig(seed_steps=1000),
        evaluation=EvaluationConfig(every=5000, episodes=20, success="last"),
    )  # fmt: skip
    assert train(config, tmp_path, monitor)
    assert monitor.rows[10_000].success >= 0.8
