"""The methods learn: a random policy never reaches the toy car's goal, a trained one mostly does."""

import pytest

from rrm.config import EvaluationConfig, ExplorationConfig, FeedbackConfig, MrnConfig, RewardConfig, SacConfig
from rrm.training.jobs import train
from rrm.training.run_config import RunConfig

RATE = {"actor_lr": 1e-3, "critic_lr": 1e-3, "alpha_lr": 1e-3}


def run(reward, steps):
    return RunConfig(
        profile="test", task="toy-car", seed=0, steps=steps, reward=reward,
        agent=SacConfig(hidden=64, layers=2, batch=64, **RATE),
        feedback=FeedbackConfig(every=500, batch=20, budget=400, segment=25),
        exploration=ExplorationConfig(seed_steps=500), evaluation=EvaluationConfig(every=1000, episodes=20),
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reward", "steps"),
    [
        (RewardConfig(learner="true"), 8000),
        (RewardConfig(prior="proxy", hidden=64, layers=2, lr=1e-3, minibatch=64, epochs=20), 10_000),
    ],
    ids=["oracle", "rrm-proxy"],
)
def test_it_reaches_the_goal(recorder, tmp_path, reward, steps):
    """With the true reward, or a prior and 400 answers, most episodes end in success."""
    monitor = recorder()
    train(run(reward, steps), tmp_path, monitor)
    assert monitor.rows[1000].true_return < 0 < 40 < max(row.true_return for row in monitor.rows.values())
    assert max(row.success for row in monitor.rows.values()) >= 0.7


@pytest.mark.slow
@pytest.mark.parametrize("learner", ["pebble", "surf", "mrn"])
@pytest.mark.long
def test_preferences_alone_teach_the_true_order(recorder, tmp_path, learner):
    """The reward agrees with the true one on most fresh pairs, having started at chance."""
    monitor, mrn = recorder(), MrnConfig(every=1000)
    reward = RewardConfig(learner=learner, hidden=64, layers=2, lr=1e-3, minibatch=64, epochs=20, mrn=mrn)
    train(run(reward, 6000), tmp_path, monitor)
    assert monitor.rows[6000].figures["true_accuracy"] > 0.75
    assert monitor.rows[6000].labels == 220
