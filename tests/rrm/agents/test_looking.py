"""The agents that see frames, in the training loop and at something that only frames show."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from rrm.agents.drm import Drm
from rrm.agents.drqv2 import Drq
from rrm.config import DrmConfig, DrqConfig, EvaluationConfig
from rrm.envs import TASKS, FrameSpace, Spaces
from rrm.seeding import Streams
from rrm.types import Batch, Obs
from tests.rrm.test_seams import SLOPE, Slope, config, trained

SPACES = Spaces(2, 1, FrameSpace(height=16, width=16))


class Drawn(Slope):
    """The ball on its slope, as a bright patch on a dark ground."""

    def frame(self, space):
        picture = np.full((space.height, space.width, 3), 40, np.uint8)
        at = int(np.clip(8 + 6 * self.state[0], 1, 14))
        picture[6:10, at - 1 : at + 2] = 220
        return picture


@pytest.mark.parametrize("agent", [DrqConfig(kind="drqv2", channels=4), DrmConfig(kind="drm", channels=4)])
def test_in_the_loop(tmp_path, monkeypatch, agent):
    """Trained on frames, and interrupted: the same curve, bit for bit. Its figures are in the rows."""
    monkeypatch.setitem(TASKS, "slope", replace(SLOPE, spaces=SPACES, entry_point=f"{__name__}:Drawn"))
    small = agent.model_copy(update={"strides": (2, 1), "hidden": 16, "features": 8, "batch": 8, "shift": 2})
    perturbed = {"perturb_every": 80} if agent.kind == "drm" else {}
    given = config(
        "slope", agent=small.model_copy(update=perturbed), action_repeat=2, steps=120,
        evaluation=EvaluationConfig(every=60, episodes=1),
    )  # fmt: skip
    straight = trained(given, tmp_path / "a")
    assert straight == trained(given, tmp_path / "b", (30, 70, None))
    for figure in ("critic_loss", "actor_loss", "stddev", *(["dormant_ratio"] if agent.kind == "drm" else [])):
        assert f"'{figure}': " in straight[-1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Drq, Drm])
def test_learns_from_what_it_sees(kind):
    """Rewarded for pointing at a patch, it finds out where that is in pictures, also in ones it has not seen."""
    section = {Drq: DrqConfig, Drm: DrmConfig}[kind]
    name = {Drq: "drqv2", Drm: "drm"}[kind]
    given = section(
        kind=name, channels=8, strides=(2, 1), hidden=64, features=20, batch=64, lr=1e-3, n_step=1, discount=0.0,
        shift=1, stddev_steps=400,
    )  # fmt: skip
    agent, rng = kind(given, SPACES, Streams(0)), np.random.default_rng(0)

    def seen(places):
        frames = np.full((len(places), 4, 3, 16, 16), 40, np.uint8)
        for picture, place in zip(frames, places, strict=True):
            at = round(8 + 6 * place)
            picture[..., 6:10, at - 1 : at + 2] = 220
        return torch.from_numpy(frames)

    for step in range(600):
        agent.at(step)
        places, act = rng.uniform(-1, 1, 64), rng.uniform(-1, 1, (64, 1, 1)).astype(np.float32)
        reward = torch.from_numpy(-np.square(act[:, 0] - 0.8 * places[:, None]).astype(np.float32))
        blank = torch.zeros(64, 1, 2)
        agent.update(Batch(blank, torch.from_numpy(act), reward * 0, reward, blank, reward * 0 + 1, seen(places)))
    for place in (-0.9, -0.4, 0.1, 0.7):
        frames = seen([place])[0, :3].numpy()
        assert agent.act(Obs(np.zeros(2), frames), explore=False)[0] == pytest.approx(0.8 * place, abs=0.2)
