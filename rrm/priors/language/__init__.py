"""Language priors: reward functions that a language model wrote from a task's source, frozen before the run.

(Paper, section 3.2 and appendix "Language rewards".) The paper prints one function, walker-walk's; it is here as
printed. Those of the other tasks are not published: the ones here are stand-ins, as their records say.

A model's code is not trusted: `translate` rebuilds what a small subset of Python allows and refuses the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from rrm.errors import ConfigError, RefusedCodeError
from rrm.files import place
from rrm.priors.language.record import Record, parse_record, read_source
from rrm.priors.language.translate import ENTRY, Admitted, admit
from rrm.priors.language.vocabulary import OUTCOMES, TASK_FEATURES
from rrm.registry import LANGUAGE

if TYPE_CHECKING:
    from rrm.envs.tasks import Task
    from rrm.priors.step import PriorStep

__all__ = ["check", "is_frozen", "language", "load"]

FROZEN = Path(__file__).with_name("frozen")  #: one file a task


def language(step: PriorStep) -> float:
    """The frozen function of the step's task."""
    return _shipped(step.task.name)(step)


language.tasks = frozenset(path.name.removesuffix(LANGUAGE) for path in FROZEN.glob(f"*{LANGUAGE}"))  # type: ignore[attr-defined]


@cache
def _shipped(task: str) -> Callable[[PriorStep], float]:
    return load(f"{FROZEN / task}{LANGUAGE}:{ENTRY}")


def is_frozen(name: str) -> bool:
    """True for `path/to/NAME.language.py:reward`, code that is never run as a module of the user's."""
    return name.rpartition(":")[0].endswith(LANGUAGE)


def load(name: str) -> Callable[[PriorStep], float]:
    """The function in a frozen file, which sees nothing but `PriorStep` and the vocabulary of `words`.

    Raises:
        RefusedCodeError: the code goes beyond the subset.
        ConfigError: the file cannot be read, or holds no record.
    """
    return _admitted(name)[0].function()


def check(name: str, task: Task) -> None:
    """Refuse, without running it, a frozen file that cannot be the prior of this task.

    Raises:
        RefusedCodeError: the code goes beyond the subset.
        ConfigError: it was written for another task, or reads what the task does not reveal.
    """
    admitted, record = _admitted(name)
    if record.task != task.name:
        raise ConfigError(f'prior "{name}" was written for {record.task}, not for {task.name}')
    check_reads(admitted, task)


def check_reads(admitted: Admitted, task: Task) -> None:
    """Refuse code that reads what the task does not reveal.

    Raises:
        ConfigError: with what it does reveal.
    """
    there = {*task.reveals, *task.outcomes}
    hidden = sorted((admitted.reads & {*TASK_FEATURES, *OUTCOMES}) - there)
    if hidden:
        raise ConfigError(
            f"{admitted.where} reads {', '.join(hidden)}, which {task.name} does not reveal; it reveals: "
            f"{', '.join((*task.features, *task.outcomes))}"
        )


def _admitted(name: str) -> tuple[Admitted, Record]:
    location, _, function = name.rpartition(":")
    path = place(location)
    if function != ENTRY:
        raise RefusedCodeError(f'prior "{name}": a language prior is called {ENTRY}, as in {location}:{ENTRY}')
    source = read_source(path)
    return admit(source, str(path)), parse_record(source, path)
