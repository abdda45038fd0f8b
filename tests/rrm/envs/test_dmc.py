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
        assert set(info) == set(task("walker-walk").outcomes)


#: The walker's links: shares of the body's mass times the way to their centres, and how joint speeds add up along them.
AHEAD = np.array([-0.18781096352828952, -0.10886750568723871, -0.061055257943788105, 0] + [0] * 3)
AHEAD[4:6] = AHEAD[1:3]
ASIDE = np.array([0, 0, 0, 0.004403023409407842, 0, 0, 0.004403023409407842])
CHAIN = np.array([[1, *(-(k <= i) for k in range(3)), 0, 0, 0] for i in range(-1, 3)]
                 + [[1, 0, 0, 0, *(-(k <= i) for k in range(3))] for i in range(3)], float)  # fmt: skip


def test_walker_outcomes(envs):
    """Speed of the centre of mass, uprightness and height after the step; all three follow from the observation."""
    env = envs["walker-walk"]
    env.reset(seed=3)
    for obs, *_, info in steps(env):
        turning = CHAIN @ obs[17:24]
        speed = obs[16] + (turning * (AHEAD * obs[0:14:2] - ASIDE * obs[1:14:2])).sum()
        expected = {"forward_velocity": speed, "torso_upright": obs[0], "torso_height": obs[14]}
        assert info == pytest.approx(expected, abs=1e-5)


def test_quadruped_outcomes(envs):
    """Speed along the torso's own axis and uprightness after the step, as in the observation."""
    env = envs["quadruped-walk"]
    env.reset(seed=3)
    for obs, *_, info in steps(env):
        assert info == pytest.approx({"forward_velocity": obs[44], "torso_upright": obs[47]}, abs=1e-5)


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
