"""Pictures for people: every task has them, they show what was done, and looking changes nothing."""

import numpy as np
import pytest

from rrm.envs import make
from rrm.errors import ConfigError
from tests.rrm.envs.rollouts import actions, roll
from tests.rrm.envs.tasks import every_task


@every_task
def test_a_task_is_drawn_for_people(name, opengl):
    """One size throughout, another picture after some steps, the same one for the same state in another environment."""
    env, twin = (make(name, horizon=30, render_mode="rgb_array") for _ in range(2))
    assert env.metadata["render_fps"] > 0
    env.reset(seed=0)
    before = env.render()
    assert before.dtype == np.uint8
    assert before.shape[2] == 3
    for act in actions(name, 20, seed=0):
        env.step(act)
    after = env.render()
    assert before.shape == after.shape
    assert (before != after).any()
    assert after.std() > 10  # something is to be seen
    twin.load_state_dict(env.state_dict())
    assert np.array_equal(twin.render(), after)
    for made in (env, twin):
        made.close()


@every_task
def test_looking_changes_nothing(name, opengl):
    """An episode under the eyes of a person is the same episode."""
    seen, unseen = make(name, horizon=30, render_mode="rgb_array"), make(name, horizon=30)
    acts = actions(name, 20, seed=0)
    for env in (seen, unseen):
        env.reset(seed=0)
    for act in acts[:10]:
        seen.render()
        one, other = seen.step(act), unseen.step(act)
        assert np.array_equal(one[0], other[0])
    assert roll(seen, acts) == roll(unseen, acts)
    assert unseen.render() is None
    for env in (seen, unseen):
        env.close()


def test_there_is_one_way_to_draw():
    """Another is refused by its name."""
    with pytest.raises(ConfigError, match='render_mode "human" is not one of ToyCarEnv; it has: rgb_array'):
        make("toy-car", render_mode="human")
