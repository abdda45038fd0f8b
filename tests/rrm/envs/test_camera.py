"""What cameras owe: pictures as they are asked for, upright, and a simulation that does not notice."""

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from rrm.config import CameraConfig
from rrm.envs import TASKS, make, task
from rrm.envs.observer import Observer
from rrm.errors import ConfigError, PriorError
from rrm.priors.step import Scene
from tests.rrm.envs.rollouts import HORIZON, actions, roll

NAMES = [
    pytest.param(t.name, marks=pytest.mark.sim if t.needs_opengl else ())
    for t in TASKS.values() if t.spaces.frames is not None
]  # fmt: skip
every_task = pytest.mark.parametrize("name", NAMES)
METAWORLD = [t.name for t in TASKS.values() if t.suite == "metaworld-image"]


@pytest.fixture
def envs(name, request):
    """Two environments of the task."""
    if task(name).needs_opengl:
        request.getfixturevalue("opengl")
    both = make(name, horizon=HORIZON), make(name, horizon=HORIZON)
    yield both
    for env in both:
        env.close()


@pytest.mark.slow
@every_task
def test_pictures(name, envs):
    """Every view, size and quality the task has; two environments in one state see the same, bit for bit."""
    space = task(name).spaces.frames
    assert space.view in task(name).views
    for env in envs:
        env.reset(seed=2)
    seen = []
    for view in task(name).views:
        one, other = (env.frame(replace(space, view=view)) for env in envs)
        assert (one.shape, one.dtype) == ((space.height, space.width, 3), np.uint8)
        assert one.std() > 5
        np.testing.assert_array_equal(one, other)
        seen.append(one)
    assert len({picture.tobytes() for picture in seen}) == len(seen)
    large = envs[0].frame(replace(space, height=60, width=100, quality="full"))
    assert large.shape == (60, 100, 3)
    np.testing.assert_array_equal(envs[0].frame(space), envs[1].frame(space))


@every_task
def test_looking_changes_nothing(name, envs):
    """An episode that is filmed at every step is the one that nobody sees, and each of its pictures is another."""
    space, acts, told, pictures = task(name).spaces.frames, actions(name, HORIZON, seed=1), [], set()
    starts = [env.reset(seed=3)[0].tolist() for env in envs]
    assert starts[0] == starts[1]
    for act in acts:
        pictures.add(envs[0].frame(space).tobytes())
        told += roll(envs[0], act[None])
    assert told == roll(envs[1], acts)
    assert len(pictures) > HORIZON - 5


@every_task
def test_pictures_after_a_resumption(name, envs):
    """A state from anywhere in an episode is seen as it was, and so is what follows."""
    (env, fresh), space = envs, task(name).spaces.frames
    for taken in (0, 1, 17):
        env.reset(seed=5)
        for act in actions(name, taken, seed=1):
            env.step(act)
        fresh.load_state_dict(env.state_dict())
        for act in actions(name, 3, seed=2):
            np.testing.assert_array_equal(env.frame(space), fresh.frame(space))
            assert roll(env, act[None]) == roll(fresh, act[None])


@every_task
def test_what_an_agent_sees(name, envs):
    """The newest pictures, planar, through the observer; the episode's first stands for those before it."""
    observer = Observer(name, HORIZON, task(name).spaces.frames)
    seen = observer.reset(seed=0)
    assert seen.frames.shape == (3, 3, *seen.frames.shape[2:])
    assert (seen.frames == seen.frames[0]).all()
    later = observer.step(actions(name, 1, seed=0)[0])[0]
    np.testing.assert_array_equal(later.frames[:2], seen.frames[1:])
    observer.close()


def test_size():
    """No more than any OpenGL has room for; as much as that is drawn."""
    with pytest.raises(ValidationError, match=r"size\n.*less than or equal to 1024"):
        CameraConfig(size=1025)
    space = replace(task("toy-car-image").spaces.frames, height=1024, width=1024)
    assert make("toy-car-image").frame(space).shape == (1024, 1024, 3)


@pytest.mark.sim
def test_pictures_are_upright(opengl):
    """Those of cameras that hang head first are turned; in the tasks' own view the table lies below the grey room."""
    env, own = make("sweep-into-image"), task("sweep-into-image").spaces.frames
    env.reset(seed=0)
    turned = []
    for view in task("sweep-into-image").views:
        space = replace(own, view=view)
        up = env.sim.data.camera(view).xmat.reshape(3, 3)[2, 1]  # how far the camera's up is the world's
        picture, mounted = env.frame(space), env._camera.picture(env.sim.data, space)
        np.testing.assert_array_equal(picture, mounted[::-1, ::-1] if up < -0.1 else mounted)
        turned += [view] * bool(up < -0.1)
    assert turned == ["corner", "corner2", "corner3", "corner4"]
    picture = env.frame(own).astype(int)
    wood = ((picture[..., 0] > picture[..., 2] + 25) & (picture[..., 0] < 190)).mean(1)  # brown, not the red robot
    assert wood[40:].mean() > 0.5 > 0.25 > wood[:20].mean()
    env.close()


