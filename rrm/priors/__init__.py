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
from rrm.priors import language
from rrm.registry import check_file, is_file_reference, lookup

if TYPE_CHECKING:
    from rrm.priors.step import PriorStep

#: Priors by name; a user's own is named `path/to/file.py:function`.
PRIORS: dict[str, str] = {
    "proxy": "rrm.priors.proxy:proxy",
    "o2g": "rrm.priors.proxy:o2g",
    "h2o": "rrm.priors.proxy:h2o",
    "1d": "rrm.priors.proxy:one_dimension",
    "sparse": "rrm.priors.proxy:sparse",
    "zero": "rrm.priors.proxy:zero",
    "opposite": "rrm.priors.proxy:opposite",
    "random": "rrm.priors.proxy:random",
    "penalty": "rrm.priors.corridor:penalty",
    "language": "rrm.priors.language:language",
    IMITATION: "rrm.priors.imitation:ImitationPrior",  # made by a run of its own, see `rrm.training.build`
}


def load_prior(name: str) -> Callable[[PriorStep], float]:
    """The prior of this name, or the function in a user's file; an `RrmError` where there is none that can run."""
    if language.is_frozen(name):
        return language.load_frozen(name)
    prior: Any = lookup(PRIORS, "prior", name)
    if not callable(prior):
        raise PriorError(f"prior {name!r} is a {type(prior).__name__}; a prior is a function of one PriorStep")
    function: Callable[[PriorStep], float] = prior
    return function


def check_prior(name: str, task: Task) -> None:
    """Refuse, before a run, a prior that is unknown or reads what the task does not reveal.

    A file of the user's must hold the prior; it is not run here but at the start of the run, in the run's own process.
    A frozen language prior must be within its subset and be written for the task.
    """
    if language.is_frozen(name):
        language.check_frozen(name, task)
    elif is_file_reference(name):
        check_file(name, "prior")
    elif name not in PRIORS:
        if ".py" in name:
            raise ConfigError(f"prior {name!r}: a prior of your own is named path/to/file.py:function")
        raise UnknownNameError("prior", name, PRIORS)
    elif refusal := _refusal(name, task):
        suited = ", ".join(prior for prior in sorted(PRIORS) if not _refusal(prior, task))
        raise ConfigError(f'prior "{name}" {refusal}. Priors for {task.name}: {suited}')


def _refusal(name: str, task: Task) -> str | None:
    """Why a prior of ours cannot serve the task; None where it can."""
    prior = lookup(PRIORS, "prior", name)
    if hasattr(prior, "tasks"):
        return None if task.name in prior.tasks else f"has no function for {task.name}"
    if any(set(names) <= set(task.reveals) for names in prior.needs):
        return None
    reads = " or ".join(", ".join(names) for names in prior.needs)
    return f"reads {reads}, which {task.name} does not reveal; it reveals: {', '.join(task.reveals)}"
