"""The complete description of one run. Its digest is the run's identity.

Nothing here imports torch or a simulator, so that planning ten thousand runs is quick.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypeVar

from pydantic import model_validator

from rrm.config import (
    IMITATION,
    KINDS,
    KNOWN,
    PRIOR_ALONE,
    AnyAgent,
    CameraConfig,
    ConfigSection,
    Count,
    DrqConfig,
    EnvConfig,
    EvaluationConfig,
    ExplorationConfig,
    FeedbackConfig,
    ImitationConfig,
    NonNegative,
    RewardConfig,
    SacConfig,
    TeacherConfig,
)
from rrm.devices import CUDA, DeviceSetting, kind_of
from rrm.envs.spaces import FrameSpace, Spaces
from rrm.envs.tasks import ARM, TASKS, Task, can_vary, task
from rrm.errors import ConfigError, LabelError, UnknownNameError
from rrm.precision import PrecisionSetting
from rrm.priors import check_prior
from rrm.registry import check_file, file_digest, is_file_reference, source_digest
from rrm.rewards import LEARNERS
from rrm.robot.config import DeployConfig
from rrm.teachers.labels import answered_runs, answers_digest

_S = TypeVar("_S", bound=ConfigSection)

#: Raised by one when the same configuration would give other numbers than before.
CONFIG_VERSION = 2

#: Likewise of runs that begin with demonstrations, and thereby of those on the prior they leave.
DEMONSTRATED_VERSION = 2

#: A hundred times the paper's. Each trains on all labels so far, and planning counts them one by one.
_MOST_SESSIONS = 10_000


class JobConfig(ConfigSection, ABC):
    """What every job's configuration tells. Two jobs of equal identity are the same job."""

    kind: ClassVar[Any]  #: its name in `JOBS`

    profile: str = "paper"  #: which scale this is; reports never mix two
    task: str
    seed: NonNegative  #: of all random numbers
    threads: Count = 1  #: of torch; another number may round differently

    if TYPE_CHECKING:  # a setting of some kinds, of others it follows

        @property
        def steps(self) -> int:
            """Environment steps."""

    @property
    @abstractmethod
    def method(self) -> str:
        """Its name in tables."""

    @property
    @abstractmethod
    def requires(self) -> tuple[str, ...]:
        """Identities of the jobs whose results this one starts from."""

    @property
    @abstractmethod
    def identity(self) -> str:
        """Sixteen hex digits that stand for everything that can change its results."""

    @property
    @abstractmethod
    def cell(self) -> str:
        """The identity of all seeds together: what is equal between the jobs one averages over."""

    @abstractmethod
    def canonical(self) -> Self:
        """The same job with everything that cannot change its results at its default, and user files digested."""

    def spec(self) -> Task:
        """The task's description."""
        return task(self.task)

    @property
    def sees_frames(self) -> bool:
        """Whether a camera's pictures are looked at."""
        return self.spec().spaces.frames is not None

    @property
    def needs_opengl(self) -> bool:
        """Whether it can run only where OpenGL draws."""
        return self.sees_frames and self.spec().needs_opengl


