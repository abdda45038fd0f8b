"""Small runs of the toy car, seconds long, with every mechanism in them."""

import contextlib
import dataclasses
from pathlib import Path

import pytest

from rrm.config import EvaluationConfig, ExplorationConfig, FeedbackConfig, RewardConfig, SacConfig
from rrm.training.run_config import RunConfig


@pytest.fixture
def tiny():
    """Makes a run of a few hundred steps: 50-step episodes, feedback every 150 steps from step 150 (200) on."""

    def make(learner="pebble", **fields):
        names = ("prior", "normaliser", "bound", "surf", "mrn", "prior_run", "squash", "inputs")
        known = {key: fields.pop(key) for key in names if key in fields}
        sampler = {"sampler": fields.pop("sampler")} if "sampler" in fields else {}
        reward = RewardConfig(learner=learner, hidden=16, layers=1, epochs=3, **known)
        given = {
            "profile": "test", "task": "toy-car", "seed": 0, "steps": 700, "horizon": 50, "reward": reward,
            "agent": SacConfig(hidden=16, layers=1, batch=16),
            "feedback": FeedbackConfig(every=150, batch=10, budget=25, segment=10, **sampler),
            "exploration": ExplorationConfig(seed_steps=100, unsupervised_steps=50, reset_updates=5),
            "evaluation": EvaluationConfig(every=250, episodes=2),
        }  # fmt: skip
        return RunConfig(**given | fields).canonical()

    return make


class Recorder:
    """A monitor that keeps what it is told and stops the job after `patience` steps."""

    def __init__(self, patience=None):
        self.rows, self.notes, self.beats, self.patience = {}, [], [], patience

    def restored(self, rows):
        for row in rows:
            self.rows.setdefault(row.step, row)

    def row(self, row):
        self.rows[row.step] = row

    def note(self, message):
        self.notes.append(message)

    def beat(self, step, steps_per_s):
        self.beats.append(step)

    def writing(self):
        return contextlib.nullcontext()

    def should_stop(self):
        if self.patience is None:
            return False
        self.patience -= 1
        return self.patience <= 0

    def numbers(self):
        """The rows without what the clock put into them, as text, so that NaN equals NaN."""
        return [repr(dataclasses.replace(self.rows[s], wall_s=0, steps_per_s=0)) for s in sorted(self.rows)]


@pytest.fixture
def recorder():
    return Recorder


@pytest.fixture
def networks():
    """The bytes of a finished run's networks."""
    return lambda folder: (Path(folder) / "model.safetensors").read_bytes()
