"""The whole vocabulary of a language prior: what can be named. What the words do is in `guards`.

No numpy is imported here, so that planning can check code without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

#: What may be read of a step, and of `step.first`. Neither success nor `info`, where simulators put their rewards.
TASK_FEATURES = ("hand", "object", "goal", "upright", "clearance")
OUTCOMES = ("torso_upright", "torso_height", "forward_velocity")
ACCESSORS = frozenset({*TASK_FEATURES, *OUTCOMES, "obs", "act", "first"})

CONSTANTS: Mapping[str, float] = {
    **{f"{module}.{name}": getattr(math, name) for module in ("math", "numpy") for name in ("pi", "e", "inf")},
    "math.tau": math.tau,
}

#: Operators, by the name of their syntax node.
OPERATORS = ("Add", "Sub", "Mult", "Div", "FloorDiv", "Mod", "Pow")

#: What every expression's value passes through, under a name that no code can spell.
VALUE = "checked value"


class Signature(NamedTuple):
    """How a function can be called."""

    most: int = 1  #: positional arguments; numpy's `out` comes after the last one
    keywords: frozenset[str] = frozenset()


#: Functions of numpy and of math that are called as they are, by the number of their arguments.
PLAIN_NUMPY: Mapping[int, str] = {
    1: "abs absolute arccos arcsin arctan cos cosh deg2rad exp expm1 fabs isfinite isnan log log10 log1p log2 "
    "max mean min rad2deg sign sin sinh sqrt square std sum tan tanh",
    2: "arctan2 cross dot hypot maximum minimum",
    3: "where",
}
PLAIN_MATH: Mapping[int, str] = {
    1: "acos asin atan cos cosh degrees exp expm1 fabs isfinite log log10 log1p log2 radians sin sinh sqrt tan tanh",
    2: "atan2 copysign fmod pow",
}

#: Everything that can be called besides the code's own functions.
FUNCTIONS: Mapping[str, Signature] = {
    **{f"numpy.{name}": Signature(most) for most, names in PLAIN_NUMPY.items() for name in names.split()},
    **{f"math.{name}": Signature(most) for most, names in PLAIN_MATH.items() for name in names.split()},
    "numpy.array": Signature(),
    "numpy.asarray": Signature(),
    "numpy.float64": Signature(),
    "numpy.power": Signature(2),
    "numpy.clip": Signature(3, frozenset({"a_min", "a_max"})),
    "numpy.linalg.norm": Signature(2, frozenset({"ord"})),
    "math.dist": Signature(2),
    "math.hypot": Signature(8),
    "abs": Signature(),
    "float": Signature(),
    "max": Signature(32),
    "min": Signature(32),
    "sum": Signature(),
}
