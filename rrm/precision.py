"""Which arithmetic a run's networks multiply in. Nothing here imports torch; `rrm.nets.precision` does the work."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Literal

from pydantic import BeforeValidator

from rrm.tuning import machine

Precision = Literal["float32", "bfloat16"]

#: A setting that may also be "auto"; what is stored is what that meant on the machine that planned the run.
PrecisionSetting = Annotated[Precision, BeforeValidator(lambda value: native_precision() if value == "auto" else value)]


@cache
def native_precision() -> Precision:
    """bfloat16 where products in it were measured to be so much quicker on this machine that it pays."""
    return "float32" if machine().rounding_pays is None else "bfloat16"
