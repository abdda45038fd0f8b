"""What every environment of the table owes: gymnasium's contract, its description, and exact resuming."""

import json
import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import rrm.envs
from rrm.checkpoint import encode
from rrm.envs import TASKS, make, task
from rrm.errors import ConfigError, NumericalError, UnknownNameError
from tests.robot import robot
from tests.rrm.envs.rollouts import HORIZON, actions, digest, roll
from tests.rrm.envs.tasks import every_task


@pytest.fixture(scope="module")
def envs():
    """One environment per task for all tests of this file: what ran in it before must not matter after a reset."""
    made = {}
    yield made
    for env in made.values():
        env.close()


@pytest.fixture
def env(name, envs):
    if name not in envs:
        envs[name] = make(name, horizon=HORIZON)
    return envs[name]


@pytest.fixture
def fresh(name):
    """An environment that was never reset."""
    env = make(name, horizon=HORIZON)
    yield env
    env.close()


@every_task
def test_checker(name):
    """Gymnasium's checker finds nothing to object to or to warn of, under the registered id."""
    rrm.envs.register()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make(f"rrm/{name}-v0").unwrapped)


@every_task
def test_description(name):
    """Observation, action and time limit are what the table says."""
    spec = task(name)
    env = make(name)
    obs, _ = env.reset(seed=0)
    assert obs.shape == env.observation_space.shape == (spec.spaces.obs,)
    assert obs.dtype == np.float32
    assert env.action_space == gymnasium.spaces.Box(-1, 1, (spec.spaces.act,), np.float32)
    ends = []
    for act in actions(name, spec.horizon, seed=0):
        obs, reward, terminated, truncated, info = env.step(act)
        assert obs in env.observation_space
        assert isinstance(reward, float)
        assert ("success" in info) == (spec.score == "success")
        assert info.get("success", 0.0) in (0.0, 1.0)
        ends.append((terminated, truncated))
    assert ends == [(False, False)] * (spec.horizon - 1) + [(False, True)]
    env.close()


@every_task
def test_time_limit(name, env):
    """A shorter horizon truncates at its last step; a step beyond it is refused."""
    env.reset(seed=0)
    ends = [env.step(act)[2:4] for act in actions(name, HORIZON, seed=0)]
    assert ends == [(False, False)] * (HORIZON - 1) + [(False, True)]
    with pytest.raises(ResetNeeded, match="reset"):
        env.step(actions(name, 1, seed=0)[0])


@every_task
def test_seeds(name, env):
    """A seed fixes this episode and those after it; other seeds and later episodes are other instances."""
    acts = actions(name, 40, seed=0)
    first = (env.reset(seed=3)[0].tolist(), roll(env, acts))
    again = (env.reset(seed=3)[0].tolist(), roll(env, acts))
    assert first == again
    assert len({tuple(env.reset(seed=s)[0].tolist()) for s in (3, None, None, 4)}) == 4


@every_task
def test_action_not_finite(name, env):
    """An action that is not finite is refused, and the episode goes on as if it had not been tried."""
    env.reset(seed=0)
    act = actions(name, 1, seed=0)[0]
    for bad in (np.nan, np.inf, -np.inf):
        act[-1] = bad
        with pytest.raises(NumericalError, match=r"step 0 .*not finite"):
            env.step(act)
    tried = roll(env, actions(name, 3, seed=1))
    env.reset(seed=0)
    assert roll(env, actions(name, 3, seed=1)) == tried


@every_task
def test_action_of_another_shape(name, env):
    """The message gives both shapes."""
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"has shape \(\d+,\); this one has \(3, 1\)"):
        env.step(np.zeros((3, 1), np.float32))


@every_task
def test_action_beyond_the_bounds(name, env):
    """Counts as the nearest one inside."""
    far = 3 * actions(name, 20, seed=0)
    env.reset(seed=0)
    clipped = roll(env, np.clip(far, -1, 1))
    env.reset(seed=0)
    assert roll(env, far) == clipped


