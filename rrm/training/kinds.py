"""The kinds of job that a process can be given, and what all their configurations tell. No torch is imported here."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

from rrm.config import ConfigSection, Count, NonNegative
from rrm.envs.tasks import Task, task
from rrm.errors import UnknownNameError
from rrm.registry import lookup


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
        """The same job with everything that cannot change its results at its default, and user files digested.

        Raises:
            ConfigError: a file of the user's cannot be read.
        """

    def spec(self) -> Task:
        """The task's description."""
        return task(self.task)


@dataclass(frozen=True)
class JobKind:
    """One kind, by dotted paths."""

    config: str  #: of the class of its configurations, a `JobConfig`; importing it needs no torch
    perform: str  #: of `(config, folder, monitor, results) -> finished`, which does it; see `rrm.training.jobs`


#: Every kind by its name.
JOBS = {
    "train": JobKind("rrm.training.run_config:RunConfig", "rrm.training.jobs:train"),
    "demos": JobKind("rrm.training.demos_config:DemosConfig", "rrm.training.jobs:collect"),
}


def config_class(kind: str) -> Any:
    """The class of a kind's configurations.

    Raises:
        UnknownNameError: there is no such kind.
    """
    if kind not in JOBS:
        raise UnknownNameError("kind of job", kind, JOBS)
    return lookup({kind: JOBS[kind].config}, "kind of job", kind)
