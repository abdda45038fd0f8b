"""From a configuration to the objects of a run. The one place that knows which class a name stands for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch

from rrm.buffers.experience import Experience
from rrm.checkpoint import again
from rrm.config import IMITATION
from rrm.errors import DemosError, MissingResultError
from rrm.imitation.demos import Demonstrations
from rrm.imitation.finetune import Finetune, ImitatedReward
from rrm.interfaces import RewardFunction, RewardLearner
from rrm.priors import load_prior
from rrm.priors.imitation import ImitationPrior
from rrm.priors.scale import Normaliser, make_normaliser
from rrm.registry import lookup
from rrm.rewards import LEARNERS
from rrm.rewards.ensemble import EnsembleReward
from rrm.rewards.residual import ResidualReward
from rrm.seeding import Streams
from rrm.teachers.scripted import ScriptedTeacher
from rrm.training.collect import PriorSource
from rrm.training.config import RunConfig
from rrm.training.imitate import Imitation
from rrm.training.sessions import Sessions

#: Folders of earlier runs, by identity.
Results = Mapping[str, Path]

DEMOS = "demos.safetensors"  #: what a run that collects demonstrations leaves behind


def build_reward(config: RunConfig, generator: torch.Generator) -> RewardFunction:
    """The learned reward: a residual on the prior where there is one, else a network alone."""
    reward = ResidualReward if config.reward.prior is not None else EnsembleReward
    spec = config.spec()
    return reward(config.reward, spec.obs_dim, spec.act_dim, generator, config.precision)


def build_sessions(
    config: RunConfig, experience: Experience, streams: Streams, imitation: Imitation | None
) -> Sessions | None:
    """Learner, teacher and schedule of feedback; None where no preference trains the reward.

    Raises:
        RrmError: the learner is unknown, or is a file of the user's that does not import.
    """
    if not config.reward.is_learned:
        return None
    assert config.feedback is not None  # the configuration has checked both
    assert config.teacher is not None
    learner: RewardLearner
    if imitation is not None:
        g = ImitatedReward(imitation.airl.discriminator.g)
        learner = Finetune(g, config.reward, streams.numpy("reward"), imitation.log)
    else:
        learner_class = lookup(LEARNERS, "learner", config.reward.learner)
        reward = build_reward(config, streams.torch("reward-init"))
        learner = learner_class(reward, config.reward, streams.numpy("reward"))
    return Sessions(
        config, config.feedback,
        experience=experience, learner=learner, rng=streams.numpy("query"),
        teacher=ScriptedTeacher(config.teacher, streams.numpy("teacher")), unlabelled_rng=streams.numpy("unlabelled"),
    )  # fmt: skip


def build_prior(config: RunConfig, streams: Streams, results: Results) -> PriorSource | None:
    """The prior with its normaliser; None where the reward has none.

    Raises:
        RrmError: the prior is unknown, does not import, or what trains it has not left it behind.
    """
    name = config.reward.prior
    if name is None:
        return None
    prior = _imitation(config, results) if name == IMITATION else load_prior(name)
    normaliser: Normaliser = make_normaliser(config.reward.normaliser)
    return PriorSource(name, prior, normaliser, config.spec(), streams.numpy("prior"))


def _imitation(config: RunConfig, results: Results) -> ImitationPrior:
    path = result_of(results, config.reward.prior_run, "model.safetensors")
    return ImitationPrior(path, config.spec(), config.reward.squash)


def build_imitation(config: RunConfig, experience: Experience, streams: Streams, results: Results) -> Imitation | None:
    """Demonstrations and what is made of them; None for runs that do not begin with demonstrations.

    Raises:
        DemosError, MissingResultError: there are no demonstrations, or they do not suit the task.
    """
    if not config.from_demonstrations:
        return None
    named = config.imitation.demos
    path = Path(named) if named is not None else result_of(results, config.imitation.demos_run, DEMOS)
    try:
        demos = Demonstrations.load(path)
    except DemosError as error:
        if named is not None:
            raise
        raise MissingResultError(f"{error}: {again(path)}") from error
    demos.check(config.spec(), str(path))
    return Imitation(config, demos, experience, streams)


def result_of(results: Results, run: str | None, name: str) -> Path:
    """The file `name` that an earlier run has left behind.

    Raises:
        MissingResultError: the configuration names no such run, or nobody said where it is.
    """
    if run is None or run not in results:
        raise MissingResultError(
            f"{name} of the run {run} is needed first; `rrmctl run NAME` plans and makes what an experiment needs"
        )
    return results[run] / name
