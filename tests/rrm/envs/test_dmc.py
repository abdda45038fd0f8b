"""The DM-Control tasks against the suite's physics."""

import numpy as np
import pytest

from rrm.envs import make, task
from rrm.errors import ConfigError, NumericalError

pytestmark = pytest.mark.sim

NAMES = ["walker-walk", "quadruped-walk"]
every_task = pytest.mark.parametrize("name", NAMES)


@pytest.fixture(scope="module")
def envs():
    made = {name: make(name) for name in NAMES}
    yield made
    for env in made.values():
        env.close()


def steps(env, count=50):
    acts = np.random.default_rng(0).uniform(-1, 1, (count, *env.action_space.shape)).astype(np.float32)
    return [env.step(act) for act in acts]


@every_task
def test_upright(name, envs):
    """The feature is the torso's uprightness, at reset and in every step."""
    env, where = envs[name], task(name).features["upright"]
    obs, _ = env.reset(seed=0)
    assert obs[where].item() == pytest.approx(float(env.sim.physics.torso_upright()), abs=1e-6)
    for act in np.random.default_rng(0).uniform(-1, 1, (30, *env.action_space.shape)).astype(np.float32):
        obs = env.step(act)[0]
        assert obs[where].item() == pytest.approx(float(env.sim.physics.torso_upright()), abs=1e-6)


@every_task
def test_actions_reach_the_bounds_of_the_suite(name, envs):
    """-1 and 1 are the actuators' lowest and highest, 0 is half-way between."""
    env = envs[name]
    env.reset(seed=0)
    bounds = env.sim.action_spec()
    for act, expected in ((-1, bounds.minimum), (1, bounds.maximum), (0, (bounds.minimum + bounds.maximum) / 2)):
        env.step(np.full(env.action_space.shape, act, np.float32))
        np.testing.assert_allclose(env.sim.physics.data.ctrl, expected, atol=1e-12)


def test_quadruped_reward(envs):
    """The true reward is the suite's: uprightness times speed ahead, both from the observation after the step."""
    env = envs["quadruped-walk"]
    env.reset(seed=1)
    for obs, reward, *_ in steps(env):
        assert reward == pytest.approx((1 + obs[47]) / 2 * np.clip(obs[44] + 0.5, 0, 1), abs=1e-6)


def test_walker_reward(envs):
    """The true reward is the suite's, read from its physics after the step."""
    env = envs["walker-walk"]
    env.reset(seed=1)
    for act in np.random.default_rng(0).uniform(-1, 1, (30, 6)).astype(np.float32):
        _, reward, _, _, info = env.step(act)
        assert reward == env.sim.task.get_reward(env.sim.physics)
        assert info == {}


def test_instances(envs):
    """Every reset draws another posture."""
    walker = envs["walker-walk"]
    walker.reset(seed=0)
    assert len({tuple(walker.reset()[0].tolist()) for _ in range(10)}) == 10


def test_divergence():
    """A simulation that blows up is an error, not an episode that goes on from another state."""
    env = make("walker-walk")
    env.reset(seed=0)
    env.sim.physics.data.qvel[0] = np.nan
    with pytest.raises(NumericalError, match="diverged at step 0 "):
        env.step(np.zeros(6, np.float32))
    env.close()


def test_tasks_the_suite_lacks():
    """The message names domain and task."""
    from rrm.envs.dmc import DmcEnv

    with pytest.raises(ConfigError, match="'moonwalk' in domain 'walker'"):
        DmcEnv("walker", "moonwalk")
    with pytest.raises(ConfigError, match="1000"):
        DmcEnv("walker", "walk", horizon=1001)
