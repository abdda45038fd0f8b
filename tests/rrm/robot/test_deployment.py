"""Episodes of a policy at the rig: what it sees, what is recorded, and what goes wrong there."""

import dataclasses
import os
import signal

import numpy as np
import pytest

from benchmarks import rig as benchmark
from rrm.envs.panda.rules import RULES
from rrm.errors import CalibrationError, ConfigError, NumericalError, RobotError
from rrm.robot.config import RigConfig
from rrm.robot.deployment import deploy
from rrm.robot.rig import Rig
from rrm.robot.setup import calibration, cameras, marked_cube
from tests.robot import robot, scripted

pytestmark = robot
CONFIG = RigConfig(width=480, height=360, boards=8)
EYES = cameras(CONFIG)


class Places:
    """Makes rigs, and remembers them."""

    def __init__(self, change=lambda rig: rig):
        self.made = []
        self._change = change

    def __call__(self):
        self.made.append(Rig(CONFIG))
        return self._change(self.made[-1])


class Dark:
    """A rig whose cameras see nothing from some frame on, counted over all episodes."""

    def __init__(self, rig, begin, end=10**6):
        self._rig, self._dark, self._frames = rig, range(begin, end), 0

    def __getattr__(self, name):
        return getattr(self._rig, name)

    def images(self):
        pictures = self._rig.images()
        self._frames += 1
        dark = self._frames in self._dark
        return {name: np.zeros_like(picture) if dark else picture for name, picture in pictures.items()}


def reach(obs):
    """To just above the cube."""
    return np.clip((obs[3:6] - obs[:3] + np.array([0, 0, 0.042])) * 10, -1, 1)


def play(policy, places, task="panda-reach", episodes=1, horizon=30, patience=3, eyes=EYES, **more):
    more |= {"episodes": episodes, "horizon": horizon, "patience": patience, "seed": 0}
    return list(deploy(policy, task, places, eyes, marked_cube(CONFIG), **more))


def ended(places):
    return all(rig._process.poll() is not None for rig in places.made)


@pytest.mark.slow
def test_a_policy_reaches_the_cube_that_the_cameras_see():
    """By cameras calibrated from pictures: success by truth and by sight, and returns that agree."""
    places = Places()
    (episode,) = play(reach, places, eyes=calibration(CONFIG).cameras, horizon=35)
    assert (episode.success, episode.success_seen, episode.lost, episode.breakdowns) == (True, True, "", 0)
    assert episode.steps == episode.acted == 35
    assert episode.total == pytest.approx(episode.total_seen, abs=0.35)
    assert -8 < episode.total < -2
    assert 1 <= episode.views <= 2 <= episode.markers <= 6
    assert 0 < episode.error_px < 1.5
    assert ended(places)


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize("task", ["panda-push", "panda-pick-and-reach"])
def test_a_scripted_policy_succeeds_at_the_rig(task):
    """What moves the cube in the training's simulation moves it there, by what the cameras see; one of two will do."""
    episodes = play(scripted(task), Places(), task=task, episodes=2, horizon=100, patience=20)
    assert any(episode.success and episode.success_seen for episode in episodes)


@pytest.mark.slow
@pytest.mark.long
def test_the_benchmark_tells_what_the_rig_leaves_of_it():
    """Failures in percent, here and in the training's simulation, and seconds."""
    failures, cost = benchmark.lines(1, ("panda-reach",))
    assert (failures.ours, failures.peers, failures.unit) == (0.0, {"the training's simulation": 0.0}, "%")
    assert (cost.unit, cost.ours > 0) == ("s", True)


@pytest.mark.slow
def test_an_observation_is_what_cameras_and_arm_say():
    """In the task's order: nothing of it is the simulator's, so it is a little off, and a little only."""
    seen = []
    places = Places()

    def still(obs):
        seen.append(obs)
        return np.zeros(2, np.float32)

    play(still, places, task="panda-push", horizon=2)
    assert all(obs.shape == (7,) and obs.dtype == np.float32 for obs in seen)
    hand, cube, yaw, goal = seen[0][:2], seen[0][2:4], seen[0][4], seen[0][5:]
    assert hand == pytest.approx(RULES["push"].start[:2], abs=0.005)
    assert 0.3 < cube[0] < 0.7
    assert abs(yaw) < 0.9
    assert np.linalg.norm(goal - cube) > 0.09
    assert not np.array_equal(seen[0][2:5], seen[1][2:5])  # noise of the cameras


@pytest.mark.slow
def test_an_episode_follows_from_its_number():
    """A deployment that goes on at its second episode plays what it would have played."""
    both = play(reach, Places(), episodes=2, horizon=6)
    (second,) = play(reach, Places(), episodes=2, first=1, horizon=6)
    assert dataclasses.asdict(second) == dataclasses.asdict(both[1])
    assert both[0].total != both[1].total


