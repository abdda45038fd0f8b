"""The simulated arm: what the paper says of its tasks, contact, loss of the cube, and randomisation."""

import math
import subprocess
import sys

import numpy as np
import pytest

from rrm.envs import TASKS, make, task
from rrm.envs.panda.physics import Limits, Physics, lying, varied
from rrm.envs.panda.rules import NEAR, RULES
from rrm.errors import ConfigError
from tests.robot import robot, scripted
from tests.rrm.envs.rollouts import actions, roll

NAMES = [t.name for t in TASKS.values() if t.suite == "panda"]
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


def play(env, policy, obs, steps):
    """Everything heard in these steps, and the last observation."""
    heard = []
    for _ in range(steps):
        obs, *rest = env.step(policy(obs))
        heard.append((obs.tolist(), *rest))
    return heard, obs


def gaps(name, seen, goal=None):
    """Metres from hand to object and from object to goal, in what is observed."""
    features = task(name).features
    hand, thing, goal = (seen[features[part]] for part in ("hand", "object", "goal"))
    return math.dist(hand, thing), math.dist(thing, goal)


@pytest.mark.parametrize(
    ("hand", "cube", "goal", "reach", "other"),
    [
        ((0.5, 0.0, 0.1), (0.5, 0.0, 0.0), (0.5, 0.0, 0.0), -0.1, 3 + 1 - math.tanh(1)),
        ((0.5, 0.0, 0.0), (0.5, 0.0, 0.0), (0.5, 0.2, 0.0), 0.0, 3 * (1 - math.tanh(2)) + 1),
    ],
)
def test_true_rewards(hand, cube, goal, reach, other):
    """The paper's, of section "Real robot"; to push is in the plane of the table."""
    assert RULES["reach"].reward(hand, cube, goal) == pytest.approx(reach)
    assert RULES["pick-and-reach"].reward(hand, cube, goal) == pytest.approx(other)
    flat = RULES["push"].reward((*hand[:2], 7.0), cube, goal)
    assert flat == pytest.approx(RULES["push"].reward((*hand[:2], cube[2]), cube, goal))


@every_task
def test_instances(name):
    """Cube and goal lie where the hand can get, clear of each other; the first state is no success."""
    rules, rng, physics = RULES[task(name).kwargs["task"]], np.random.default_rng(0), Physics()
    limits = rules.limits(physics)
    for _ in range(500):
        cube, goal = rules.draw(rng, physics)
        for low, x, high in zip(limits.low[:2], cube.position[:2], limits.high[:2], strict=True):
            assert low + 0.08 < x < high - 0.08
        assert cube.position[2] == physics.cube_size / 2
        assert rules.left(rules.start, cube.position, goal) > 2 * NEAR - 1e-9
        assert math.dist(rules.start[:2], cube.position[:2]) > 0.06 or rules.start[2] > 0.1


@robot
@every_task
def test_what_is_seen(name, env):
    """Features are the simulator's positions; reward and success follow from them."""
    obs, _ = env.reset(seed=1)
    for act in actions(name, 30, seed=0):
        obs, reward, _, _, info = env.step(act)
        rules, hand, cube = env.rules, env.scene.hand, env.scene.cube
        np.testing.assert_allclose(obs[task(name).features["hand"]], hand[: rules.dims], atol=1e-6)
        np.testing.assert_allclose(obs[task(name).features["object"]], cube.position[: rules.dims], atol=1e-6)
        to_cube, to_goal = gaps(name, obs.astype(float))
        expected = -to_cube if not rules.moves else 3 * (1 - math.tanh(10 * to_goal)) + 1 - math.tanh(10 * to_cube)
        assert reward == pytest.approx(expected, abs=1e-5)
        assert info["success"] == ((to_goal if rules.moves else to_cube) < NEAR)
    if rules.moves:
        assert obs[2 * rules.dims] == pytest.approx(cube.yaw, abs=1e-6)


@robot
@every_task
def test_velocity(name, env):
    """An action of 1 is 0.2 m/s along its axis; the hand stays upright and inside its limits."""
    env.reset(seed=0)
    start = np.array(env.scene.hand)
    act = np.zeros(env.rules.dims, np.float32)
    act[1] = -1
    for _ in range(10):
        env.step(act)
    moved = np.array(env.scene.hand) - start
    assert moved[1] == pytest.approx(-0.1, abs=0.01)
    np.testing.assert_allclose(moved[[0, 2]], 0, atol=0.003)
    act[:] = 1
    for _ in range(60):
        env.step(act)
    limits = env.scene.limits
    assert (np.array(env.scene.hand) < np.array(limits.high) + 0.005).all()
    assert (np.array(env.scene.hand) > np.array(limits.low) - 0.005).all()


