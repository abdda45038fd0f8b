"""From a configuration to the objects of a run. The one place that knows which class a name stands for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TypedDict, cast

from rrm.agents import AGENTS
from rrm.buffers.experience import Experience
from rrm.buffers.replay import Replay
from rrm.checkpoint import again
from rrm.config import IMITATION, PRIOR_ALONE, DrqConfig
from rrm.devices import CPU, kind_of
from rrm.errors import ConfigError, DemosError, MissingResultError
from rrm.files import place
from rrm.imitation.demos import Demonstrations
from rrm.imitation.discriminator import Discriminator, RewardNet
from rrm.imitation.finetune import Finetune, ImitatedReward
from rrm.imitation.visual import Eye, VisualDiscriminator
from rrm.interfaces import Agent, RewardFunction, RewardLearner, Teacher, VisualAgent
from rrm.moments import RunningMoments
from rrm.nets.precision import multiplies
from rrm.precision import Precision
from rrm.priors import load_prior
from rrm.priors.imitation import ImitationPrior, read_prior
from rrm.priors.step import PriorStep
from rrm.priors.values import PriorSource
from rrm.registry import lookup
from rrm.rewards import LEARNERS
from rrm.rewards.ensemble import EnsembleReward, ResidualReward
from rrm.rewards.sight import Sight
from rrm.rewards.visual import VisualResidual, VisualReward
from rrm.seeding import Streams
from rrm.sources.adversarial import Adversarial
from rrm.sources.base import Phase, RewardSource
from rrm.sources.entropy import StateEntropy
from rrm.sources.known import Known
from rrm.sources.preferences import PreferenceReward
from rrm.teachers import labels
from rrm.teachers.human import HumanTeacher, ReplayTeacher
from rrm.teachers.scripted import ScriptedTeacher
from rrm.training.run_config import RunConfig

#: Folders of earlier runs, by identity; and of this one, where it asks people.
Results = Mapping[str, Path]
NO_RESULTS: Results = MappingProxyType({})

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
    people: HumanTeacher | None = None  #: the teacher that must be able to show episodes


def assemble(config: RunConfig, streams: Streams, results: Results) -> Parts:
    """The parts of a run, whose random numbers are those of `streams`.

    An `RrmError` says that a name stands for nothing, a file of the user's does not import, or an earlier result is
    missing.
    """
    kind, begin, switch = config.reward.kind, config.random_steps, config.first_session
    agent = build_agent(config, streams)
    if config.borrows_encoder:
        lend_encoder(config, cast("VisualAgent", agent), results)
    repeat, people = config.action_repeat, None
    experience = Experience(
        config.steps // repeat, config.episode_steps // repeat, config.spaces, config.agent.window, config.device
    )
    prior = build_prior(config, streams, results)
    replay = Replay(experience, config.agent.batch, streams.torch("replay"), repeat)

    def preferences(learner: RewardLearner) -> PreferenceReward:
        assert config.feedback is not None  # the configuration has checked it
        config.check_margin(learner.needs.margin * repeat)
        feedback = config.feedback.model_copy(update={"segment": config.feedback.segment // repeat})  # in transitions
        sight = None
        if config.sees_frames:
            experience.seen = sight = Sight(experience, cast("VisualAgent", agent).encoder)
        nonlocal people
        teacher = build_teacher(config, streams, experience, results)
        people = teacher if isinstance(teacher, HumanTeacher) else None
        return PreferenceReward(
            feedback,
            first=switch, steps=config.steps, capacity=config.reward.capacity, experience=experience, replay=replay,
            learner=learner, teacher=teacher, rng=streams.numpy("query"), unlabelled_rng=streams.numpy("unlabelled"),
            sight=sight, twin=build_twin(config),
        )  # fmt: skip

    source: RewardSource
    if kind.known:
        source = Known(replay, "prior") if kind is PRIOR_ALONE else Known(replay, "true_reward", config.reward.factor)
        phases = [Phase(begin=begin, source=source)]
    elif kind.demonstrated:
        imitation = config.imitation.model_copy(update={"window": config.imitation.window // repeat})  # in transitions
        source = Adversarial(
            imitation, _demonstrations(config, results), replay, build_discriminator(config, streams),
            streams=streams, about=None if kind.learned else {"task": config.task, "seed": config.seed},
        )  # fmt: skip
        phases = [Phase(begin=begin, source=source)]
        if kind.learned:
            g = ImitatedReward(source.discriminator.g, source.scale)
            tuned = preferences(Finetune(g, config.reward, streams.numpy("reward"), source.log))
            updates = config.agent.updates_at(switch // repeat)  # the agent learns on as it did
            phases.append(Phase(begin=switch, source=tuned, first_updates=updates))
    else:  # PEBBLE's: an unsupervised phase (none before a residual), and a fresh critic for the first reward
        learner_class = lookup(LEARNERS, "learner", config.reward.learner)
        source = preferences(learner_class(build_reward(config, streams), config.reward, streams.numpy("reward")))
        first_updates = config.exploration.reset_updates
        phases = [Phase(begin=switch, source=source, reset_critic=True, first_updates=first_updates)]
        if switch > begin:
            phases = [
                Phase(begin=begin, source=StateEntropy(source, experience, replay, config.exploration.neighbours)),
                *phases,
            ]
    random = Phase(begin=0, source=source, random=True)
    return Parts(
        agent=agent, experience=experience, replay=replay, prior=prior, phases=(random, *phases), people=people
    )


def _demonstrations(config: RunConfig, results: Results) -> Demonstrations:
    named = config.imitation.demos
    path = Path(named) if named is not None else result_of(results, config.imitation.demos_run, DEMOS)
    try:
        demos = Demonstrations.load(path)
    except DemosError as error:
        if named is not None:
            raise
        raise MissingResultError(f"{error}: {again(path)}") from error
    demos.check(config.spec(), str(path), config.spaces.frames, config.action_repeat)
    return demos


def build_agent(config: RunConfig, streams: Streams) -> Agent:
    """The agent, untrained."""
    made = lookup(AGENTS, "agent", config.agent.kind)
    device = {} if config.device == CPU else {"device": config.device}  # agents of users may know no other
    agent: Agent = made(config.agent, config.spaces, streams, precision=config.precision, **device)
    return agent


def lend_encoder(config: RunConfig, agent: VisualAgent, results: Results) -> None:
    """Have an untrained agent begin with the encoder of the run `agent.encoder_run`.

    Raises ConfigError where that is of another shape, or looks elsewhere; MissingResultError where it is not there.
    """
    assert isinstance(config.agent, DrqConfig)  # the configuration has checked it
    path = result_of(results, config.agent.encoder_run, "model.safetensors")
    theirs = Eye.kept(read_prior(path, config.spec()))
    lent, own = (
        f"{agent.looks}, of frames {frames}"
        for agent, frames in ((theirs.agent, theirs.frames), (config.agent, config.spaces.frames))
    )
    if lent != own:
        raise ConfigError(
            f"agent.encoder: that of {path} has {lent}; this run's agent has {own}: set them as there, or "
            'agent.encoder = "fresh"'
        )
    agent.encoder.flat.copy_(theirs.encoder.flat)


def build_discriminator(config: RunConfig, streams: Streams) -> Discriminator:
    """The discriminator, untrained, of what the agent sees."""
    spaces, generator = config.spaces, streams.torch("imitation-init")
    rest, made = (spaces.act, config.agent.discount), _made(config)
    if not isinstance(config.agent, DrqConfig) or spaces.frames is None:
        return Discriminator(config.imitation, spaces.obs, *rest, generator=generator, **made)
    known = config.spec().features.get("proprioception", slice(0))
    assert isinstance(known, slice)  # a learned reward is told numbers of the observation as they are
    eye = Eye(config.agent, spaces.frames, slice(*known.indices(spaces.obs)[:2]), generator, **made)
    return VisualDiscriminator(config.imitation, eye, *rest, generator=generator, **made)


class _Made(TypedDict):
    precision: Precision
    device: str


def _made(config: RunConfig) -> _Made:
    """How a run computes, and where."""
    return {"precision": config.precision, "device": config.device}


def build_twin(config: RunConfig) -> RewardFunction | None:
    """A learned reward on the processor beside one on a card, to be loaded; none where it sees frames."""
    if kind_of(config.device) == CPU or config.sees_frames:
        return None
    precision = config.precision if multiplies(config.precision) else "float32"
    return build_reward(config.model_copy(update={"device": CPU, "precision": precision}), None)


def build_reward(config: RunConfig, streams: Streams | None) -> RewardFunction:
    """The learned reward, untrained: a residual on the prior where there is one, g alone where that is fine-tuned, else
    an ensemble alone. Its weights are zero without streams.
    """
    residual, spaces = config.reward.prior is not None, config.spaces
    if config.from_demonstrations:
        return ImitatedReward(RewardNet(config.imitation, spaces.obs, spaces.act, None), RunningMoments())
    generator, made = None if streams is None else streams.torch("reward-init"), _made(config)
    if isinstance(config.agent, DrqConfig) and spaces.frames is not None:
        seen = config.agent.encoded(spaces.frames.height, spaces.frames.width)
        visual = VisualResidual if residual else VisualReward
        return visual(config.reward, seen, spaces.act, generator, width=config.agent.features, **made)
    return (ResidualReward if residual else EnsembleReward)(config.reward, spaces.obs, spaces.act, generator, **made)


def build_teacher(config: RunConfig, streams: Streams, experience: Experience, results: Results) -> Teacher:
    """Who answers the run's queries."""
    assert config.teacher is not None  # the configuration has checked both
    assert config.feedback is not None
    if config.teacher.kind == "scripted":
        return ScriptedTeacher(config.teacher, streams.numpy("teacher"), experience.true_rewards)
    if config.teacher.labels is not None:
        config.check_answers()
        return ReplayTeacher(place(config.teacher.labels), config.answered)
    return HumanTeacher(
        result_of(results, config.identity, labels.FILE), config.identity, experience,
        task=config.task, ranges=config.env.ranges(), repeat=config.action_repeat, horizon=config.episode_steps,
        window=config.feedback.window,
    )  # fmt: skip


def build_prior(config: RunConfig, streams: Streams, results: Results) -> PriorSource | None:
    """The prior with its scale; None where the reward has none."""
    name, task = config.reward.prior, config.spec()
    if name is None:
        return None
    if name == IMITATION:
        path = result_of(results, config.reward.prior_run, "model.safetensors")
        prior: Callable[[PriorStep], float] = ImitationPrior(path, task, config.reward.squash, config.spaces.frames)
    else:
        prior = load_prior(name)
    return PriorSource(name, prior, config.reward.normaliser, task, streams.numpy("prior"))


def result_of(results: Results, run: str | None, name: str) -> Path:
    """The file `name` that an earlier run has left behind; a `MissingResultError` where nobody said where it is."""
    if run is None or run not in results:
        raise MissingResultError(
            f"{name} of the run {run} is needed first; `rrmctl run NAME` plans and makes what an experiment needs"
        )
    return results[run] / name
