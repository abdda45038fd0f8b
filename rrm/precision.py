"""Which arithmetic a run's networks multiply in. Nothing here imports torch; `rrm.nets.precision` does the work."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, ValidationInfo

from rrm.tuning import machine

Precision = Literal["float32", "bfloat16"]


def _meant(value: object, info: ValidationInfo) -> object:
    if value != "auto":
        return value
    agent = (info.data or {}).get("agent")  # validated before; missing where it is wrong or the setting stands alone
    return "float32" if agent is None else native_precision(agent.batch, agent.hidden)


#: A setting that may also be "auto"; what is stored is what that meant on the machine that planned the run.
PrecisionSetting = Annotated[Precision, BeforeValidator(_meant)]


def native_precision(batch: int, hidden: int) -> Precision:
    """bfloat16 where products of such layers in it were measured to be so much quicker on this machine that it pays."""
    return "bfloat16" if machine().rounding_pays((batch, hidden, hidden)) else "float32"