@pytest.mark.slow
@pytest.mark.sim
def test_quality(opengl):
    """The quality "full" has shadows and smooth edges, and the order in which qualities are asked for plays no part."""
    space, env = task("button-press-image").spaces.frames, make("button-press-image")
    env.reset(seed=0)
    fast = env.frame(space)
    full = env.frame(replace(space, quality="full"))
    assert np.abs(full.astype(int) - fast).mean() > 1
    env.close()  # another look opens OpenGL anew
    np.testing.assert_array_equal(env.frame(replace(space, quality="full")), full)
    np.testing.assert_array_equal(env.frame(space), fast)
    env.close()


@pytest.mark.sim
@pytest.mark.parametrize("name", METAWORLD)
def test_what_the_robot_knows(name):
    """Hand and gripper now, the object where it was and the goal; the rest is for an expert, also when resumed."""
    env, plain, other = make(name), make(task(name).expert), make(name)
    obs, full = env.reset(seed=1)[0], plain.reset(seed=1)[0]
    start = full[4:7]
    for act in [None, *np.random.default_rng(0).uniform(-1, 1, (60, 4)).astype(np.float32)]:
        if act is not None:
            (obs, *heard), (full, *expected) = env.step(act), plain.step(act)
            assert heard == expected
        np.testing.assert_array_equal(obs, np.concatenate((full[:4], start, full[36:])))
        np.testing.assert_array_equal(env.full_obs, full)
    other.load_state_dict(env.state_dict())
    np.testing.assert_array_equal(other.full_obs, env.full_obs)
    act = np.ones(4, np.float32)
    np.testing.assert_array_equal(other.step(act)[0], env.step(act)[0])
    scene = Scene(task(name), obs)
    np.testing.assert_array_equal(scene.object_start, start)
    np.testing.assert_array_equal(scene.hand, full[:3])
    np.testing.assert_array_equal(scene.goal, full[36:])
    with pytest.raises(PriorError, match='does not reveal "object"'):
        scene.object  # noqa: B018
    for each in (env, plain, other):
        each.close()


@pytest.mark.sim
@pytest.mark.parametrize("name", METAWORLD)
def test_a_policy_of_the_task_without_a_camera_does_it(name):
    """The expert of `Task.expert` acts by `full_obs`, and succeeds."""
    from rrm.envs.metaworld import scripted_policy

    env, policy = make(name), scripted_policy(task(name).expert)
    env.reset(seed=3)
    assert any(env.step(policy(env.full_obs))[4]["success"] for _ in range(150))
    env.close()
    with pytest.raises(ConfigError, match=f"{name} has no scripted policy"):
        scripted_policy(name)


def test_the_car_from_above():
    """Goal and car in their colours at their places, half a pixel right and left of a pixel's middle told apart."""
    env, space = make("toy-car-image"), task("toy-car-image").spaces.frames
    env.reset(seed=0)
    env.position = (1.0, 1.5)
    large = env.frame(replace(space, height=100, width=100))
    assert large[50, 50].tolist() == [120, 200, 120]
    assert large[20, 70].tolist() == [60, 90, 200]
    assert large[2, 2].tolist() == [245, 245, 245]
    near = set()
    for x in np.linspace(1.0, 1.1, 8):  # two thirds of a pixel
        env.position = (float(x), 1.5)
        near.add(env.frame(space).tobytes())
    assert len(near) == 8


def test_the_car_is_far_from_its_goal_and_finds_it_on_sight():
    """Episodes begin all around the goal; a drive straight at it succeeds, random actions hardly ever do."""
    env, rng, lucky = make("toy-car-image"), np.random.default_rng(0), 0
    starts = []
    for seed in range(40):
        obs, _ = env.reset(seed=seed)
        assert obs in env.observation_space
        starts.append(obs[:2])
        assert 1.75 <= np.linalg.norm(obs[:2]) <= 2.25
        assert any(env.step(np.clip(-2 * np.array(env.position), -1, 1))[4]["success"] for _ in range(40))
        env.reset(seed=seed)
        lucky += any(env.step(rng.uniform(-1, 1, 2))[4]["success"] for _ in range(100))
    assert {tuple(np.sign(start)) for start in starts} == {(1, 1), (1, -1), (-1, 1), (-1, -1)}
    assert lucky < 12
