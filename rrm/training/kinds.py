"""The kinds of job that a process can be given: training a policy, or collecting demonstrations of one.

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
from rrm.precision import Precision
from rrm.training.run_config import CONFIG_VERSION, JobConfig, RunConfig, looked_at


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
        described = self.model_dump(mode="json", exclude_defaults=True, exclude={"expert"})
        described |= {"version": CONFIG_VERSION, "kind": self.kind, "expert": self.expert.identity}
        return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:16]

    @property
    def cell(self) -> str:
        """Demonstrations are averaged with nothing: their own identity."""
        return self.identity


@dataclass(frozen=True)
class JobKind:
    """One kind."""

    config: type[Any]  #: the class of its configurations, which offers what a `JobConfig` does
    perform: str  #: dotted path of `(config, folder, monitor, results) -> finished`; see `rrm.training.jobs`


#: Every kind by its name.
JOBS = {
    "train": JobKind(RunConfig, "rrm.training.jobs:train"),
    "demos": JobKind(DemosConfig, "rrm.training.jobs:collect"),
}
