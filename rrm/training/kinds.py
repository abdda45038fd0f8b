"""The kinds of job that a process can be given. No torch is imported here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from rrm.errors import UnknownNameError
from rrm.registry import lookup

if TYPE_CHECKING:
    from rrm.envs.tasks import Task


class JobConfig(Protocol):
    """What every job's configuration tells; a frozen pydantic model. Two jobs of equal identity are the same job."""

    kind: ClassVar[Any]  #: its name in `JOBS`

    @property
    def profile(self) -> str:
        """Which scale this is."""

    @property
    def task(self) -> str:
        """The task's name."""

    @property
    def seed(self) -> int:
        """Of all random numbers."""

    @property
    def threads(self) -> int:
        """Of torch."""

    @property
    def steps(self) -> int:
        """Environment steps."""

    @property
    def method(self) -> str:
        """Its name in tables."""

    @property
    def requires(self) -> tuple[str, ...]:
        """Identities of the jobs whose results this one starts from."""

    @property
    def identity(self) -> str:
        """Sixteen hex digits that stand for everything that can change its results."""

    @property
    def cell(self) -> str:
        """The identity of all seeds together."""

    def canonical(self) -> JobConfig:
        """The same job with everything that cannot change its results at its default."""

    def spec(self) -> Task:
        """The task's description."""

    def model_dump(self, *, mode: str = "python") -> dict[str, Any]:
        """All of it as plain values."""


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
