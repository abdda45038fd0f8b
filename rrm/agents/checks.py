"""What every agent refuses, numbers that are not finite and states of agents of other sizes, and what it saves."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rrm.errors import CheckpointError, NumericalError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from rrm.nets.adam import FlatAdam
    from rrm.types import Floats, State


def finite_action(action: Floats, updates: int, seen: str) -> Floats:
    """The action, if it is finite; a `NumericalError` names what was `seen` otherwise."""
    if not np.isfinite(action).all():
        raise NumericalError(
            f"the action after {updates} updates is {action.tolist()} for {seen}; look for rewards or observations "
            "that are not finite, then for step sizes that are too large"
        )
    return action


def finite_figures(figures: dict[str, float], updates: int) -> dict[str, float]:
    """The figures, if they are finite or there was no update yet."""
    if updates and not all(map(math.isfinite, figures.values())):
        raise NumericalError(f"a figure of the agent is not finite: {figures}")
    return figures


def saved(tensors: Mapping[str, Tensor], adams: Mapping[str, FlatAdam]) -> State:
    """Copies of what an agent's updates change."""
    return {
        "tensors": {name: tensor.clone() for name, tensor in tensors.items()},
        "optimisers": {name: adam.state_dict() for name, adam in adams.items()},
    }


def restore(tensors: Mapping[str, Tensor], adams: Mapping[str, FlatAdam], state: State) -> None:
    """Continue from what was `saved`; a `CheckpointError` where a tensor of the same name has another shape."""
    for name, tensor in tensors.items():
        kept = state["tensors"][name]
        if kept.shape != tensor.shape:
            raise CheckpointError(
                f"the saved agent's {name} has shape {tuple(kept.shape)}, this agent's has "
                f"{tuple(tensor.shape)}; load it with the configuration and task it was trained with"
            )
        tensor.copy_(kept)
    for name, adam in adams.items():
        adam.load_state_dict(state["optimisers"][name])
