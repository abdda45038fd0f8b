"""Parts of one's own, each in a few lines and without touching the library: an agent, a reward, a simulator."""

from dataclasses import replace

import numpy as np
import pytest

from rrm.agents import AGENTS
from rrm.config import CameraConfig, DrqConfig, EvaluationConfig, ExplorationConfig, RewardConfig, SacConfig
from rrm.envs import TASKS, FrameSpace, Spaces, Task
from rrm.envs.base import TaskEnv
from rrm.sources.base import Phase, RewardSource
from rrm.training.build import assemble
from rrm.training.jobs import fingerprint, train
from rrm.training.run_config import RunConfig
from tests.rrm.training.conftest import Recorder


def config(task="toy-car", **fields):
    given = {
        "task": task, "seed": 0, "steps": 300, "agent": SacConfig(hidden=16, layers=1, batch=16),
        "reward": RewardConfig(learner="true"), "exploration": ExplorationConfig(seed_steps=50),
        "evaluation": EvaluationConfig(every=100, episodes=1),
    }  # fmt: skip
    return RunConfig(**given | fields).canonical()


def trained(given, folder, stops=(None,), **options):
    """The curve of a run that is stopped after so many steps each time."""
    seen = {}
    for patience in stops:
        recorder = Recorder(patience)
        recorder.rows = seen
        finished = train(given, folder, recorder, **options)
    assert finished
    return Recorder.numbers(recorder)


class Uniform:
    """An agent that learns nothing: its actions are uniformly random, when it explores and when it does not."""

    def __init__(self, config, spaces, streams, *, precision):
        self.updates, self._act_dim = 0, spaces.act
        self._explore, self._evaluate = streams.numpy("uniform"), np.random.default_rng(0)

    def at(self, step):
        pass

    def act(self, obs, *, explore):
        return (self._explore if explore else self._evaluate).uniform(-1, 1, self._act_dim).astype(np.float32)

    def update(self, batch):
        self.updates += 1

    def reset_critic(self):
        pass

    def figures(self):
        return {"updates": float(self.updates)}

    def weights(self):
        return {}

    def state_dict(self):
        return {"updates": self.updates, "evaluate": self._evaluate.bit_generator.state}

    def load_state_dict(self, state):
        self.updates, self._evaluate.bit_generator.state = state["updates"], state["evaluate"]


def test_an_agent_of_ones_own(tmp_path, monkeypatch):
    """One entry of the table; it is driven, evaluated, saved and resumed like ours, also where a reward is learned."""
    monkeypatch.setitem(AGENTS, "sac", f"{__name__}:Uniform")
    given = config(reward=RewardConfig(hidden=16, layers=1), exploration=ExplorationConfig(seed_steps=50))
    straight = trained(given, tmp_path / "a")
    assert straight == trained(given, tmp_path / "b", (70, 160, None))
    assert "'updates': " in straight[-1]


class Praise(RewardSource):
    """A reward that praises small actions, and remembers the smallest."""

    name = "praise"

    def __init__(self, replay):
        self._replay, self.smallest = replay, np.inf

    def reward(self, step):
        effort = float(np.square(step.act).sum())
        self.smallest = min(self.smallest, effort)
        return -effort

    def batch(self, agent):
        return self._replay.sample()

    def figures(self, rng):
        return {"smallest_effort": self.smallest}

    def state_dict(self):
        return {"smallest": self.smallest}

    def load_state_dict(self, state):
        self.smallest = state["smallest"]


def praised(given, streams, results):
    parts = assemble(given, streams, results)
    source = Praise(parts.replay)
    return replace(parts, phases=(Phase(begin=0, source=source),))


def test_a_source_of_rewards_of_ones_own(tmp_path):
    """It decides what is stored and learned from, tells its figure in every row, and comes back with the checkpoint."""
    straight = trained(config(), tmp_path / "a", assembled=praised)
    assert straight == trained(config(), tmp_path / "b", (70, 160, None), assembled=praised)
    assert "'smallest_effort': " in straight[-1]
    assert straight != trained(config(), tmp_path / "c")


