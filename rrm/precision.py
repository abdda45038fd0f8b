"""Which arithmetic a run's networks multiply in. Nothing here imports torch; `rrm.nets.precision` does the work."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ValidationInfo, ValidatorFunctionWrapHandler, WrapValidator

from rrm.tuning import machine

Precision = Literal["float32", "bfloat16"]


def _meant(value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> object:
    if value != "auto":
        return handler(value)
    agent = (info.data or {}).get("agent")  # missing where it is wrong, which is said then, or in a setting by itself
    return value if agent is None else native_precision(agent.batch, agent.hidden)


#: A setting that may also be "auto"; what is stored is what that meant on the machine that planned the run.
PrecisionSetting = Annotated[Precision, WrapValidator(_meant)]


def native_precision(batch: int, hidden: int) -> Precision:
    """bfloat16 where products of such layers in it were measured to be so much quicker on this machine that it pays."""
    return "bfloat16" if machine().rounding_pays((batch, hidden, hidden)) else "float32"
