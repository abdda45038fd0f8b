"""Clips are drawn from episodes that are lived again."""

import pytest

from rrm.config import TeacherConfig
from rrm.envs import make
from rrm.errors import LabelError, WaitingError
from rrm.teachers.published import published_steps, read_episodes, read_session, session_path
from rrm.training.jobs import train
from rrmctl.labelling.renderer import frames
from tests.robot import robot
from tests.rrm.training.conftest import Recorder, tiny  # noqa: F401 (fixtures)

HUMAN = TeacherConfig(kind="human", study="test")


@pytest.mark.slow
@robot
def test_clips_of_what_varies_can_be_lived_again(tiny, tmp_path):  # noqa: F811
    """Whoever shows them makes the environment that draws as the run's did."""
    ranges = {"cube_mass": (0.05, 0.4), "friction": (0.3, 0.9)}
    config, folder = tiny(task="panda-push", teacher=HUMAN, env=ranges), tmp_path
    with pytest.raises(WaitingError):
        train(config, folder, Recorder())
    (step,) = published_steps(folder)
    path = session_path(folder, step)
    session, episodes = read_session(path), read_episodes(path)
    assert session.ranges == ranges
    env = make(session.task, session.horizon, session.ranges, render_mode="rgb_array")
    shown = session.queries[0].first
    assert len(list(frames(env, session, episodes[shown.episode], shown.begin))) == session.length + 1
    plain = make(session.task, session.horizon, render_mode="rgb_array")
    with pytest.raises(LabelError, match="lived again, the episode differs"):
        _ = [list(frames(plain, session, episodes[q.first.episode], q.first.begin)) for q in session.queries]
