"""The sections of a run's configuration: frozen, complete, unknown keys refused.

Defaults are the paper's (appendix tables); where it is silent the field says whose they are. Nothing here imports
torch or a simulator. `rrm.training.run_config` puts the sections together.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Tag
from pydantic_core import PydanticCustomError

from rrm.errors import ConfigError

Count = Annotated[int, Field(ge=1)]
NonNegative = Annotated[int, Field(ge=0)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]

#: The learner that knows demonstrations alone: its run leaves the prior of this name behind.
AIRL = "airl"
IMITATION = "imitation"


@dataclass(frozen=True, kw_only=True)
class RewardKind:
    """How a reward comes about, which decides what a run is made of."""

    learned: bool = True  #: from preferences: feedback and teacher mean something
    demonstrated: bool = False  #: it begins with demonstrations
    prior: Literal["ignored", "needed", "refused", "residual"] = "residual"  #: what becomes of `reward.prior`

    @property
    def known(self) -> bool:
        """Nothing is learned of it."""
        return not (self.learned or self.demonstrated)


KNOWN = RewardKind(learned=False, prior="ignored")  #: the true reward
PRIOR_ALONE = RewardKind(learned=False, prior="needed")
ADVERSARIAL = RewardKind(learned=False, demonstrated=True, prior="refused")  #: demonstrations alone
TUNED = RewardKind(demonstrated=True, prior="refused")  #: the reward of demonstrations, trained further
LEARNED = RewardKind()  #: from preferences, alone or on a prior

#: What the names that are no learner's mean, and the learner that is unlike the others.
KINDS = {"true": KNOWN, "prior": PRIOR_ALONE, AIRL: ADVERSARIAL, "finetune": TUNED}


@dataclass(frozen=True, kw_only=True)
class Needs:
    """What a learner asks of feedback sessions and of the loop, beyond labelled pairs of segments."""

    margin: int = 0  #: steps beside a segment, on either side: it sees more than the teacher, who sees the middle
    unlabelled: int = 0  #: uniform pairs without a label, drawn and kept for each query
    refine_every: int = 1  #: environment steps between two calls of `refine`, which come before an update of the agent
    refine_when_spent: bool = True  #: whether `refine` is still called once every question is asked
    time_limits_end: bool = False  #: whether the batch of `refine`, and of the update after it, ends at time limits


class ConfigSection(BaseModel):
    """What all sections share."""

    model_config = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class AgentConfig(ConfigSection):
    """What every agent has: how often it learns, and from how much. A step of its own is `action_repeat` of the
    environment's; every other number of a configuration that counts steps counts the environment's.
    """

    reads: ClassVar[Literal["state", "frames"]]  #: of an observation

    hidden: Count = 256  #: units of each hidden layer, actor and critic
    batch: Count = 512  #: transitions per update
    discount: Fraction = 0.99  #: of one of its steps
    update_every: Count = 1  #: of its steps, per update

    if TYPE_CHECKING:  # a setting, whose one value differs

        @property
        def kind(self) -> str:
            """Its name in `rrm.agents.AGENTS`."""

    @property
    def window(self) -> int:
        """Consecutive steps of its own that a sample of its batches spans."""
        return 1

    def updates_at(self, step: int) -> int:
        """Updates before this step of its own."""
        return int(step % self.update_every == 0)

    def updates(self, begin: int, end: int) -> int:
        """Updates before all its steps from `begin` up to `end`."""
        return max(0, -(-end // self.update_every) - -(-begin // self.update_every))


class SacConfig(AgentConfig):
    """SAC (appendix, table of SAC hyper-parameters; what that table leaves open follows B-Pref)."""

    reads: ClassVar[Literal["state", "frames"]] = "state"

    layers: Count = 3  #: hidden layers
    actor_lr: Positive = 1e-4  #: Adam step size
    critic_lr: Positive = 1e-4  #: Adam step size
    alpha_lr: Positive = 1e-4  #: Adam step size of the log temperature; not in the paper, B-Pref's
    initial_alpha: Positive = 0.1  #: temperature at the start
    tau: Fraction = 0.005  #: share of the critic that enters its target
    target_every: Count = 2  #: updates between two target updates
    early_steps: NonNegative = 0  #: of its steps, at which one update is two; not in the paper
    critic_norm: Literal["none", "layer"] = "none"  #: layer normalisation in the critics; not in the paper
    kind: Literal["sac"] = "sac"

    def updates_at(self, step: int) -> int:
        return super().updates_at(step) * (2 if step < self.early_steps else 1)

    def updates(self, begin: int, end: int) -> int:
        return super().updates(begin, end) + super().updates(begin, min(self.early_steps, end))


class DrqConfig(AgentConfig):
    """DrQ-v2 (Yarats et al. 2021; appendix, table of its hyper-parameters; what that leaves open follows its code)."""

    reads: ClassVar[Literal["state", "frames"]] = "frames"

    kind: Literal["drqv2"]
    update_every: Count = 2
    layers: Count = 2  #: hidden layers of actor and critics
    lr: Positive = 1e-4  #: Adam step size of encoder, actor and critic
    tau: Fraction = 0.01  #: share of the critic that enters its target
    n_step: Count = 3  #: of its steps, whose rewards are added up before the critic is asked
    channels: Count = 32  #: of every convolution
    strides: Annotated[tuple[Count, ...], Field(strict=False, min_length=1)] = (2, 1, 1, 1)  #: of each, 3 x 3
    features: Count = 50  #: numbers that actor and critics each make of what the encoder says
    shift: NonNegative = 4  #: pixels by which pictures are moved at random, at the most, in either direction
    stddev: Weight = 1.0  #: of the noise of actions at the start
    last_stddev: Weight = 0.1  #: and at the end
    stddev_steps: Count = 500_000  #: environment steps from the one to the other, in a line
    stddev_clip: Positive = 0.3  #: of the noise in updates; "50" in the paper's table is its number of features
    encoder: Literal["fresh", "imitation"] | None = None  #: at the start; `imitation` is that of the run behind this
    #: prior, and what None means on it
    encoder_run: str | None = None  #: identity of that run; filled in by planning

    @property
    def window(self) -> int:
        return self.n_step

    @property
    def looks(self) -> str:
        """What an encoder lent to another agent must have in common with its own, in words."""
        return f"{self.channels} channels and strides {list(self.strides)}"

    def encoded(self, height: int, width: int) -> int:
        """Numbers that the encoder makes of pictures of this size."""
        for stride in self.strides:
            height, width = ((side - 3) // stride + 1 for side in (height, width))
        return self.channels * height * width


class DrmConfig(DrqConfig):
    """DrM (Xu et al. 2024) on DrQ-v2: its authors' settings of sweep-into, with DrQ-v2's `n_step` and `discount`."""

    kind: Literal["drm"]  # type: ignore[assignment]
    dormant_share: Fraction = 0.025  #: of its layer's mean, below which a unit is dormant
    target_ratio: Fraction = 0.2  #: of dormant units, below which noise follows its schedule
    sharpness: Positive = 10.0  #: of the noise, in how far the ratio is above the target
    perturb_every: Count = 200_000  #: environment steps between two perturbations
    least_kept: Fraction = 0.2  #: of the weights at a perturbation
    most_kept: Fraction = 0.9
    expectile: Fraction = 0.9  #: of the values of data
    exploitation: Fraction = 0.6  #: lambda: their share in the target
    dropout: Fraction = 0.01  #: in the critics


def _agent_kind(agent: Any) -> str:
    """Of a section, or of what it is read from: SAC where nothing is said."""
    return str(agent.get("kind", "sac") if isinstance(agent, dict) else agent.kind)


#: The section of an agent, told by its `kind`.
AnyAgent = Annotated[
    Annotated[SacConfig, Tag("sac")] | Annotated[DrqConfig, Tag("drqv2")] | Annotated[DrmConfig, Tag("drm")],
    Discriminator(_agent_kind),
]


class CameraConfig(ConfigSection):
    """How a task with a camera is looked at; None is as the task has it."""

    view: str | None = None  #: one of the task's
    size: Annotated[int, Field(ge=1, le=1024)] | None = None  #: pixels of a side
    stack: Count | None = None  #: newest pictures that an agent sees at once
    quality: Literal["fast", "full"] = "fast"  #: without shadows, reflections and smooth edges, or with them


def _ends(value: Any) -> Any:
    """A number stands for the range that begins and ends there."""
    if isinstance(value, int | float):
        return value, value
    if isinstance(value, list | tuple) and len(value) == 2:
        return value
    raise PydanticCustomError("range", "One number, or a range [lowest, highest]")


def _ordered(ends: tuple[Any, Any]) -> tuple[Any, Any]:
    if ends[0] > ends[1]:
        raise PydanticCustomError("range", "A range goes from its lower to its upper end")
    return ends


_Number = TypeVar("_Number")
#: From where to where a quantity is drawn, both ends included; one number stands for both.
Range = Annotated[tuple[_Number, _Number], Field(strict=False), BeforeValidator(_ends), AfterValidator(_ordered)]


class EnvConfig(ConfigSection):
    """Domain randomisation: what of a simulation is drawn anew at every reset, uniformly from a range, of tasks that
    have it. None is as the task has it.
    """

    cube_size: Range[Annotated[float, Field(ge=0.03, le=0.06)]] | None = None  #: side, metres
    cube_mass: Range[Annotated[float, Field(ge=0.01, le=1.0)]] | None = None  #: kilograms
    friction: Range[Annotated[float, Field(ge=0.1, le=1.5)]] | None = None  #: of the cube on table and fingers
    latency: Range[Annotated[int, Field(ge=0, le=10)]] | None = (
        None  #: commands between one that is given and its effect
    )
    noise: Range[Annotated[float, Field(ge=0.0, le=0.02)]] | None = (
        None  #: standard deviation of the cube's observed position, metres
    )

    def ranges(self) -> dict[str, tuple[float, float]]:
        """What is drawn, and from where to where."""
        return {name: ends for name, ends in self if ends is not None}


class LearnerSettings(ConfigSection):
    """What a learner of ours is told beyond `RewardConfig`, and what planning must know of it without making it.

    A learner with settings of its own has a section of this kind in `RewardConfig`, by its name.
    """

    amounts: ClassVar[tuple[str, ...]] = ()  #: settings that a profile shrinks with the length of a run
    ignores: ClassVar[tuple[str, ...]] = ()  #: settings of `RewardConfig` that mean nothing to it

    def needs(self) -> Needs:
        """Of the learner with these settings."""
        return Needs()

    @property
    def pairs_per_label(self) -> int:
        """Pairs in a gradient step for each labelled one, itself included."""
        return 1

    def check(self, segment: int, update_every: int) -> None:
        """Refuse settings that do not go with segments of so many steps, or so many steps between two updates."""


class SurfConfig(LearnerSettings):
    """SURF (Park et al. 2022); its README's settings for Meta-World, whose passes over the labels are `epochs = 20`."""

    threshold: Fraction = 0.99  #: tau: a pseudo-label counts from this probability of its class on
    ratio: Count = 4  #: mu: pairs without a label per labelled one in a gradient step
    unlabelled: Count = 10  #: rho: pairs without a label drawn per query
    weight: Weight = 1.0  #: lambda_u: of the loss on pseudo-labels
    margin: NonNegative = 5  #: w: steps a segment is longer by, on either side
    crop: NonNegative = 5  #: c: a crop is up to so many steps shorter or longer than a segment

    ignores: ClassVar[tuple[str, ...]] = ("target_accuracy",)

    def needs(self) -> Needs:
        return Needs(margin=self.margin, unlabelled=self.unlabelled)

    @property
    def pairs_per_label(self) -> int:
        return 1 + self.ratio

    def check(self, segment: int, update_every: int) -> None:  # noqa: ARG002 (the seam of others)
        longest = min(2 * self.margin, segment - 1)
        if self.crop > longest:
            raise ConfigError(
                f"reward.surf.crop: {self.crop} steps more or less; {longest} at the most with segments of {segment} "
                f"between margins of {self.margin}"
            )


