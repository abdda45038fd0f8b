"""What the words of a language prior do when its code runs.

All that these functions are given has passed `checked`, and so does all that they give: numbers and small arrays of
numbers, never Python integers without limit, objects or texts. They change nothing that they are given.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from rrm.priors.language.vocabulary import CONSTANTS, PLAIN_MATH, PLAIN_NUMPY, VALUE
from rrm.priors.step import Scene

#: Numbers of an array, at the most, and its axes; the longest observation has 78 entries.
LARGEST, MOST_AXES = 1024, 2
_ITEMS = (float, int, np.ndarray, np.generic)  # of a row; an integer is a loop's counter


def namespace() -> dict[str, Any]:
    """The globals of translated code: the vocabulary, and no builtins."""
    return {"__builtins__": {}, **CONSTANTS, **FUNCTIONS, **OPERATIONS, VALUE: checked}


def checked(value: Any) -> Any:
    """The value of any expression, unless code must not go on with it: a number, a small array, a flat row, a step.

    Raises:
        ValueError: an array is too large.
        TypeError: it is something else, or a row holds more than numbers and arrays and so could nest without end.
    """
    if isinstance(value, float):
        return value
    if isinstance(value, np.ndarray):
        if value.size > LARGEST or value.ndim > MOST_AXES:
            raise ValueError(f"an array of shape {value.shape}; {LARGEST} numbers along {MOST_AXES} axes are the most")
        return value
    if isinstance(value, int):
        return float(value)  # Python's unbounded integers end here
    if isinstance(value, tuple):
        for item in value:
            if not isinstance(item, _ITEMS):
                raise TypeError(f"a {type(item).__name__} inside a tuple or list; numbers and arrays can stand there")
        return value
    if isinstance(value, np.generic | Scene):
        return value
    raise TypeError(f"a {type(value).__name__} is no number, array or row of them")


def number(value: Any) -> Any:
    """An operand: arrays as they are, everything else as a float."""
    return value if isinstance(value, float | np.ndarray) else float(value)


def _operation(call: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda left, right: call(number(left), number(right))


def _plain(value: Any) -> Any:
    """An argument of numpy's: rows become arrays of floats."""
    return checked(np.array(value, dtype=np.float64)) if isinstance(value, tuple) else number(value)


def _of_numpy(call: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *given, **options: call(*map(_plain, given), **{name: _plain(options[name]) for name in options})


def _of_floats(call: Callable[..., Any]) -> Callable[..., float]:
    return lambda *given: float(call(*map(float, given)))


def _array(value: Any) -> Any:
    return np.array(value, dtype=np.float64)


def _clip(value: Any, a_min: Any, a_max: Any) -> Any:
    return np.clip(value, a_min, a_max)


def _norm(value: Any, ord: Any = None) -> Any:
    return np.linalg.norm(value, ord)


def _floats(given: tuple[Any, ...]) -> list[float]:
    """The numbers of `max(a, b)` or of `max((a, b))`."""
    values = given[0] if len(given) == 1 and isinstance(given[0], tuple | np.ndarray) else given
    return [float(value) for value in values]


#: What `words.FUNCTIONS` stand for.
FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **{f"numpy.{name}": _of_numpy(getattr(np, name)) for names in PLAIN_NUMPY.values() for name in names.split()},
    **{f"math.{name}": _of_floats(getattr(math, name)) for names in PLAIN_MATH.values() for name in names.split()},
    "numpy.array": _of_numpy(_array),
    "numpy.asarray": _of_numpy(_array),
    "numpy.float64": float,
    "numpy.power": _operation(operator.pow),
    "numpy.clip": _of_numpy(_clip),
    "numpy.linalg.norm": _of_numpy(_norm),
    "math.dist": lambda first, second: math.dist(_floats((first,)), _floats((second,))),
    "math.hypot": lambda *given: math.hypot(*_floats(given)),
    "abs": lambda value: abs(number(value)),
    "float": float,
    "max": lambda *given: max(_floats(given)),
    "min": lambda *given: min(_floats(given)),
    "sum": lambda values: sum(_floats((values,)), 0.0),
}

#: What `words.OPERATORS` stand for, under names that no code can spell.
OPERATIONS: Mapping[str, Callable[[Any, Any], Any]] = {
    "operator Add": _operation(operator.add),
    "operator Sub": _operation(operator.sub),
    "operator Mult": _operation(operator.mul),
    "operator Div": _operation(operator.truediv),
    "operator FloorDiv": _operation(operator.floordiv),
    "operator Mod": _operation(operator.mod),
    "operator Pow": _operation(operator.pow),
}