class Slope(TaskEnv):
    """A ball on a slope that is to be kept near the middle."""

    def __init__(self, horizon, steepness, render_mode=None):
        super().__init__(-10, 10, obs_dim=2, act_dim=1, horizon=horizon, render_mode=render_mode)
        self.steepness, self.state = float(steepness), np.zeros(2)

    def _begin(self):
        self.state = np.array([self.np_random.uniform(-1, 1), 0.0])
        return self.state

    def _advance(self, action):
        x, speed = self.state
        self.state = np.clip([x + 0.1 * speed, speed + action[0] + self.steepness * x], -10, 10)
        return self.state, -abs(self.state[0]), {"success": float(abs(self.state[0]) < 0.5)}

    def _save(self):
        return {"state": self.state.copy()}

    def _restore(self, state):
        self.state = state["state"].copy()


SLOPE = Task(
    name="slope", suite="mine", score="success", horizon=40, spaces=Spaces(2, 1), entry_point=f"{__name__}:Slope",
    kwargs={"steepness": "0.1"},
    features={"position": slice(0, 1), "energy": lambda obs: np.square(obs).sum(keepdims=True)},
)  # fmt: skip


def test_a_simulator_of_ones_own(tmp_path, monkeypatch):
    """A task with features that no other has; a prior asks for them by name, and what is not there is refused."""
    monkeypatch.setitem(TASKS, "slope", SLOPE)
    prior = tmp_path / "mine.py"
    prior.write_text("def calm(step):\n    return -step.feature('energy')[0] + step.feature('position')[0]\n")
    given = config("slope", reward=RewardConfig(learner="prior", prior=f"{prior}:calm"))
    assert trained(given, tmp_path / "a") == trained(given, tmp_path / "b", (70, 160, None))
    assert fingerprint(given)["gymnasium"]
    with pytest.raises(ValueError, match="reads hand, object, goal or upright, which slope does not reveal"):
        config("slope", reward=RewardConfig(learner="prior", prior="proxy"))


class Filmed(Slope):
    """The same with a camera: a line of pixels, one of which is the ball, and a clock of the episode."""

    def frame(self, space):
        assert (space.height, space.width, space.quality) == (1, 8, "full")
        picture = np.zeros((1, 8, 2), np.uint8)
        picture[0, int(np.clip(4 + 4 * self.state[0], 0, 7)), 0] = 255
        picture[..., 1] = self._steps or 0
        return picture


class Looking(Uniform):
    """An agent that sees nothing but frames: it acts on the newest, and remembers what its batches showed."""

    def __init__(self, config, spaces, streams, *, precision):
        super().__init__(config, spaces, streams, precision=precision)
        self._shape, self._window, self.seen = (spaces.frames.stack, 2, 1, 8), config.window, 0

    def act(self, obs, *, explore):
        assert obs.frames.shape == self._shape
        return np.array([4 - obs.frames[-1, 0, 0].argmax()], np.float32) / 4

    def update(self, batch):
        super().update(batch)
        assert batch.reward.shape == (BATCH, self._window)
        clock = batch.frames[..., 1, 0, 0].long()  # of every picture, one state's after another
        first = clock[:, self._shape[0] - 1]
        for position in range(clock.shape[1]):  # an episode's first frame stands for those before it
            moment = first + REPEAT * (position - self._shape[0] + 1)
            assert (clock[:, position] == moment.clamp(min=0)).all()
        assert clock.shape[1] == self._shape[0] + self._window
        self.seen += int(batch.frames.sum())

    def figures(self):
        return {"seen": float(self.seen)}

    def state_dict(self):
        return super().state_dict() | {"seen": self.seen}

    def load_state_dict(self, state):
        super().load_state_dict(state)
        self.seen = state["seen"]


BATCH, REPEAT = 16, 2


@pytest.mark.parametrize("window", [1, 3])
def test_a_camera_of_ones_own(tmp_path, monkeypatch, window):
    """A task with frames: an agent acts on the newest and learns from those of consecutive steps, also after an
    interruption; each of its steps lasts two of the environment's.
    """
    spaces = Spaces(2, 1, FrameSpace(height=1, width=8, channels=2, stack=3))
    monkeypatch.setitem(TASKS, "slope", replace(SLOPE, spaces=spaces, entry_point=f"{__name__}:Filmed"))
    monkeypatch.setitem(AGENTS, "drqv2", f"{__name__}:Looking")
    agent = DrqConfig(kind="drqv2", batch=BATCH, n_step=window)
    given = config("slope", agent=agent, action_repeat=REPEAT, camera=CameraConfig(quality="full"))
    straight = trained(given, tmp_path / "a")
    assert straight == trained(given, tmp_path / "b", (70, 160, None))
    assert "'seen': " in straight[-1]
