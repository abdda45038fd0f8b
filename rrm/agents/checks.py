"""What every agent refuses: numbers that are not finite, and states of agents of other sizes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from rrm.errors import CheckpointError, NumericalError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from torch import Tensor

    from rrm.types import Floats


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


def restore(tensors: Mapping[str, Tensor], saved: Mapping[str, Tensor]) -> None:
    """Copy what was saved into the tensors of the same names; a `CheckpointError` where a shape is another."""
    for name, tensor in tensors.items():
        if saved[name].shape != tensor.shape:
            raise CheckpointError(
                f"the saved agent's {name} has shape {tuple(saved[name].shape)}, this agent's has "
                f"{tuple(tensor.shape)}; load it with the configuration and task it was trained with"
            )
        tensor.copy_(saved[name])