@pytest.mark.slow
def test_some_frames_without_sight_are_held():
    (episode,) = play(reach, Places(lambda rig: Dark(rig, 5, 7)), horizon=8)
    assert (episode.lost, episode.acted, episode.held) == ("", 8, 2)


@pytest.mark.slow
def test_lost_from_sight_the_arm_stops_and_the_episode_has_failed():
    """It lasts as long as any, and the next one is played as usual; the arm does not move any more."""
    first, second = play(reach, Places(lambda rig: Dark(rig, 5, 8)), episodes=2, horizon=10)
    assert not first.success
    assert first.lost.startswith("the cube is lost for 3 frames: no camera sees a marker of DICT_4X4_50")
    assert (first.acted, first.steps) == (6, 10)
    assert np.isfinite((first.total, first.total_seen)).all()
    assert (second.acted, second.lost) == (10, "")


@pytest.mark.slow
def test_a_cube_that_is_never_seen():
    """The arm does not move at all."""
    (episode,) = play(lambda obs: 1 / 0, Places(lambda rig: Dark(rig, 1)), horizon=4)
    assert (episode.success, episode.acted, episode.held) == (False, 0, 0)
    assert episode.lost
    assert np.isfinite(episode.total)
    assert np.isnan((episode.total_seen, episode.views)).all()


@pytest.mark.slow
def test_where_time_goes_by_other_pictures_are_waited_for():
    """Looks at one and the same moment would soon be as many as it takes to lose the cube."""

    class Lab(Dark):
        waits = 0

        def truth(self):
            return None

        def wait(self):
            self.waits += 1
            self._rig.wait()

    labs = []
    (episode,) = play(reach, Places(lambda rig: labs.append(Lab(rig, 1, 4)) or labs[-1]), horizon=6, patience=5)
    assert (episode.lost, episode.acted, labs[0].waits) == ("", 6, 3 + 6)


@pytest.mark.slow
def test_an_episode_in_which_the_rig_dies_is_played_again():
    """At a new one, from its beginning: what comes of it is as if nothing had happened, but for the count."""
    places = Places()
    steps = []

    def policy(obs):
        steps.append(obs)
        if len(steps) == 3:
            os.kill(places.made[-1].pid, signal.SIGKILL)
        return reach(obs)

    (episode,) = play(policy, places, horizon=6)
    (undisturbed,) = play(reach, Places(), horizon=6)
    assert dataclasses.replace(episode, breakdowns=0) == undisturbed
    assert episode.breakdowns == 1
    assert len(places.made) == 2
    assert ended(places)


@pytest.mark.slow
def test_a_rig_that_dies_again_and_again():
    """Three times in one episode: one message."""
    places = Places()

    def policy(obs):
        os.kill(places.made[-1].pid, signal.SIGKILL)
        return reach(obs)

    with pytest.raises(RobotError, match=r"episode 0, 3 times in a row: the rig ended \(code -9\)"):
        play(policy, places)
    assert len(places.made) == 3


@pytest.mark.parametrize(
    ("policy", "error", "message"),
    [
        (
            lambda obs: np.full(3, np.nan),
            NumericalError,
            r"action \[nan, nan, nan\] is not finite: the arm has",
        ),
        (lambda obs: np.zeros(2), ConfigError, r"the policy's action has shape \(2,\), this task's has \(3,\)"),
    ],
)
def test_actions_that_are_none(policy, error, message):
    """They end the deployment, and the rig with it."""
    places = Places()
    with pytest.raises(error, match=message):
        play(policy, places)
    assert ended(places)


def test_a_task_that_is_no_arm_s():
    places = Places()
    with pytest.raises(ConfigError, match="a policy of toy-car has nothing to do at an arm; those of panda-reach, "):
        play(reach, places, task="toy-car")
    assert places.made == []


@pytest.mark.slow
def test_a_calibration_of_other_cameras():
    """Another size; or one camera only, of two."""
    one = {"front": EYES["front"]}
    for eyes, message in ((cameras(RigConfig()), "pictures of 480 x 360"), (one, 'no camera "side"')):
        places = Places()
        with pytest.raises(CalibrationError, match=message):
            play(reach, places, eyes=eyes)
        assert ended(places)


def test_ctrl_c():
    """In the middle of an episode: the rig has ended before the caller hears of it."""
    places = Places()

    def policy(obs):
        os.kill(os.getpid(), signal.SIGINT)
        return reach(obs)

    with pytest.raises(KeyboardInterrupt):
        play(policy, places)
    assert ended(places)
