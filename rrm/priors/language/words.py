"""The whole vocabulary of a language prior: what `translate` lets pass, and what it stands for when the code runs.

Every function here is bounded: it takes and gives numbers and small arrays of numbers, never Python integers without
limit, objects or text, and changes nothing that it is given. Nothing else of Python or numpy can be named.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

#: Numbers of an array, at the most, and its axes; the longest observation has 78 entries.
LARGEST, MOST_AXES = 1024, 2

#: What may be read of a step, and of `step.first`. Neither outcome flags nor `info`, where simulators put rewards.
TASK_FEATURES = ("hand", "object", "goal", "upright", "clearance")
OUTCOMES = ("torso_upright", "torso_height", "forward_velocity")
ACCESSORS = frozenset({*TASK_FEATURES, *OUTCOMES, "obs", "act", "first"})

CONSTANTS: Mapping[str, float] = {
    **{f"{module}.{name}": getattr(math, name) for module in ("math", "numpy") for name in ("pi", "e", "inf")},
    "math.tau": math.tau,
}


class Function(NamedTuple):
    """Something that can be called, and how."""

    call: Callable[..., Any]
    most: int  #: positional arguments, so that no `out=` is reached by position
    keywords: frozenset[str] = frozenset()


def small(value: Any) -> Any:
    """The value itself, unless it is an array too large to go on with."""
    if isinstance(value, np.ndarray) and (value.size > LARGEST or value.ndim > MOST_AXES):
        raise ValueError(f"an array of shape {value.shape}; {LARGEST} numbers along {MOST_AXES} axes are the most")
    return value


def number(value: Any) -> Any:
    """An operand: arrays as they are, everything else as a float. Python's unbounded integers end here."""
    return value if isinstance(value, float | np.ndarray) else float(value)


def row(*items: Any) -> tuple[Any, ...]:
    """A tuple or list that was written out: of numbers and arrays, never of rows, which could nest without end."""
    for item in items:
        if not isinstance(item, float | int | np.generic | np.ndarray):
            raise TypeError(f"a {type(item).__name__} inside a tuple or list; numbers and arrays can stand there")
    return items


def _operation(call: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda left, right: small(call(number(left), number(right)))


def _plain(value: Any) -> Any:
    """An argument of numpy's: rows become arrays of floats."""
    return np.array(value, dtype=np.float64) if isinstance(value, tuple) else number(value)


def _of_numpy(call: Callable[..., Any]) -> Callable[..., Any]:
    def bounded(*given: Any, **options: Any) -> Any:
        return small(call(*map(_plain, given), **{name: _plain(value) for name, value in options.items()}))

    return bounded


def _of_floats(call: Callable[..., Any]) -> Callable[..., float]:
    return lambda *given: float(call(*map(float, given)))


def _array(value: Any) -> Any:
    return np.array(value, dtype=np.float64)


def _floats(given: tuple[Any, ...]) -> list[float]:
    """The numbers of `max(a, b)` or of `max((a, b))`."""
    values = given[0] if len(given) == 1 and isinstance(given[0], tuple | np.ndarray) else given
    return [float(value) for value in values]


def _clip(value: Any, a_min: Any, a_max: Any) -> Any:
    return np.clip(value, a_min, a_max)


def _norm(value: Any, ord: Any = None) -> Any:
    return np.linalg.norm(value, ord)


_ONE = (
    "abs absolute arccos arcsin arctan cos cosh deg2rad exp expm1 fabs isfinite isnan log log10 log1p log2 "
    "max mean min rad2deg sign sin sinh sqrt square std sum tan tanh"
)
_TWO = "arctan2 cross dot hypot maximum minimum"
_MATH_ONE = (
    "acos asin atan cos cosh degrees exp expm1 fabs isfinite log log10 log1p log2 radians sin sinh sqrt tan tanh"
)
_MATH_TWO = "atan2 copysign fmod pow"

#: Everything that can be called besides the code's own functions.
FUNCTIONS: Mapping[str, Function] = {
    **{f"numpy.{name}": Function(_of_numpy(getattr(np, name)), 1) for name in _ONE.split()},
    **{f"numpy.{name}": Function(_of_numpy(getattr(np, name)), 2) for name in _TWO.split()},
    **{f"math.{name}": Function(_of_floats(getattr(math, name)), 1) for name in _MATH_ONE.split()},
    **{f"math.{name}": Function(_of_floats(getattr(math, name)), 2) for name in _MATH_TWO.split()},
    "numpy.array": Function(_of_numpy(_array), 1),
    "numpy.asarray": Function(_of_numpy(_array), 1),
    "numpy.float64": Function(float, 1),
    "numpy.power": Function(_operation(operator.pow), 2),
    "numpy.where": Function(_of_numpy(np.where), 3),
    "numpy.clip": Function(_of_numpy(_clip), 3, frozenset({"a_min", "a_max"})),
    "numpy.linalg.norm": Function(_of_numpy(_norm), 2, frozenset({"ord"})),
    "math.dist": Function(lambda a, b: math.dist(_floats((a,)), _floats((b,))), 2),
    "math.hypot": Function(lambda *given: math.hypot(*_floats(given)), 8),
    "abs": Function(lambda value: abs(number(value)), 1),
    "float": Function(float, 1),
    "max": Function(lambda *given: max(_floats(given)), 32),
    "min": Function(lambda *given: min(_floats(given)), 32),
    "sum": Function(lambda *given: sum(_floats(given), 0.0), 1),
}

#: Operators by the name of their syntax node, and the name under which the translated code finds them.
OPERATORS: Mapping[str, Callable[[Any, Any], Any]] = {
    "Add": _operation(operator.add), "Sub": _operation(operator.sub), "Mult": _operation(operator.mul),
    "Div": _operation(operator.truediv), "FloorDiv": _operation(operator.floordiv),
    "Mod": _operation(operator.mod), "Pow": _operation(operator.pow),
}  # fmt: skip


def namespace() -> dict[str, Any]:
    """The globals of translated code: this vocabulary, and no builtins."""
    return {
        "__builtins__": {},
        **CONSTANTS,
        **{name: function.call for name, function in FUNCTIONS.items()},
        **{f"operator {name}": call for name, call in OPERATORS.items()},
        "row": row,
    }
