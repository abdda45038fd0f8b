"""Calling a prior that somebody else wrote, and saying clearly what went wrong with it."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from itertools import takewhile
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrm.errors import PriorError

if TYPE_CHECKING:
    from rrm.priors.step import PriorStep

_LARGEST = 3.4e38  # of a float32
_GUARDS = str(Path(__file__).with_name("language") / "guards.py")  # stand between a model's code and its arithmetic


def evaluate_prior(prior: Callable[[PriorStep], float], step: PriorStep, where: str) -> float:
    """The prior's value of this step.

    Args:
        prior: of ours or of a user's.
        step: what it may look at.
        where: which prior and which step, for the message, such as `prior "proxy" at step 17`.

    Raises:
        PriorError: it raised (the cause is chained), or returned something other than one finite number.
    """
    try:
        value = prior(step)
    except PriorError as error:
        raise PriorError(f"{where}: {error}") from error
    except (Exception, SystemExit) as error:
        raise PriorError(f"{where} raised {type(error).__name__}: {error}{_line(error)}") from error
    number = _number(value)
    if number is None:
        raise PriorError(f"{where} returned {_shown(value)}; a prior returns one number per step")
    if not abs(number) <= _LARGEST:
        raise PriorError(f"{where} returned {number}; a prior returns a finite number that fits into a float32")
    return number


def _number(value: Any) -> float | None:
    """The number that a Python number, a numpy scalar or an array without axes stands for; None for anything else."""
    if getattr(value, "shape", None) == ():
        value = value.item()
    return float(value) if isinstance(value, Real) else None


def _shown(value: Any) -> str:
    shape = getattr(value, "shape", None)
    described = type(value).__name__ if shape is None else f"{type(value).__name__} of shape {tuple(shape)}"
    text = " ".join(repr(value).split())  # arrays are printed over several lines
    return f"{text if len(text) <= 60 else text[:57] + '...'} ({described})"


def _line(error: BaseException) -> str:
    frames = list(takewhile(lambda frame: frame.filename != _GUARDS, traceback.extract_tb(error.__traceback__)[1:]))
    return f" ({frames[-1].filename}, line {frames[-1].lineno})" if frames else ""