@every_task
def test_resume(name, env, fresh):
    """A state taken anywhere in an episode, or at its end, continues bit for bit in another environment."""
    for taken in (0, 1, 17, HORIZON):
        env.reset(seed=5)
        for act in actions(name, taken, seed=1):
            env.step(act)
        fresh.load_state_dict(env.state_dict())
        if taken == HORIZON:
            assert env.reset()[0].tolist() == fresh.reset()[0].tolist()
        acts = actions(name, HORIZON + 5, seed=2)  # on into the next episode; it leaves `fresh` elsewhere for the next
        assert roll(env, acts) == roll(fresh, acts)


@every_task
def test_saving_changes_nothing(name, env):
    """Taking a state in every step leaves the rollout as it is."""
    acts = actions(name, 20, seed=0)
    env.reset(seed=0)
    undisturbed = roll(env, acts)
    env.reset(seed=0)
    watched = []
    for act in acts:
        env.state_dict()
        watched += roll(env, act[None])
    assert watched == undisturbed


@every_task
def test_before_the_first_episode(name, env, fresh):
    """A step is refused; a state holds the random stream."""
    with pytest.raises(ResetNeeded, match="reset"):
        fresh.step(actions(name, 1, seed=0)[0])
    env.load_state_dict(fresh.state_dict())
    assert env.reset()[0].tolist() == fresh.reset()[0].tolist()


@pytest.mark.slow
@pytest.mark.parametrize(
    "suites",
    [
        pytest.param({"metaworld", "metaworld-image", "dmc", "toy", "toy-image"}, marks=pytest.mark.sim),
        pytest.param({"panda"}, marks=robot),
    ],
    ids=["mujoco", "panda"],
)
def test_resume_in_another_process(suites, tmp_path):
    """A state written to a file and read by another process continues bit for bit, for every task."""
    here = {}
    names = [spec.name for spec in TASKS.values() if spec.suite in suites]
    for name in names:
        env = make(name, horizon=HORIZON)
        env.reset(seed=7)
        roll(env, actions(name, 19, seed=1))
        (tmp_path / name).write_bytes(encode(env.state_dict()))
        here[name] = digest(roll(env, actions(name, HORIZON + 5, seed=2)))
        env.close()
    command = [sys.executable, "-m", "tests.rrm.envs.rollouts", str(tmp_path), *names]
    there = subprocess.run(command, check=True, capture_output=True, text=True, timeout=120).stdout
    assert json.loads(there) == here


def test_unknown_task():
    """The nearest name is suggested."""
    with pytest.raises(UnknownNameError, match='unknown task "toy-cat"; did you mean "toy-car"'):
        make("toy-cat")


@pytest.mark.parametrize("horizon", [0, -1, 101])
def test_horizon_out_of_range(horizon):
    """The message gives the range."""
    with pytest.raises(ConfigError, match="between 1 and 100"):
        make("toy-car", horizon=horizon)


def test_render_mode_nobody_has():
    """The message names those there are."""
    from rrm.envs.toy_car import ToyCarEnv

    with pytest.raises(ConfigError, match="rgb_array"):
        ToyCarEnv(render_mode="human")


def test_planning_imports_nothing_heavy():
    """Looking at tasks and checking priors loads neither torch nor gymnasium nor a simulator."""
    code = (
        "import sys; from rrm.envs import TASKS; from rrm.priors import check_prior\n"
        "from rrm.priors.language import FROZEN, language\n"
        "for t in TASKS.values():\n"
        "    check_prior('zero', t)\n"
        "for t in (TASKS[name] for name in language.tasks):\n"
        "    for prior in ('language', f'{FROZEN}/{t.name}.language.py:reward'): check_prior(prior, t)\n"
        "heavy = {'torch', 'numpy', 'gymnasium', 'metaworld', 'mujoco', 'dm_control', 'pybullet', 'cv2', 'scipy'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60)
    assert run.stdout.strip() == "[]"


def test_registered_where_gymnasium_is_loaded():
    """`import gymnasium, rrm.envs` is enough for `gymnasium.make`."""
    code = "import gymnasium, rrm.envs; print(gymnasium.make('rrm/toy-car-v0').reset(seed=0)[0].shape)"
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, timeout=60)
    assert run.stdout.strip() == "(15,)"
