"""The whole vocabulary of a language prior: what can be named. What the words do is in `guards`.

No numpy is imported here, so that planning can check code without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

#: What may be read of a step, and of `step.first`. Neither success nor `info`, where simulators put their rewards.
TASK_FEATURES = ("hand", "object", "object_start", "goal", "upright", "clearance")
OUTCOMES = ("torso_upright", "torso_height", "forward_velocity")
ACCESSORS = frozenset({*TASK_FEATURES, *OUTCOMES, "obs", "act", "first"})

CONSTANTS: Mapping[str, float] = {
    **{f"{module}.{name}": getattr(math, name) for module in ("math", "numpy") for name in ("pi", "e", "inf")},
    "math.tau": math.tau,
}

#: Operators: the name of their syntax node, and of their function in the module `operator`.
OPERATORS = {
    "Add": "add", "Sub": "sub", "Mult": "mul", "Div": "truediv", "FloorDiv": "floordiv", "Mod": "mod", "Pow": "pow"
}  # fmt: skip

#: What every expression's value passes through, under a name that no code can spell.
VALUE = "checked value"


class Signature(NamedTuple):
    """How a function can be called."""

    most: int = 1  #: positional arguments; numpy's `out` comes after the last one
    keywords: frozenset[str] = frozenset()


#: Functions by module and number of arguments; where `guards` has nothing of its own, they are called as they are.
_BY_ARGUMENTS = {
    ("numpy.", 1): "abs absolute arccos arcsin arctan array asarray cos cosh deg2rad exp expm1 fabs float64 isfinite "
    "isnan log log10 log1p log2 max mean min rad2deg sign sin sinh sqrt square std sum tan tanh",
    ("numpy.", 2): "arctan2 cross dot hypot maximum minimum power",
    ("numpy.", 3): "where",
    ("math.", 1): "acos asin atan cos cosh degrees exp expm1 fabs isfinite log log10 log1p log2 radians sin sinh sqrt "
    "tan tanh",
    ("math.", 2): "atan2 copysign dist fmod pow",
    ("math.", 8): "hypot",
    ("", 1): "abs float sum",
    ("", 32): "max min",
}

#: Everything that can be called besides the code's own functions.
SIGNATURES: Mapping[str, Signature] = {
    **{f"{module}{name}": Signature(most) for (module, most), names in _BY_ARGUMENTS.items() for name in names.split()},
    "numpy.clip": Signature(3, frozenset({"a_min", "a_max"})),
    "numpy.linalg.norm": Signature(2, frozenset({"ord"})),
}