class MrnConfig(LearnerSettings):
    """MRN (Liu et al. 2022, "Meta-Reward-Net"); its README's settings for Meta-World."""

    amounts: ClassVar[tuple[str, ...]] = ("every",)

    every: Count = 10_000  #: environment steps between two steps along the critic's opinion
    outer_weight: Positive = 0.1  #: of the outer loss
    meta_optimizer: Literal["shared", "separate"] = "shared"  #: the Adam of the labels (MRN's), or one of its own
    faithful_done: bool = False  #: MRN's code: at those steps a time limit cuts the bootstrap as a termination does

    def needs(self) -> Needs:
        return Needs(refine_every=self.every, refine_when_spent=False, time_limits_end=self.faithful_done)

    def check(self, segment: int, update_every: int) -> None:  # noqa: ARG002 (the seam of others)
        if self.every % update_every:
            raise ConfigError(f"reward.mrn.every: {self.every} is not a multiple of agent.update_every, {update_every}")


class RewardConfig(ConfigSection):
    """The reward the agent is trained on, and how it is learned (section 3, appendix "Model structure")."""

    learner: str = "pebble"  #: a learner's name, `true`, `prior`, or `file.py:Class`
    factor: Positive = 1.0  #: of the true reward, where the agent is trained on that; not in the paper
    prior: str | None = None  #: residual on this prior: a name, or `file.py:function`
    prior_digest: str | None = None  #: sha-256 of the user's file behind `prior`; filled in by planning
    learner_digest: str | None = None  #: likewise for `learner`
    prior_run: str | None = None  #: identity of the run that trained the prior `imitation`; filled in by planning
    squash: Literal["none", "tanh"] = "tanh"  #: of the prior `imitation`, which `tanh` keeps within [-1, 1]
    options: dict[str, Any] = Field(default_factory=dict)  #: what a learner of the user's own wants to be told
    normaliser: Literal["scale", "zscore"] = "scale"  #: appendix (default), or the main text's
    bound: Literal["tanh", "gaussian"] = "tanh"  #: what keeps the reward near its prior: a tanh, or a squared penalty
    penalty: Weight = 1.0  #: lambda of the squared penalty; the main text's, 1 / (2 sigma^2) in the appendix
    members: Count = 3  #: networks of the ensemble
    hidden: Count = 256
    layers: Count = 3
    lr: Positive = 3e-4  #: Adam; the appendix' value, the main text says 3e-3
    inputs: Literal["raw", "standard"] = "raw"  #: observations as they are, or (not in the paper) less their mean and
    #: over their deviation, at least 0.05, before the first training
    minibatch: Count = 128  #: labelled pairs per gradient step
    epochs: Count = 10  #: passes over all labels per session at the most
    most_steps: Count | None = None  #: gradient steps per session at the most
    target_accuracy: Fraction = 0.97  #: stop after an epoch above it; 1 never stops early
    capacity: Count = 10_000  #: newest labels kept
    surf: SurfConfig = SurfConfig()  #: of the learner `surf`
    mrn: MrnConfig = MrnConfig()  #: of the learner `mrn`

    @property
    def kind(self) -> RewardKind:
        """How the reward comes about."""
        return KINDS.get(self.learner, LEARNED)

    @classmethod
    def own(cls) -> dict[str, LearnerSettings]:
        """The sections of learners that have one, at their defaults, by name."""
        defaults = {name: field.default for name, field in cls.model_fields.items()}
        return {name: default for name, default in defaults.items() if isinstance(default, LearnerSettings)}

    @property
    def settings(self) -> LearnerSettings:
        """Of the learner. One of the user's has none here: it says what it needs when it is made."""
        settings: LearnerSettings = getattr(self, self.learner) if self.learner in self.own() else LearnerSettings()
        return settings


