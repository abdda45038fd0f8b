"""The library's front door: what docs/library.md shows runs as it stands there, and means what it says."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rrm
from rrm.config import CameraConfig, DrqConfig, EvaluationConfig, ExplorationConfig, RewardConfig
from rrm.envs.observer import Observer
from rrm.errors import ConfigError, MissingResultError
from rrm.training.loop import Trainer
from rrm.types import Transition

PAGE = Path(__file__).parents[2] / "docs" / "library.md"


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """What the page's code leaves behind: its names, and the folder it ran in."""
    folder, names = tmp_path_factory.mktemp("library"), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for code in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL):
            exec(code, names)
    return names, folder


@pytest.mark.slow
def test_a_run_is_trained_loaded_and_used_elsewhere(shown):
    """The curve is there, the policy acts, and the wrapper pays prior plus residual of the state before the step."""
    names, folder = shown
    run, env = names["run"], names["env"]
    rows = rrm.train(names["config"], folder / "runs" / "mine")
    assert [row.step for row in rows] == [500, 1000, 1500]
    assert rows[-1].labels == 100
    assert {"label_accuracy", "critic_loss"} <= set(rows[-1].figures)
    obs, _ = env.reset(seed=3)
    act = run.policy(obs)
    assert act.shape == env.action_space.shape
    _, reward, *_, info = env.step(act)
    goal, car = obs[2:4], obs[0:2]
    scale = max(1.0, run.prior._seen.std)
    assert abs(reward - -np.linalg.norm(goal - car) / scale) <= 1.0 + 1e-5  # the residual is a tanh
    assert info["true_reward"] != reward
    assert run.evaluate(episodes=5, seed=1) == run.evaluate(episodes=5, seed=1)


@pytest.mark.slow
def test_what_is_trained_here_is_what_rrmctl_trains(shown, tmp_path):
    """The same configuration gives the same networks in a folder of `rrmctl`, and `load` takes that one too."""
    from rrmctl.running import worker
    from rrmctl.running.config_file import config_content
    from rrmctl.store.layout import Layout
    from rrmctl.store.provenance import record_config

    names, folder = shown
    there = Layout(tmp_path).run(names["config"].identity)
    record_config(there, config_content(names["config"]))
    command = [sys.executable, "-m", worker.__name__, str(tmp_path), there.id]
    subprocess.run(command, check=True, stderr=subprocess.DEVNULL)
    mine = (folder / "runs" / "mine" / "model.safetensors").read_bytes()
    assert mine == there.model.read_bytes()
    assert rrm.load(there.path).evaluate(3) == names["run"].evaluate(3)


def test_a_reward_on_frames_is_paid_for_frames(tmp_path):
    """Whoever trains on it sees what the run's agent saw, by actions that last as long, and is paid as it was."""
    agent = DrqConfig(kind="drqv2", hidden=8, layers=1, batch=4, channels=4, strides=(2, 2), features=4)
    config = rrm.RunConfig(
        task="toy-car-image", seed=0, steps=120, horizon=20, action_repeat=2, camera=CameraConfig(size=16), agent=agent,
        reward=rrm.RewardConfig(prior="proxy", hidden=8, layers=1, epochs=2),
        feedback=rrm.FeedbackConfig(every=40, batch=4, budget=8, segment=10),
        exploration=rrm.ExplorationConfig(seed_steps=40, reset_updates=2),
        evaluation=rrm.EvaluationConfig(every=60, episodes=1),
    ).canonical()  # fmt: skip
    rrm.train(config, tmp_path / "run")
    run, trainer = rrm.load(tmp_path / "run"), Trainer(config)
    while trainer.step < config.steps:
        trainer.advance()
    env = rrm.LearnedReward(rrm.make("toy-car-image", horizon=20), run)
    theirs = Observer("toy-car-image", 20, config.spaces.frames, 2)
    seen, _ = env.reset(seed=3)
    obs = theirs.reset(seed=3)
    trainer.prior.begin_episode(obs.state)
    for step in range(10):
        assert env.observation_space.contains(seen)
        np.testing.assert_array_equal(seen, obs.frames)
        act = run.policy(seen)
        seen, reward, _, over, info = env.step(act)
        then, true, _, _, told = theirs.step(act)
        prior = trainer.prior.look(obs, act, told)
        lived = Transition(obs.state, act, then.state, prior, 0.0, true, False, over, obs.frames, then.frames)
        assert reward == pytest.approx(trainer.sources["preferences"].reward(lived), abs=1e-5)
        assert info["true_reward"] == true
        assert over == (step == 9)
        obs = then


def test_what_is_no_finished_run_is_said(tmp_path):
    """Nothing there, another run's folder, a run under way, one without a learned reward."""
    with pytest.raises(ConfigError, match=r"config\.json is not the configuration of a run"):
        rrm.load(tmp_path)
    small = rrm.SacConfig(hidden=8, layers=1, batch=8)
    config = rrm.RunConfig(
        task="toy-car", seed=0, steps=60, agent=small, reward=rrm.RewardConfig(learner="true"),
        exploration=rrm.ExplorationConfig(seed_steps=20), evaluation=rrm.EvaluationConfig(every=30, episodes=1),
    )  # fmt: skip
    rows = rrm.train(config, tmp_path / "a")
    assert repr(rrm.train(config, tmp_path / "a")) == repr(rows)
    with pytest.raises(ConfigError, match="holds another run"):
        rrm.train(config.model_copy(update={"seed": 1}), tmp_path / "a")
    with pytest.raises(ConfigError, match="holds no learned reward: the method is oracle"):
        _ = rrm.load(tmp_path / "a").reward
    (tmp_path / "a" / "model.safetensors").unlink()
    with pytest.raises(MissingResultError, match=r"model\.safetensors"):
        rrm.load(tmp_path / "a")


def test_the_front_door_is_light_and_whole():
    """Every name is offered with a docstring, and asking for the package imports nothing heavy."""
    for name in rrm.__all__:
        assert getattr(rrm, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = rrm.nonsense
    code = "import rrm, sys, json; print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    loaded = json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout)
    assert not {"torch", "numpy", "pydantic", "gymnasium"} & set(loaded)


@pytest.mark.parametrize("counted", ["any", "last"])
def test_success_counts_as_in_the_run(tmp_path, monkeypatch, counted):
    """Its evaluations and those asked for afterwards look at the same step of an episode."""
    config = rrm.RunConfig(
        task="toy-car", seed=0, steps=120, horizon=20, agent=rrm.SacConfig(hidden=8, layers=1, batch=4),
        reward=RewardConfig(learner="true"), exploration=ExplorationConfig(seed_steps=50),
        evaluation=EvaluationConfig(every=120, episodes=1, success=counted),
    )  # fmt: skip
    rrm.train(config, tmp_path)
    played = []
    monkeypatch.setattr(rrm.runs, "evaluate", lambda *args, **_: played.append(args[2]))
    rrm.load(tmp_path).evaluate(3)
    assert (played[0].episodes, played[0].success) == (3, counted)
