"""Prior rewards: what is known of a task before any preference. No torch is imported here.

A prior is a function of one `rrm.priors.step.PriorStep` that returns a number. It is a pure function: whatever it
remembered from step to step would be lost when a run is resumed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from rrm.config import IMITATION
from rrm.envs.tasks import Task
from rrm.errors import ConfigError, PriorError, UnknownNameError
from rrm.priors.evaluate import evaluate_prior
from rrm.registry import check_file, is_file_reference, lookup

if TYPE_CHECKING:
    from rrm.priors.step import PriorStep

__all__ = ["PRIORS", "check_prior", "evaluate_prior", "load_prior"]

#: Priors by name; a user's own is named `path/to/file.py:function`.
PRIORS: dict[str, str] = {
    "proxy": "rrm.priors.proxy:proxy",
    "o2g": "rrm.priors.proxy:o2g",
    "h2o": "rrm.priors.proxy:h2o",
    "sparse": "rrm.priors.proxy:sparse",
    "zero": "rrm.priors.proxy:zero",
    "opposite": "rrm.priors.proxy:opposite",
    "random": "rrm.priors.proxy:random",
    IMITATION: "rrm.priors.imitation:ImitationPrior",  # made by a run of its own, see `rrm.training.build`
}


def load_prior(name: str) -> Callable[[PriorStep], float]:
    """The prior of this name, or the function in a user's file.

    Raises:
        UnknownNameError, ConfigError: no such prior, file or function, or the file does not import.
        PriorError: what the file holds under that name cannot be called.
    """
    prior: Any = lookup(PRIORS, "prior", name)
    if not callable(prior):
        raise PriorError(f"prior {name!r} is a {type(prior).__name__}; a prior is a function of one PriorStep")
    function: Callable[[PriorStep], float] = prior
    return function


def check_prior(name: str, task: Task) -> None:
    """Refuse, before a run, a prior that is unknown or reads what the task does not reveal.

    A file of the user's must hold the prior; it is not run here but at the start of the run, in the run's own process.

    Raises:
        UnknownNameError, ConfigError: with what is known, or what is missing and what would do.
    """
    if is_file_reference(name):
        check_file(name, "prior")
        return
    if name not in PRIORS:
        if ".py" in name:
            raise ConfigError(f"prior {name!r}: a prior of your own is named path/to/file.py:function")
        raise UnknownNameError("prior", name, PRIORS)
    if not _suits(name, task):
        wanted = " or ".join(", ".join(names) for names in _needs(name))
        raise ConfigError(
            f'prior "{name}" reads {wanted}, which {task.name} does not reveal; it reveals: {", ".join(task.reveals)}. '
            f"Priors for {task.name}: {', '.join(known for known in sorted(PRIORS) if _suits(known, task))}"
        )


def _needs(name: str) -> tuple[tuple[str, ...], ...]:
    declared: tuple[tuple[str, ...], ...] = lookup(PRIORS, "prior", name).needs
    return declared


def _suits(name: str, task: Task) -> bool:
    return any(set(names) <= set(task.reveals) for names in _needs(name))
