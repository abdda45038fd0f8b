"""The kinds of job that a process can be given: training a policy, collecting demonstrations of one, deploying one.

No torch is imported here.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

from pydantic import model_validator

from rrm.config import CameraConfig, Count, Fraction, NonNegative
from rrm.envs.spaces import FrameSpace
from rrm.errors import ConfigError
from rrm.precision import Precision, PrecisionSetting
from rrm.robot.config import RigConfig
from rrm.training.run_config import CONFIG_VERSION, JobConfig, RunConfig, looked_at

#: In the folder of a run: its final networks, and those of steps before.
MODEL = "model.safetensors"
_KEPT = "networks"


def kept_networks(step: int, steps: int) -> str:
    """Where in its folder a run of so many steps leaves the networks of a step that it is to keep."""
    return MODEL if step == steps else f"{_KEPT}/{step}.safetensors"


class DemosConfig(JobConfig):
    """Episodes of a trained policy, played deterministically (appendix "Imitation rewards")."""

    kind: ClassVar[Literal["demos"]] = "demos"

    seed: NonNegative = 0  #: of the instances that are played
    expert: RunConfig  #: the run whose policy plays
    episodes: Count = 50
    camera: CameraConfig | None = None  #: where its pictures are part of them
    least_success: Fraction = 0.8  #: share of the episodes that must succeed, where the task has that notion
    precision: Precision = "float32"

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.expert.task != (self.spec().expert or self.task):
            raise ConfigError(f"expert.task: an expert of {self.expert.task} shows nothing of {self.task}")
        return self

    @property
    def sees_frames(self) -> bool:
        return self.camera is not None

    @property
    def frames(self) -> FrameSpace | None:
        """What is seen of the task; None where nobody looks."""
        return None if self.camera is None else looked_at(self.spec().spaces.frames, self.camera)

    @property
    def method(self) -> str:
        return "demos"

    @property
    def steps(self) -> int:
        """Environment steps of all episodes together, were none to end early."""
        return self.episodes * self.expert.episode_steps

    @property
    def requires(self) -> tuple[str, ...]:
        return (self.expert.identity,)

    def canonical(self) -> Self:
        return self.model_copy(update={"expert": self.expert.canonical()})

    @property
    def identity(self) -> str:
        return digest(self, {"expert"}, expert=self.expert.identity)

    @property
    def cell(self) -> str:
        """Demonstrations are averaged with nothing: their own identity."""
        return self.identity


class DeploymentConfig(JobConfig):
    """Episodes of a run's kept policies at the simulated workplace (section "Real world experiments", Tab. realiqm)."""

    kind: ClassVar[Literal["deploy"]] = "deploy"

    policy: RunConfig  #: the run whose policies play
    episodes: Count = 20  #: of each
    rig: RigConfig = RigConfig()
    precision: PrecisionSetting = "float32"  #: the run's

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.checkpoints:
            raise ConfigError("policy.deploy.checkpoints: a run that keeps no networks has none to deploy")
        for name in ("task", "seed", "precision"):
            if getattr(self, name) != getattr(self.policy, name):
                raise ConfigError(f"{name}: {getattr(self, name)} is not the policy's, {getattr(self.policy, name)}")
        return self

    @property
    def checkpoints(self) -> tuple[int, ...]:
        """The environment steps whose policies play, rising."""
        return self.policy.deploy.checkpoints

    @property
    def method(self) -> str:
        return f"{self.policy.method} deployed"

    @property
    def steps(self) -> int:
        """Of the last policy: a row of the curve is what one of them is worth, at the step that it comes from."""
        return self.checkpoints[-1]

    @property
    def requires(self) -> tuple[str, ...]:
        return (self.policy.identity,)

    def canonical(self) -> Self:
        return self.model_copy(update={"policy": self.policy.canonical()})

    @property
    def identity(self) -> str:
        return digest(self, {"policy"}, policy=self.policy.identity)

    @property
    def cell(self) -> str:
        return digest(self, {"policy", "seed"}, policy=self.policy.cell)


def digest(config: JobConfig, exclude: set[str], **replaced: str) -> str:
    """An identity: of the settings that differ from their defaults, without some, and with what stands for those."""
    described = config.model_dump(mode="json", exclude_defaults=True, exclude=exclude)
    described |= {"version": CONFIG_VERSION, "kind": config.kind, **replaced}
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True)
class JobKind:
    """One kind."""

    config: type[Any]  #: the class of its configurations, which offers what a `JobConfig` does
    perform: str  #: dotted path of `(config, folder, monitor, results) -> finished`; see `rrm.training.jobs`


#: Every kind by its name.
JOBS = {
    "train": JobKind(RunConfig, "rrm.training.jobs:train"),
    "demos": JobKind(DemosConfig, "rrm.training.jobs:collect"),
    "deploy": JobKind(DeploymentConfig, "rrm.training.deployments:deploy_kept"),
}