class RunConfig(JobConfig):
    """One run. Two runs with equal configurations are the same run."""

    kind: ClassVar[Literal["train"]] = "train"

    steps: Count  #: environment steps
    horizon: Count | None = None  #: steps of an episode where shorter than the task's own
    action_repeat: Count = 1  #: environment steps that an action of the agent lasts; every count of steps is a multiple
    agent: AnyAgent = SacConfig()
    env: EnvConfig = EnvConfig()  #: of tasks whose simulation may vary
    camera: CameraConfig = CameraConfig()  #: of tasks that have one, for agents that see its pictures
    reward: RewardConfig = RewardConfig()
    feedback: FeedbackConfig | None = FeedbackConfig()  #: None where no reward is learned
    teacher: TeacherConfig | None = TeacherConfig()  #: likewise
    exploration: ExplorationConfig = ExplorationConfig()
    imitation: ImitationConfig = ImitationConfig()  #: of runs that learn from demonstrations, and of planning theirs
    evaluation: EvaluationConfig = EvaluationConfig()
    deploy: DeployConfig = DeployConfig()  #: of tasks that an arm does, and of planning what follows
    device: DeviceSetting = "cpu"  #: where networks learn: "cuda", "cuda:1"; "auto" is a card where there is one
    precision: PrecisionSetting = "float32"  #: of products between hidden layers; "auto" is this machine's fastest

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        spec = self.spec()
        if self.precision == "tf32" and kind_of(self.device) != CUDA:
            raise ConfigError('precision: tf32 is a precision of graphics cards; it needs device = "cuda"')
        if self.horizon is not None and self.horizon > spec.horizon:
            raise ConfigError(f"horizon: {self.horizon} steps is longer than {self.task}'s episode of {spec.horizon}")
        can_vary(spec, self.env.ranges())
        self._checkpoints_can_be_deployed()
        self._looks_and_counts()
        names, kind = {*LEARNERS, *KINDS}, self.reward.kind
        if self.reward.learner not in names and not is_file_reference(self.reward.learner):
            raise UnknownNameError("learner", self.reward.learner, names)
        if is_file_reference(self.reward.learner):
            check_file(self.reward.learner, "learner")
        if self.reward.prior is not None:
            if kind.prior == "refused":
                raise ConfigError(f"reward.prior: the learner {self.reward.learner!r} takes no prior")
            check_prior(self.reward.prior, spec)
        elif kind.prior == "needed":
            raise ConfigError('reward.prior: the learner "prior" trains on a prior alone and needs one named')
        if self.reward.options and not is_file_reference(self.reward.learner):
            raise ConfigError(f"reward.options: the learner {self.reward.learner!r} takes none")
        if kind.learned:
            self._feedback_can_be_met()
        elif self.random_steps + 1 >= self.steps:
            section = "imitation" if self.from_demonstrations else "exploration"
            raise ConfigError(
                f"steps: the run ends at {self.steps}, before the first update; "
                f"{section}.seed_steps are {self.random_steps}"
            )
        return self

    def _looks_and_counts(self) -> None:
        """Refuse an agent that sees frames where there are none, and counts of steps that an action does not divide."""
        spec, camera = self.spec(), self.camera
        if self.sees_frames:
            if spec.spaces.frames is None:
                cameras = ", ".join(name for name, each in TASKS.items() if each.spaces.frames)
                raise ConfigError(
                    f"agent.kind: {self.agent.kind} sees frames, {self.task} has none; these have: {cameras}"
                )
            if camera.view is not None and camera.view not in spec.views:
                raise UnknownNameError("view", camera.view, spec.views)
            if self.reward.learner in ("mrn", "finetune"):
                raise ConfigError(f"reward.learner: {self.reward.learner} does not learn from frames")
            if self.reward.kind.learned and self.exploration.unsupervised_steps:
                raise ConfigError("exploration.unsupervised_steps: state entropy is not that of frames; it must be 0")
        for name, steps in self._counted():
            if steps % self.action_repeat:
                raise ConfigError(f"{name}: {steps} is not a multiple of action_repeat, {self.action_repeat}")

    def _checkpoints_can_be_deployed(self) -> None:
        steps, setting = self.deploy.checkpoints, "deploy.checkpoints"
        if not steps:
            return
        if self.spec().suite != ARM:
            there = ", ".join(name for name, each in TASKS.items() if each.suite == ARM)
            raise ConfigError(f"{setting}: an arm has nothing to do in {self.task}; it has in {there}")
        if list(steps) != sorted(set(steps)):
            raise ConfigError(f"{setting}: {', '.join(map(str, steps))} do not rise from one to the next")
        if self.action_repeat > 1:
            raise ConfigError(f"{setting}: an arm is told what to do at every step; action_repeat must be 1")
        if steps[-1] > self.steps:
            raise ConfigError(f"{setting}: {steps[-1]} comes after the run's end at {self.steps}")

    def _counted(self) -> Iterator[tuple[str, int]]:
        """Every count of environment steps that means something to this run."""
        yield from (("steps", self.steps), ("horizon", self.episode_steps), ("evaluation.every", self.evaluation.every))
        yield "exploration.seed_steps", self.random_steps
        if self.reward.kind.learned and self.feedback is not None:
            yield from (("feedback.every", self.feedback.every), ("feedback.segment", self.feedback.segment))
            yield "exploration.unsupervised_steps", self.exploration.unsupervised_steps
        if self.from_demonstrations:
            imitation = self.imitation
            yield from (("imitation.every", imitation.every), ("imitation.window", imitation.window))
            yield "imitation.switch", imitation.switch

    @property
    def sees_frames(self) -> bool:
        """Whether agent and learned reward are shown a camera's pictures."""
        return self.agent.reads == "frames"

    @property
    def spaces(self) -> Spaces:
        """What the agent is told of the task, frames as they are looked at here; none where it does not see them."""
        spaces = self.spec().spaces
        return replace(spaces, frames=looked_at(spaces.frames, self.camera) if self.sees_frames else None)

    @property
    def borrows_encoder(self) -> bool:
        """Whether the agent begins with the encoder of the run behind the prior `imitation`."""
        return isinstance(self.agent, DrqConfig) and (self.agent.encoder or self._usual_encoder) == "imitation"

    @property
    def _usual_encoder(self) -> str:
        return "imitation" if self.reward.prior == IMITATION else "fresh"

    def _feedback_can_be_met(self) -> None:
        if self.feedback is None or self.teacher is None:
            raise ConfigError(f"feedback and teacher: the learner {self.reward.learner!r} needs both")
        if (self.teacher.kind == "replay") is (self.teacher.labels is None):
            raise ConfigError('teacher.labels: a file of answers is what the kind "replay" needs, and no other takes')
        self.check_margin(self.reward.settings.needs().margin)
        self.reward.settings.check(self.feedback.segment, self.agent.update_every)
        if self.from_demonstrations and self.first_session < self.random_steps + self.episode_steps:
            raise ConfigError(
                f"imitation.switch: {self.first_session} comes before an episode beyond the "
                f"{self.random_steps} random steps"
            )
        if self.first_session >= self.steps:
            raise ConfigError(
                f"steps: the run ends at {self.steps}, before the first feedback at {self.first_session} "
                "(random and unsupervised steps, and two complete episodes, come first)"
            )
        steps, every = self.steps - self.first_session, self.feedback.every
        if (most := min(-(-steps // every), self.feedback.budget)) > _MOST_SESSIONS:
            raise ConfigError(f"feedback.every: {most:,} sessions; a run has at most {_MOST_SESSIONS:,}")

    def check_margin(self, margin: int) -> None:
        """Refuse segments that, with `margin` steps more on either side, are longer than an episode."""
        assert self.feedback is not None  # the configuration has checked it
        segment, longer = self.feedback.segment, f" and {margin} more on either side" if margin else ""
        if segment + 2 * margin > self.episode_steps:
            raise ConfigError(
                f"feedback.segment: {segment} steps{longer} do not fit into an episode of {self.episode_steps}"
            )

    @property
    def from_demonstrations(self) -> bool:
        """True for runs that begin with demonstrations, up to `first_session` where preferences follow."""
        return self.reward.kind.demonstrated

    @property
    def asks_people(self) -> bool:
        """Whether it waits for people."""
        return self.reward.kind.learned and self.teacher is not None and self.teacher.kind == "human"

    @property
    def answered(self) -> str:
        """The identity of the run whose queries people answer: this one, or the one whose answers it replays."""
        if self.teacher is None or self.teacher.kind != "replay":
            return self.identity
        live = TeacherConfig(kind="human", study=self.teacher.study)
        return self.model_copy(update={"teacher": live}).identity

    def check_answers(self) -> None:
        """Refuse to replay a file in which nobody answers the run that this one is to repeat."""
        teacher = self.teacher
        if (
            teacher is not None
            and teacher.labels is not None
            and self.answered not in answered_runs(Path(teacher.labels))
        ):
            raise LabelError(
                f"{teacher.labels} has no answers to {self.method} on {self.task} with seed {self.seed} in study "
                f'"{teacher.study}" (run {self.answered}): ask for seeds and methods that it answers, with the profile '
                "and settings of then"
            )

    @property
    def requires(self) -> tuple[str, ...]:
        encoder = getattr(self.agent, "encoder_run", None)
        runs = (self.reward.prior_run, encoder, self.imitation.demos_run)
        return tuple(dict.fromkeys(run for run in runs if run is not None))

    @property
    def episode_steps(self) -> int:
        """Steps of an episode in this run."""
        return self.horizon or task(self.task).horizon

    @property
    def random_steps(self) -> int:
        """Steps of random actions: prolonged where the first session would come before two complete episodes."""
        explore = self.exploration
        if self.from_demonstrations:
            return self.imitation.seed_steps
        if not self.reward.kind.learned:
            return explore.seed_steps
        return max(explore.seed_steps, 2 * self.episode_steps - explore.unsupervised_steps)

    @property
    def first_session(self) -> int:
        """The step before which the first feedback is given."""
        if self.from_demonstrations:
            return self.imitation.switch
        return self.random_steps + self.exploration.unsupervised_steps

    @property
    def method(self) -> str:
        """The method's name in tables: oracle, pebble, rrm-proxy, rrm-surf-proxy, sac-proxy."""
        learner, prior = _short(self.reward.learner), _short(self.reward.prior or "")
        if self.reward.kind is KNOWN:
            return "oracle"
        if self.reward.kind is PRIOR_ALONE:
            return f"{self.agent.kind}-{prior}"
        if not prior:
            return learner
        return f"rrm-{prior}" if learner == "pebble" else f"rrm-{learner}-{prior}"

    def canonical(self) -> Self:
        reward, explore = self.reward, self.exploration
        changes: dict[str, Any] = {"imitation": self._canonical_imitation(), "device": kind_of(self.device)}
        changes["deploy"] = _defaulted(self.deploy, "episodes", "rig")
        if reward.prior != IMITATION:
            reward = _defaulted(reward, "prior_run", "squash")
        if not reward.kind.learned:
            keep = {PRIOR_ALONE: ("prior", "normaliser", "prior_run", "squash"), KNOWN: ("factor",)}
            kept = {name: getattr(reward, name) for name in ("learner", *keep.get(reward.kind, ()))}
            reward = RewardConfig(**kept)
            changes |= {"feedback": None, "teacher": None}
            changes["exploration"] = ExplorationConfig(seed_steps=explore.seed_steps)
        else:
            reward = _defaulted(reward, "factor", *_idle(reward))
            if self.feedback is not None and self.feedback.sampler == "uniform":
                changes["feedback"] = _defaulted(self.feedback, "pool")
            if not explore.unsupervised_steps:
                explore = _defaulted(explore, "neighbours")
            changes["exploration"] = explore.model_copy(update={"seed_steps": self.random_steps})
            changes["teacher"] = self._canonical_teacher()
        if self.from_demonstrations:
            changes["exploration"] = ExplorationConfig()
            reward = _defaulted(reward, "members", "hidden", "layers", "inputs")
        digests = {"learner_digest": source_digest(reward.learner)}
        if reward.prior is not None:
            digests["prior_digest"] = source_digest(reward.prior)
        changes["reward"] = reward.model_copy(update=digests)
        if self.horizon == TASKS[self.task].horizon:
            changes["horizon"] = None
        changes |= {"camera": self._canonical_camera(), "env": self._canonical_env()}
        if isinstance(self.agent, DrqConfig) and self.agent.encoder == self._usual_encoder:
            changes["agent"] = _defaulted(self.agent, "encoder")
        return self.model_copy(update=changes)

    def _canonical_teacher(self) -> TeacherConfig | None:
        teacher = self.teacher
        if teacher is None or teacher.kind == "scripted":
            return teacher and _defaulted(teacher, "study")
        digest = None if teacher.labels is None else answers_digest(Path(teacher.labels))
        return TeacherConfig(kind=teacher.kind, study=teacher.study, labels=teacher.labels, labels_digest=digest)

    def _canonical_env(self) -> EnvConfig:
        usual = self.spec().physics
        ranges = self.env.ranges().items()
        return _defaulted(self.env, *(name for name, ends in ranges if set(ends) == {getattr(usual, name)}))

    def _canonical_camera(self) -> CameraConfig:
        own, camera = self.spec().spaces.frames, self.camera
        if own is None or not self.sees_frames:
            return CameraConfig()
        as_it_is = {"view": own.view, "size": own.height, "stack": own.stack}
        return _defaulted(camera, *(name for name, value in as_it_is.items() if getattr(camera, name) == value))

    def _canonical_imitation(self) -> ImitationConfig:
        """What matters of the section to this run itself; what matters to those it requires is in their identities."""
        imitation = self.imitation
        if not self.from_demonstrations:
            return ImitationConfig()
        imitation = _defaulted(imitation, "steps", "episodes", "expert_success", "demos_digest")
        if not self.reward.kind.learned:
            imitation = _defaulted(imitation, "switch")
        if imitation.pretrain == "mse":  # no density is asked for
            imitation = _defaulted(imitation, "uniform")
        if imitation.demos is not None:
            digest = file_digest(Path(imitation.demos), "imitation.demos")
            imitation = imitation.model_copy(update={"demos_digest": digest, "demos_run": None})
        return imitation

    @property
    def identity(self) -> str:
        """Values equal to their default are left out, so that a new setting whose default changes nothing keeps the
        identities of runs made before it existed; a default that changes numbers raises `CONFIG_VERSION`.
        """
        return self._digest(exclude=set())

    @property
    def cell(self) -> str:
        return self._digest(exclude={"seed"})

    def _digest(self, exclude: set[str]) -> str:
        described = self.canonical().model_dump(mode="json", exclude_defaults=True, exclude=exclude)
        for key in ("prior", "learner"):  # a user's file is known by its content, wherever it lies
            name = described.get("reward", {}).get(key)
            if name is not None and is_file_reference(name):
                described["reward"][key] = name.rpartition(":")[2]
        for section, file in (("imitation", "demos"), ("teacher", "labels")):  # likewise
            (described.get(section) or {}).pop(file, None)
        if self.from_demonstrations:
            described.setdefault("imitation", {})["version"] = DEMONSTRATED_VERSION
        text = json.dumps({"version": CONFIG_VERSION, **described}, sort_keys=True, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def sessions(self) -> int:
        """Feedback sessions that fit into the run at its budget; 0 where nothing is learned."""
        return len(self._session_sizes())

    def queries(self) -> int:
        """Queries that are put in all sessions together: the budget, or fewer where the run ends before it is spent."""
        return sum(self._session_sizes())

    def _session_sizes(self) -> list[int]:
        sizes: list[int] = []
        if not self.reward.kind.learned or self.feedback is None:
            return sizes
        queries = 0
        for step in range(self.first_session, self.steps, self.feedback.every):
            if queries >= self.feedback.budget:
                break
            sizes.append(self.feedback.session_size(step, self.steps, queries))
            queries += sizes[-1]
        return sizes


def looked_at(own: FrameSpace | None, camera: CameraConfig) -> FrameSpace | None:
    """A task's own frames as `camera` looks at them."""
    if own is None:
        return None
    height, width = (camera.size, camera.size) if camera.size else (own.height, own.width)
    view, stack = camera.view or own.view, camera.stack or own.stack
    return replace(own, height=height, width=width, view=view, stack=stack, quality=camera.quality)


def _idle(reward: RewardConfig) -> Iterator[str]:
    """Settings that mean nothing to how this reward is learned. A user's learner may be told anything."""
    if reward.prior is None:  # the squared penalty, too, is the distance from a prior
        yield from ("normaliser", "bound", "penalty")
    if reward.bound == "tanh":
        yield "penalty"
    if not is_file_reference(reward.learner):
        yield from (name for name in reward.own() if name != reward.learner)
    yield from reward.settings.ignores


def _defaulted(section: _S, *fields: str) -> _S:
    return section.model_copy(update={field: type(section).model_fields[field].default for field in fields})


def _short(name: str) -> str:
    return name.rpartition(":")[2] if is_file_reference(name) else name