@pytest.mark.slow
@robot
@every_task
def test_scripted_policy(name, env):
    """The task can be done, in contact where it needs that, from all over the table; a state in contact, grasped or
    pushed, continues bit for bit in another environment.
    """
    policy, other, cut = scripted(name), make(name), np.random.default_rng(0)
    for seed in range(5):
        obs, _ = env.reset(seed=seed)
        heard, obs = play(env, policy, obs, int(cut.integers(20, 40)))
        other.load_state_dict(env.state_dict())
        rest, _ = play(env, policy, obs, env.horizon - len(heard))
        assert play(other, policy, obs, len(rest))[0] == rest
        assert rest[-1][-1]["success"] == 1.0
        assert env.reset()[0].tolist() == other.reset()[0].tolist()
    other.close()


@robot
@every_task
def test_history(name, env):
    """An episode depends on its seed alone, not on what the hand touched when the one before was cut off."""
    policy = scripted(name)
    first = play(env, policy, env.reset(seed=3)[0], 60)[0]
    for cut in (17, 29, 41):
        play(env, policy, env.reset(seed=cut)[0], cut)
        assert play(env, policy, env.reset(seed=3)[0], 60)[0] == first


@robot
def test_reach_touches_nothing(envs):
    """The hand stays above the cube, whatever it is told: the cube lies where it lay."""
    env = envs["panda-reach"]
    for seed in range(5):
        obs, _ = env.reset(seed=seed)
        for act in actions("panda-reach", 100, seed):
            act[2] = -1
            now = env.step(act)[0]
        np.testing.assert_allclose(now[3:6], obs[3:6], atol=1e-4)


@robot
def test_fingers(envs):
    """They close on the cube by themselves and carry it; they open again when it is gone."""
    env = envs["panda-pick-and-reach"]
    obs, _ = env.reset(seed=0)
    assert env.scene.opening == pytest.approx(0.08, abs=1e-3)
    play(env, scripted("panda-pick-and-reach"), obs, 80)
    assert env.scene.cube.position[2] > 0.08
    assert 0.045 < env.scene.opening < 0.06
    env.scene.call("resetBasePositionAndOrientation", env.scene._bodies[1], (0.4, 0.1, 0.025), (0, 0, 0, 1))
    for _ in range(20):
        env.step(np.zeros(3, np.float32))
    assert env.scene.opening == pytest.approx(0.08, abs=1e-3)


@robot
@pytest.mark.parametrize("tipped", [(0, 0), (math.pi / 2, 0), (0, math.pi / 2), (0, -math.pi / 2)])
def test_yaw(envs, tipped):
    """The cube's turn around the vertical, in [-pi, pi], also where it lies on another side."""
    scene = envs["panda-push"].scene
    envs["panda-push"].reset(seed=0)
    for yaw in (-3.1, -1.0, 0.0, 0.4, 3.1):
        turn = scene.call("getQuaternionFromEuler", (0, 0, yaw))
        side = scene.call("getQuaternionFromEuler", (*tipped, 0))
        _, both = scene.call("multiplyTransforms", (0, 0, 0), turn, (0, 0, 0), side)
        scene.call("resetBasePositionAndOrientation", scene._bodies[1], (0.5, 0, 0.025), both)
        assert scene.cube.yaw == pytest.approx(yaw, abs=1e-6)


@robot
def test_a_lost_cube(envs):
    """It stays where it left, observed and out of reach, and the episode ends at its horizon without success."""
    env = envs["panda-push"]
    for position in ((0.9, 0.0, 0.3), (0.5, -0.5, 0.025), (0.5, 0.0, -0.2)):
        env.reset(seed=0)
        env.scene.call("resetBasePositionAndOrientation", env.scene._bodies[1], position, (0, 0, 0, 1))
        heard = [env.step(np.ones(2, np.float32)) for _ in range(100)]
        assert env.scene.lost
        limits, there = Limits(), env.scene.cube.position
        assert limits.low[0] - limits.margin <= there[0] <= limits.high[0] + limits.margin
        assert {tuple(obs[2:4].tolist()) for obs, *_ in heard[1:]} == {tuple(np.float32(there[:2]).tolist())}
        assert {info["success"] for *_, info in heard} == {0.0}
        assert heard[-1][3]
    env.goal = there
    env.reset(seed=0)
    assert not env.scene.lost


@robot
@every_task
def test_randomised(name):
    """Each reset draws from the ranges, by the environment's own stream; noise too continues bit for bit."""
    ranges = {"cube_size": (0.04, 0.06), "cube_mass": (0.3, 0.3), "latency": (1, 3), "noise": (0.001, 0.002)}
    env, other = make(name, horizon=30, ranges=ranges), make(name, horizon=30, ranges=ranges)
    drawn = [env.reset(seed=0 if first else None) and env.scene.physics for first in (True, False, False)]
    assert len({physics.cube_size for physics in drawn}) == 3
    assert {physics.cube_mass for physics in drawn} == {0.3}
    assert all(1 <= physics.latency <= 3 for physics in drawn)
    size = env.scene.physics.cube_size
    low, high = env.scene.call("getAABB", env.scene._bodies[1])
    assert high[2] - low[2] == pytest.approx(size, abs=0.005)
    assert env.scene.call("getDynamicsInfo", env.scene._bodies[1], -1)[0] == 0.3

    still = [env.step(np.zeros(env.rules.dims, np.float32))[0] for _ in range(3)]
    where = task(name).features["object"]
    assert np.ptp([obs[where] for obs in still], axis=0).max() > 1e-5
    assert all(obs in env.observation_space for obs in still)
    other.load_state_dict(env.state_dict())
    acts = actions(name, 40, seed=2)
    assert roll(env, acts) == roll(other, acts)
    env.close()
    other.close()


