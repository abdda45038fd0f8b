"""The toy car: its equations by hand, its layouts, and that it is hard by chance and easy by sense."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rrm.envs import make, task
from rrm.envs.toy_car import ARENA, Layout, ToyCarEnv, clearance, draw, drive, observe, true_reward

LAYOUT = Layout((2.0, 0.0), ((0.0, 0.0), (0.0, 1.0), (0.0, -1.0)))


def test_free_driving():
    """The velocity is half the old one and the pull; the position follows it for 0.1 s."""
    position, velocity = drive(LAYOUT, (-2.0, 2.0), (1.0, 0.0), (1.0, -0.5))
    assert velocity == pytest.approx((1.5, -0.5))
    assert position == pytest.approx((-1.85, 1.95))


def test_hitting_an_obstacle_head_on():
    """The car stops at the edge, 0.3 m from the centre."""
    position, velocity = drive(LAYOUT, (-0.3, 0.0), (1.0, 0.0), (1.0, 0.0))
    assert position == pytest.approx((-0.3, 0.0))
    assert velocity == pytest.approx((0.0, 0.0))


def test_the_edge_of_the_arena():
    """The car stays inside and keeps its speed along the edge."""
    position, velocity = drive(LAYOUT, (2.45, 1.0), (1.0, 1.0), (1.0, 0.0))
    assert position == pytest.approx((2.5, 1.05))
    assert velocity == pytest.approx((0.5, 0.5))


def test_observation():
    """Car, goal, clearance, velocity, way to the goal, ways to the obstacles from near to far."""
    expected = [-0.6, 0.1, 2, 0, math.hypot(0.6, 0.1) - 0.3, 0.5, 0.25, 2.6, -0.1, 0.6, -0.1, 0.6, 0.9, 0.6, -1.1]
    assert observe(LAYOUT, (-0.6, 0.1), (0.5, 0.25)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("distance", "free", "speed", "expected"),
    [
        (2.0, 1.0, 2.0, -0.4),
        (6.0, 1.0, 2.0, -1.0),
        (0.49, 1.0, 0.0, 1.0),
        (0.5, 1.0, 0.0, -0.1),
        (2.0, 0.2, 0.0, -0.4),
        (2.0, 0.2, 2.0, -0.525),
        (2.0, 0.2, 1.0, -0.43125),
        (2.0, 0.0, 0.0, -0.65),
        (2.0, 0.0, 2.0, -0.9),
    ],
)
def test_true_reward(distance, free, speed, expected):
    """Closer is better, inside the goal is 1; obstacles cost, and speed near them costs."""
    assert true_reward(distance, free, speed) == pytest.approx(expected)


@given(st.integers(0, 2**32))
def test_layouts(seed):
    """Start and goal are far apart and clear of every obstacle, and no two obstacles are within 0.15 m."""
    layout, start = draw(np.random.default_rng(seed))
    assert 3.4 < math.dist(start, layout.goal) <= 4.0
    assert clearance(start, layout.obstacles) > 0.9
    assert clearance(layout.goal, layout.obstacles) > 0.9
    first, second, third = layout.obstacles
    assert min(math.dist(first, second), math.dist(first, third), math.dist(second, third)) >= 0.75


@given(st.integers(0, 1000), st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=60))
def test_inside_the_space(seed, acts):
    """No drive leaves the observation space, the arena, or enters an obstacle by more than rounding."""
    env = ToyCarEnv()
    obs, _ = env.reset(seed=seed)
    for number, act in enumerate(acts):
        pull = act if number % 2 else np.sign(obs[9:11])  # every other step at the nearest obstacle, with full force
        obs, reward, *_ = env.step(np.array(pull, np.float32))
        assert obs in env.observation_space
        assert np.abs(obs[:2]).max() <= ARENA
        assert -1.75 <= reward <= 1.0
        assert min(math.dist(env.position, centre) for centre in env.layout.obstacles) > 0.3 - 1e-9


def test_features():
    """Hand and object are the car; goal and clearance are the layout's."""
    env, where = make("toy-car"), task("toy-car").features
    obs, _ = env.reset(seed=0)
    np.testing.assert_allclose(obs[where["hand"]], env.position, rtol=1e-6)
    np.testing.assert_allclose(obs[where["object"]], env.position, rtol=1e-6)
    np.testing.assert_allclose(obs[where["goal"]], env.layout.goal, rtol=1e-6)
    np.testing.assert_allclose(obs[where["clearance"]], [clearance(env.position, env.layout.obstacles)], rtol=1e-6)


def drive_to_goal(obs, rng):
    """Straight at the goal, slower close to it."""
    return np.clip(2 * obs[7:9], -1, 1)


def at_random(obs, rng):
    return rng.uniform(-1, 1, 2)


@pytest.mark.parametrize(("policy", "succeeding"), [(drive_to_goal, 50), (at_random, 0)])
def test_hard_by_chance(policy, succeeding):
    """A policy that knows where to go always arrives, random actions never do."""
    env, rng, count = make("toy-car"), np.random.default_rng(0), 0
    for seed in range(50):
        obs, _ = env.reset(seed=seed)
        flags = []
        for _ in range(100):
            obs, _, _, _, info = env.step(policy(obs, rng))
            flags.append(info["success"])
        count += max(flags) == 1.0
    assert count == succeeding


def test_frames():
    """A frame shows the arena from above: the goal in green at its place, grey obstacles; none without the mode."""
    env = ToyCarEnv(render_mode="rgb_array")
    env.reset(seed=0)
    frame = env.render()
    assert frame.shape == (320, 320, 3)
    assert frame.dtype == np.uint8

    def colour(point):
        return frame[round((ARENA - point[1]) * 64), round((point[0] + ARENA) * 64)].tolist()

    assert colour(env.layout.goal) == [170, 220, 170]
    assert colour(env.layout.obstacles[0]) == [90, 90, 90]
    assert ToyCarEnv().render() is None
