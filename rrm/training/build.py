"""From a configuration to the objects of a run. The one place that knows which class a name stands for."""

from __future__ import annotations

import torch

from rrm.buffers.experience import Experience
from rrm.interfaces import RewardFunction
from rrm.priors import load_prior
from rrm.priors.scale import Normaliser, make_normaliser
from rrm.registry import lookup
from rrm.rewards import LEARNERS
from rrm.rewards.ensemble import EnsembleReward
from rrm.rewards.residual import ResidualReward
from rrm.seeding import Streams
from rrm.teachers.scripted import ScriptedTeacher
from rrm.training.collect import PriorSource
from rrm.training.config import RunConfig
from rrm.training.sessions import Sessions


def build_reward(config: RunConfig, generator: torch.Generator) -> RewardFunction:
    """The learned reward: a residual on the prior where there is one, else a network alone."""
    reward = ResidualReward if config.reward.prior is not None else EnsembleReward
    spec = config.spec()
    return reward(config.reward, spec.obs_dim, spec.act_dim, generator, config.precision)


def build_sessions(config: RunConfig, experience: Experience, streams: Streams) -> Sessions | None:
    """Learner, teacher and schedule of feedback; None where the reward is known.

    Raises:
        RrmError: the learner is unknown, or is a file of the user's that does not import.
    """
    if not config.reward.is_learned:
        return None
    assert config.feedback is not None  # the configuration has checked both
    assert config.teacher is not None
    learner_class = lookup(LEARNERS, "learner", config.reward.learner)
    learner = learner_class(build_reward(config, streams.torch("reward-init")), config.reward, streams.numpy("reward"))
    return Sessions(
        config, config.feedback,
        experience=experience, learner=learner, rng=streams.numpy("query"),
        teacher=ScriptedTeacher(config.teacher, streams.numpy("teacher")), unlabelled_rng=streams.numpy("unlabelled"),
    )  # fmt: skip


def build_prior(config: RunConfig, streams: Streams) -> PriorSource | None:
    """The prior with its normaliser; None where the reward has none."""
    name = config.reward.prior
    if name is None:
        return None
    normaliser: Normaliser = make_normaliser(config.reward.normaliser)
    return PriorSource(name, load_prior(name), normaliser, config.spec(), streams.numpy("prior"))
