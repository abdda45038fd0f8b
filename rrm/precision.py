"""Which arithmetic a run's networks multiply in. Nothing here imports torch; `rrm.nets.precision` does the work."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ValidationInfo, ValidatorFunctionWrapHandler, WrapValidator

from rrm.config import AgentConfig, DrqConfig
from rrm.devices import CPU, CUDA, kind_of
from rrm.tuning import machine, pays

Precision = Literal["float32", "bfloat16", "tf32"]  #: the last on graphics cards alone


def _meant(value: object, handler: ValidatorFunctionWrapHandler, info: ValidationInfo) -> object:
    if value != "auto":
        return handler(value)
    settings = info.data or {}
    agent = settings.get("agent")  # missing where it is wrong, which is said then, or in a setting by itself
    if kind_of(settings.get("device", CPU)) == CUDA:
        return "float32"  # at these sizes a card waits for its next product longer than for one to end
    return value if agent is None else native_precision(agent)


#: A setting that may also be "auto"; what is stored is what that meant on the machine that planned the run.
PrecisionSetting = Annotated[Precision, WrapValidator(_meant)]


def native_precision(agent: AgentConfig) -> Precision:
    """bfloat16 where what most of such an agent's time goes into, layers of its sizes or, of one that sees frames,
    convolutions of its channels, was measured to be so much quicker in it on this machine that it pays.
    """
    here, layer = machine(), (agent.batch, agent.hidden, agent.hidden)
    rates = here.seeing(agent.channels) if isinstance(agent, DrqConfig) else here.layer(layer)
    return "bfloat16" if pays(*rates) else "float32"