@robot
def test_latency(envs):
    """A command takes effect so many steps later."""
    env = make("panda-reach", ranges={"latency": (3, 3)})
    env.reset(seed=0)
    begin = env.scene.hand
    ahead = [env.step(np.array((0, 1, 0), np.float32)) and env.scene.hand[1] - begin[1] for _ in range(5)]
    env.close()
    assert max(ahead[:3]) < 1e-3
    assert ahead[3] > 5e-3


def test_a_range_of_one_value_takes_no_draw():
    """What is fixed leaves the stream, and with it the instances, as they are."""
    rng = np.random.default_rng(0)
    assert varied({"friction": (0.9, 0.9), "latency": (2, 2)}, rng) == Physics(friction=0.9, latency=2)
    assert rng.random() == np.random.default_rng(0).random()


@robot
def test_pictures_change_nothing():
    """480 x 360 in colour; the episode goes on as if nobody had looked."""
    from rrm.envs.panda.env import PandaEnv

    env = PandaEnv("push", render_mode="rgb_array")
    policy = scripted("panda-push")
    unseen = play(env, policy, env.reset(seed=0)[0], 40)[0]
    obs, seen, shown = env.reset(seed=0)[0], [], []
    for number in range(40):
        if number % 10 == 0:
            shown.append(env.render())
        heard, obs = play(env, policy, obs, 1)
        seen += heard
    env.close()
    assert seen == unseen
    assert all(picture.shape == (360, 480, 3) and picture.dtype == np.uint8 for picture in shown)
    assert np.abs(shown[0].astype(int) - shown[-1]).max() > 100
    red, green, blue = (shown[0][..., channel].astype(int) for channel in range(3))
    assert ((red > 1.8 * green) & (red > 1.8 * blue)).sum() > 50  # the cube
    assert ((green > 1.5 * red) & (green > 1.5 * blue)).sum() > 50  # the goal


def test_physics_that_lies():
    """A cube lies on the table at half its height."""
    assert lying(0.5, 0.1, 0.2, Physics(cube_size=0.04)).position == (0.5, 0.1, 0.02)


def test_without_pybullet(tmp_path):
    """One line with the command that mends it; planning does without."""
    hidden = "import sys; from importlib import metadata as m; real = m.version\n"
    hidden += "def version(name):\n if name == 'pybullet': raise m.PackageNotFoundError(name)\n return real(name)\n"
    hidden += "m.version = version; from rrm.envs import make; make('panda-push')"
    done = subprocess.run([sys.executable, "-c", hidden], capture_output=True, text=True, check=False)
    last = done.stderr.strip().splitlines()[-1]
    assert "panda-push needs pybullet, which is not installed" in last
    assert last.endswith("pip install 'rrmctl[robot]'")


def test_a_python_without_a_wheel():
    """The message says so."""
    from rrm.envs.tasks import wheels

    assert wheels("pybullet", (3, 11)) == wheels("mujoco", (3, 12)) == ""
    assert "no wheel for Python 3.12" in wheels("pybullet", (3, 12))


def test_what_cannot_vary():
    """A task that is always the same, and a quantity that none has: both are named."""
    with pytest.raises(ConfigError, match=r"env\.friction: toy-car has none that could vary; these have: panda-reach"):
        make("toy-car", ranges={"friction": (1.0, 1.0)})
    with pytest.raises(ConfigError, match=r"env\.colour: panda-push .*these have: none"):
        make("panda-push", ranges={"colour": (1.0, 1.0)})


@robot
@pytest.mark.slow
@pytest.mark.long
@every_task
def test_a_thousand_random_episodes(name):
    """Finite throughout and inside the observation's bounds, with everything varying."""
    ranges = {"cube_size": (0.03, 0.06), "cube_mass": (0.01, 1.0), "friction": (0.1, 1.5), "latency": (0, 3)}
    env, rng = make(name, ranges=ranges), np.random.default_rng(0)
    lost = 0
    for number in range(1000):
        env.reset(seed=number)
        for number_of_step in range(env.horizon):
            if number_of_step % 10 == 0:  # longer strokes get further
                act = rng.uniform(-1.5, 1.5, env.rules.dims).astype(np.float32)
            obs, reward, *_ = env.step(act)
            assert obs in env.observation_space
            assert math.isfinite(reward)
        lost += env.scene.lost
    env.close()
    assert lost < 100
