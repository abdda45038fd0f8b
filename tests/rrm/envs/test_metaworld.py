"""Meta-World as the paper uses it: instances, features and success against the library's own numbers and policies."""

import warnings

import numpy as np
import pytest

from rrm.envs import TASKS, make, task
from rrm.errors import ConfigError, NumericalError, UnknownNameError
from rrm.priors import load_prior
from rrm.priors.step import PriorStep, Scene

pytestmark = pytest.mark.sim

NAMES = [t.name for t in TASKS.values() if t.suite == "metaworld"]
every_task = pytest.mark.parametrize("name", NAMES)


@pytest.fixture(scope="module")
def envs():
    made = {name: make(name) for name in NAMES}
    yield made
    for env in made.values():
        env.close()


@pytest.fixture
def env(name, envs):
    return envs[name]


def scripted(name):
    """The library's hand-written policy, as a function of the observation."""
    from metaworld.policies import ENV_POLICY_MAP

    policy = ENV_POLICY_MAP[f"{name}-v3"]()

    def act(obs):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # it says itself that its actions may be large
            return np.clip(policy.get_action(obs.astype(np.float64)), -1, 1).astype(np.float32)

    return act


def assert_features_hold(name, env, obs):
    features = task(name).features
    np.testing.assert_allclose(obs[features["hand"]], env.sim.get_endeff_pos(), atol=1e-6)
    np.testing.assert_allclose(obs[features["object"]], env.sim._get_pos_objects(), atol=1e-6)
    np.testing.assert_allclose(obs[features["goal"]], env.sim._target_pos, atol=1e-6)


@every_task
def test_features(name, env):
    """Hand, object and goal are the simulator's, at reset and in every step; the goal is not hidden."""
    obs, _ = env.reset(seed=1)
    assert_features_hold(name, env, obs)
    for act in np.random.default_rng(0).uniform(-1, 1, (30, 4)).astype(np.float32):
        obs = env.step(act)[0]
        assert_features_hold(name, env, obs)
    assert np.linalg.norm(obs[36:39]) > 0.5


@every_task
def test_instances(name, env):
    """Every reset draws another instance, inside the library's range, without touching numpy's global generator."""
    before = np.random.get_state()[1].tolist()
    objects = [env.reset(seed=2 if number == 0 else None)[0][4:7] for number in range(12)]
    assert np.random.get_state()[1].tolist() == before
    assert len({tuple(position.tolist()) for position in objects}) == 12
    spread = np.ptp(objects, axis=0)[:2].max()
    space = env.sim._random_reset_space
    assert 0.3 * (space.high - space.low).max() < spread <= (space.high - space.low).max() + 1e-6


def test_sweep_into_starts_clear_of_the_hole(envs):
    """No draw has the puck within 0.15 m of the hole, where the library's reset would never return."""
    env = envs["sweep-into"]
    env.reset(seed=0)
    assert min(np.linalg.norm(env._draw()[:2] - [0.0, 0.84]) for _ in range(500)) >= 0.15


@every_task
def test_first_observation_belongs_to_the_instance(name, env):
    """The object of the first observation is where a step without motion leaves it."""
    first, _ = env.reset(seed=4)
    np.testing.assert_array_equal(first[0:18], first[18:36])
    later = env.step(np.array([0, 0, 0, -1], np.float32))[0]
    np.testing.assert_allclose(first[4:7], later[4:7], atol=2e-3)
    np.testing.assert_array_equal(first[36:39], later[36:39])


def test_window_open_margin_belongs_to_the_instance(envs):
    """The reward's reference for the handle is where the handle of this instance starts."""
    obs, _ = envs["window-open"].reset(seed=4)
    np.testing.assert_allclose(envs["window-open"].sim.window_handle_pos_init, obs[4:7], atol=1e-6)


@every_task
def test_scripted_policy(name, env):
    """The library's policy succeeds, which the proxy prior approves of; a state in contact resumes bit for bit."""
    policy, proxy, spec = scripted(name), load_prior("proxy"), task(name)
    obs, _ = env.reset(seed=3)
    first, values = Scene(spec, obs), []
    for _ in range(200):
        act = policy(obs)
        values.append((obs, act))
        obs, reward, _, _, info = env.step(act)
        assert 0 <= reward <= 10
        if info["success"]:
            break
    assert info["success"] == 1.0
    rng = np.random.default_rng(0)
    start, end = (proxy(PriorStep(spec, o, a, info, rng, first)) for o, a in (values[0], values[-1]))
    assert end > start + 0.1

    other = make(name)
    other.load_state_dict(env.state_dict())
    same = obs
    for _ in range(40):
        obs, *heard = env.step(policy(obs))
        same, *again = other.step(policy(same))
        assert (obs.tolist(), heard) == (same.tolist(), again)
    other.close()


@every_task
def test_random_policy(name, env):
    """Random actions do not succeed."""
    env.reset(seed=0)
    acts = np.random.default_rng(0).uniform(-1, 1, (200, 4)).astype(np.float32)
    assert sum(env.step(act)[4]["success"] for act in acts) == 0


def test_divergence(envs, tmp_path, monkeypatch):
    """A simulation that blows up is an error, not an episode that goes on from a restarted arm."""
    monkeypatch.chdir(tmp_path)  # MuJoCo writes MUJOCO_LOG.TXT where it stands
    env = envs["button-press"]
    env.reset(seed=0)
    env.sim.data.qvel[0] = np.nan
    with pytest.raises(NumericalError, match="diverged at step 0 "):
        env.step(np.zeros(4, np.float32))


def test_unknown_names():
    """The class names Meta-World's own tasks and its longest episode."""
    from rrm.envs.metaworld import MetaWorldEnv

    with pytest.raises(UnknownNameError, match='did you mean "button-press-v3"'):
        MetaWorldEnv("button-pres-v3")
    with pytest.raises(ConfigError, match="500"):
        MetaWorldEnv("button-press-v3", horizon=501)
