"""What the words of a language prior do when its code runs.

All that these functions are given has passed `checked_value`, and so does all that they give: numbers and small arrays
of numbers, never Python integers without limit, objects or texts. They change nothing that they are given.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from rrm.priors.language.vocabulary import CONSTANTS, OPERATORS, SIGNATURES, VALUE
from rrm.priors.step import Scene

#: Numbers of an array, at the most, and its axes; the longest observation has 78 entries.
LARGEST, MOST_AXES = 1024, 2
_ROWS = (tuple, np.ndarray)
_ITEMS = (float, int, np.ndarray, np.generic)  # of a row; an integer is a loop's counter


def namespace() -> dict[str, Any]:
    """The globals of translated code: the vocabulary, and no builtins."""
    return {"__builtins__": {}, **CONSTANTS, **FUNCTIONS, **OPERATIONS, VALUE: checked_value}


def checked_value(value: Any) -> Any:
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
    elif isinstance(value, int):
        return float(value)  # Python's unbounded integers end here
    elif isinstance(value, tuple):
        for item in value:
            if not isinstance(item, _ITEMS):
                raise TypeError(f"a {type(item).__name__} inside a tuple or list; numbers and arrays can stand there")
    elif not isinstance(value, np.generic | Scene):
        raise TypeError(f"a {type(value).__name__} is no number, array or row of them")
    return value


def _number(value: Any) -> Any:
    """An operand: arrays as they are, everything else as a float."""
    return value if isinstance(value, float | np.ndarray) else float(value)


def _operation(call: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
    return lambda left, right: call(_number(left), _number(right))


def _array(value: Any) -> Any:
    """An argument of numpy's: rows become arrays of floats."""
    return checked_value(np.array(value, dtype=np.float64)) if isinstance(value, tuple) else _number(value)


def _of_numpy(call: Callable[..., Any]) -> Callable[..., Any]:
    return lambda *values, **options: call(*map(_array, values), **{name: _array(options[name]) for name in options})


def _of_floats(call: Callable[..., Any]) -> Callable[..., float]:
    return lambda *values: float(call(*map(float, values)))


def _clip(value: Any, a_min: Any, a_max: Any) -> Any:
    return np.clip(value, a_min, a_max)


def _floats(values: tuple[Any, ...]) -> list[float]:
    """The numbers of `max(a, b)` or of `max((a, b))`."""
    return [float(value) for value in (values[0] if len(values) == 1 and isinstance(values[0], _ROWS) else values)]


_OWN: Mapping[str, Callable[..., Any]] = {
    **dict.fromkeys(("numpy.array", "numpy.asarray"), _of_numpy(partial(np.array, dtype=np.float64))),
    "numpy.float64": float,
    "numpy.power": _operation(operator.pow),
    "numpy.clip": _of_numpy(_clip),
    "numpy.linalg.norm": _of_numpy(np.linalg.norm),
    "math.dist": lambda first, second: math.dist(_floats((first,)), _floats((second,))),
    "math.hypot": lambda *values: math.hypot(*_floats(values)),
    "abs": lambda value: abs(_number(value)),
    "float": float,
    "max": lambda *values: max(_floats(values)),
    "min": lambda *values: min(_floats(values)),
    "sum": lambda values: sum(_floats((values,)), 0.0),
}


def _function(name: str) -> Callable[..., Any]:
    module, _, function = name.partition(".")
    return _of_numpy(getattr(np, function)) if module == "numpy" else _of_floats(getattr(math, function))


#: What `vocabulary.SIGNATURES` stand for.
FUNCTIONS: Mapping[str, Callable[..., Any]] = {name: _OWN.get(name) or _function(name) for name in SIGNATURES}

#: What `vocabulary.OPERATORS` stand for, under names that no code can spell.
OPERATIONS: Mapping[str, Callable[[Any, Any], Any]] = {
    f"operator {node}": _operation(getattr(operator, name)) for node, name in OPERATORS.items()
}