class ImitationConfig(ConfigSection):
    """AIRL (Fu et al. 2018; appendix "Imitation rewards"), the demonstrations before it and the fine-tuning after."""

    steps: Count = 1_000_000  #: environment steps of the run that trains the prior
    seed_steps: Count = 5000  #: uniformly random actions before the first update
    every: Count = 1000  #: environment steps between two trainings of the discriminator
    updates: Count = 100  #: gradient steps of each
    minibatch: Count = 128  #: expert transitions of a gradient step, and as many of the policy's
    window: Count = 20_000  #: newest transitions that the policy's are drawn from, of 20 rounds; the paper is silent
    uniform: Fraction = 0.1  #: share of uniform actions in the density that the discriminator takes for the policy's
    hidden: Count = 256
    layers: Count = 3
    lr: Positive = 1e-4  #: Adam
    head: Literal["linear", "tanh"] = "linear"  #: of the reward g
    pretrain: Literal["airl", "mse"] = "airl"  #: text and figure differ; mse pulls g to 1 for experts, 0 for the policy
    episodes: Count = 50  #: demonstrations
    expert_success: Fraction = 0.8  #: share of demonstrations that must succeed, where the task has that notion
    demos: str | None = None  #: a file of the user's instead of demonstrations by the oracle
    demos_digest: str | None = None  #: sha-256 of that file; filled in by planning
    demos_run: str | None = None  #: identity of the run that collects the demonstrations; filled in by planning
    switch: Count = 400_000  #: step from which `finetune` learns from preferences


