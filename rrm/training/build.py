"""From a configuration to the objects of a run. The one place that knows which class a name stands for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rrm.agents import AGENTS
from rrm.buffers.experience import Experience
from rrm.buffers.replay import Replay
from rrm.checkpoint import again
from rrm.config import IMITATION, PRIOR_ALONE
from rrm.errors import DemosError, MissingResultError
from rrm.imitation.demos import Demonstrations
from rrm.imitation.discriminator import RewardNet
from rrm.imitation.finetune import Finetune, ImitatedReward
from rrm.interfaces import Agent, RewardFunction, RewardLearner
from rrm.priors import load_prior
from rrm.priors.imitation import ImitationPrior
from rrm.priors.scale import Normaliser, make_normaliser
from rrm.registry import lookup
from rrm.rewards import LEARNERS
from rrm.rewards.ensemble import EnsembleReward, ResidualReward
from rrm.seeding import Streams
from rrm.sources.adversarial import Adversarial
from rrm.sources.entropy import StateEntropy
from rrm.sources.known import PriorAlone, TrueReward
from rrm.sources.preferences import PreferenceReward
from rrm.teachers.scripted import ScriptedTeacher
from rrm.training.phases import Phase
from rrm.training.prior_values import PriorSource
from rrm.training.run_config import RunConfig

#: Folders of earlier runs, by identity.
Results = Mapping[str, Path]

#: Makes the parts of a run, as `assemble` does.
Assembled = Callable[[RunConfig, Streams, Results], "Parts"]

DEMOS = "demos.safetensors"  #: what a run that collects demonstrations leaves behind


@dataclass(frozen=True, kw_only=True)
class Parts:
    """What a run is made of, beside its environments."""

    agent: Agent
    experience: Experience
    replay: Replay
    prior: PriorSource | None
    phases: tuple[Phase, ...]  #: in their order; the first begins at step 0


def assemble(config: RunConfig, streams: Streams, results: Results) -> Parts:
    """The parts of a run.

    Args:
        streams: of its random numbers.
        results: folders of the runs that this one requires, by identity.

    Raises:
        RrmError: a name stands for nothing, a file of the user's does not import, or an earlier result is missing.
    """
    spec = config.spec()
    agent = build_agent(config, streams)
    experience = Experience(config.steps, config.episode_steps, spec.spaces)
    prior = build_prior(config, streams, results)
    replay = Replay(experience, config.agent.batch, streams.torch("replay"))
    phases = _Phases(config, streams, results, experience, replay).all()
    return Parts(agent=agent, experience=experience, replay=replay, prior=prior, phases=phases)


def build_agent(config: RunConfig, streams: Streams) -> Agent:
    """The agent, untrained.

    Raises:
        ConfigError: this processor has no products of the precision asked for.
    """
    agent: Agent = lookup(AGENTS, "agent", config.agent.kind)(
        config.agent, config.spec().spaces, streams, precision=config.precision
    )
    return agent


@dataclass(frozen=True)
class _Phases:
    """The phases of each kind of reward."""

    config: RunConfig
    streams: Streams
    results: Results
    experience: Experience
    replay: Replay

    def all(self) -> tuple[Phase, ...]:
        kind = self.config.reward.kind
        if kind.demonstrated:
            return self._from_demonstrations()
        return self._known() if kind.known else self._from_preferences()

    def _known(self) -> tuple[Phase, ...]:
        source = (PriorAlone if self.config.reward.kind is PRIOR_ALONE else TrueReward)(self.replay)
        return self._begun_by(source), Phase(name=source.name, begin=self.config.random_steps, source=source)

    def _from_preferences(self) -> tuple[Phase, ...]:
        """PEBBLE's: an unsupervised phase (none before a residual), and a fresh critic for the first reward."""
        config, streams = self.config, self.streams
        learner_class = lookup(LEARNERS, "learner", config.reward.learner)
        reward = build_reward(config, streams)
        source = self._preferences(learner_class(reward, config.reward, streams.numpy("reward")))
        entropy = StateEntropy(source, self.experience, self.replay, config.exploration.neighbours)
        return (
            self._begun_by(source),
            Phase(name="unsupervised", begin=config.random_steps, source=entropy),
            Phase(
                name=source.name, begin=config.first_session, source=source, reset_critic=True,
                first_updates=config.exploration.reset_updates,
            ),
        )  # fmt: skip

    def _from_demonstrations(self) -> tuple[Phase, ...]:
        config = self.config
        kept = not config.reward.kind.learned
        source = Adversarial(
            config.imitation, self._demonstrations(), self.replay,
            discount=config.agent.discount, streams=self.streams, precision=config.precision,
            about={"task": config.task, "seed": config.seed} if kept else None,
        )  # fmt: skip
        phases = self._begun_by(source), Phase(name=source.name, begin=config.random_steps, source=source)
        if kept:
            return phases
        g = ImitatedReward(source.discriminator.g)
        tuned = self._preferences(Finetune(g, config.reward, self.streams.numpy("reward"), source.log))
        updates = int(config.first_session % config.agent.update_every == 0)  # the agent learns on as it did
        return *phases, Phase(name=tuned.name, begin=config.first_session, source=tuned, first_updates=updates)

    def _begun_by(self, source: Any) -> Phase:
        return Phase(name="random", begin=0, source=source, random=True)

    def _preferences(self, learner: RewardLearner) -> PreferenceReward:
        config, streams = self.config, self.streams
        assert config.feedback is not None  # the configuration has checked both
        assert config.teacher is not None
        config.check_margin(learner.needs.margin)
        teacher = ScriptedTeacher(config.teacher, streams.numpy("teacher"), self.experience)
        return PreferenceReward(
            config.feedback,
            first=config.first_session, steps=config.steps, capacity=config.reward.capacity,
            experience=self.experience, replay=self.replay, learner=learner, teacher=teacher,
            rng=streams.numpy("query"), unlabelled_rng=streams.numpy("unlabelled"),
        )  # fmt: skip

    def _demonstrations(self) -> Demonstrations:
        named = self.config.imitation.demos
        path = Path(named) if named is not None else result_of(self.results, self.config.imitation.demos_run, DEMOS)
        try:
            demos = Demonstrations.load(path)
        except DemosError as error:
            if named is not None:
                raise
            raise MissingResultError(f"{error}: {again(path)}") from error
        demos.check(self.config.spec(), str(path))
        return demos


def build_reward(config: RunConfig, streams: Streams) -> RewardFunction:
    """The learned reward, untrained: a residual on the prior where there is one, g alone where that is fine-tuned, else
    an ensemble alone.
    """
    kind, spec = ResidualReward if config.reward.prior is not None else EnsembleReward, config.spec()
    if config.from_demonstrations:
        return ImitatedReward(RewardNet(config.imitation, spec.spaces.obs, spec.spaces.act, None))
    return kind(config.reward, spec.spaces.obs, spec.spaces.act, streams.torch("reward-init"), config.precision)


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