class FeedbackConfig(ConfigSection):
    """When how many queries are put (section 4.1; sampler, pool and window after B-Pref)."""

    every: Count = 5000  #: environment steps between sessions
    batch: Count = 50  #: queries of a session
    budget: Count = 5000  #: queries in all
    segment: Count = 50  #: steps of a segment
    sampler: Literal["uniform", "disagreement", "entropy", "kcenter", "kcenter-disagreement", "kcenter-entropy"] = (
        "disagreement"  #: from the second session on; the first is uniform
    )
    pool: Count = 10  #: candidate pairs per query asked
    schedule: Literal["constant", "decay", "grow"] = "constant"  #: `decay` asks fewer as the run goes on, `grow` more
    window: Count = 100  #: newest complete episodes that segments are drawn from

    def session_size(self, step: int, steps: int, requested: int) -> int:
        """Queries of the session at `step` of a run of `steps`, after `requested` before it; the budget caps all."""
        factor = {"constant": 1.0, "decay": (steps - step) / steps or 0.01, "grow": steps / (steps - step + 1)}
        wanted = max(1, int(self.batch * factor[self.schedule]))
        return max(0, min(wanted, self.budget - requested))


class TeacherConfig(ConfigSection):
    """Who answers: the scripted teacher of B-Pref (appendix "Noisy teacher models"), people, or what they said once."""

    kind: Literal["scripted", "human", "replay"] = "scripted"
    study: str = ""  #: of people: under another name they are asked anew; where it is empty, planning fills in the
    #: experiment's
    labels: str | None = None  #: the file of answers that `replay` takes: those to the run of `study`
    labels_digest: str | None = None  #: of what is said there; filled in by planning
    beta: Positive | None = None  #: rationality; None is without doubt
    gamma: Annotated[float, Field(gt=0, le=1)] = 1.0  #: below 1 the last steps of a segment weigh most
    mistake: Fraction = 0.0  #: probability of a flipped label
    skip: Weight = 0.0  #: pairs below this share of a typical segment: no label
    equal: Weight = 0.0  #: pairs closer than this share are called equal


class ExplorationConfig(ConfigSection):
    """What happens before the first session, or before the first update where nothing is asked."""

    seed_steps: NonNegative = 1000  #: uniformly random actions
    unsupervised_steps: NonNegative = 0  #: updates on state entropy; 9000 for the baselines, 0 for residual models
    neighbours: Count = 5  #: k of the entropy estimate
    reset_updates: NonNegative = 100  #: updates right after the first session


class EvaluationConfig(ConfigSection):
    """The protocol behind every row of the curve."""

    every: Count = 10_000  #: environment steps; the final step is always evaluated
    episodes: Count = 10
    success: Literal["any", "last"] = "any"  #: success at any step of the episode, or at its last
    deterministic: Literal[True] = True  #: the policy's mode; a sample would draw from a stream of training
