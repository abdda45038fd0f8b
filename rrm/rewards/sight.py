"""What a learned reward sees of frames: features, by a copy of the agent's encoder that stands still between sessions.

The agent's own moves with every update, and what a reward says would drift with it; the appendix' algorithm 2 relabels
once a session. During a session what every row shows is looked at once and remembered, where there is room for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from rrm.buffers.experience import Experience
    from rrm.nets.encoder import Encoder
    from rrm.types import Pixels, State

_AT_ONCE = 256  # observations
_LARGEST = 1 << 29  # bytes of remembered features


class Sight:
    """The features of rows of an experience."""

    def __init__(self, experience: Experience, encoder: Encoder) -> None:
        self._experience = experience
        self._encoder = encoder.frozen()
        self._remembered: Tensor | None = None

    def __call__(self, rows: Tensor) -> Tensor:
        """Features float32 [..., T, R] of rows [..., T], which follow each other along the last axis."""
        if self._remembered is not None:
            return self._remembered[rows].float()
        runs = rows.reshape(-1, rows.shape[-1])
        seen = torch.stack([self._looked(int(run[0]), int(run[-1]) + 1) for run in runs])
        return seen.view(*rows.shape, -1)

    def one(self, frames: Pixels) -> Tensor:
        """Features [1, R] of what was seen at one step, [stack, channels, height, width]."""
        return self._encoder.encode(torch.from_numpy(frames)[None])

    def begin_session(self, encoder: Encoder) -> None:
        """See with this encoder as it is now."""
        self._encoder = encoder.frozen()
        rows, width = self._experience.rows, encoder.outputs
        if rows * width * 2 <= _LARGEST:
            self._remembered = torch.empty(rows, width, dtype=torch.float16)
            for begin in range(0, rows, _AT_ONCE):
                end = min(begin + _AT_ONCE, rows)
                self._remembered[begin:end] = self._looked(begin, end)

    def end_session(self) -> None:
        """Forget what rows show."""
        self._remembered = None

    def _looked(self, begin: int, end: int) -> Tensor:
        parts = [
            self._encoder.encode(self._experience.stacks(first, min(first + _AT_ONCE, end)))
            for first in range(begin, end, _AT_ONCE)
        ]
        return torch.cat(parts)

    def state_dict(self) -> State:
        return {"encoder": self._encoder.flat.clone()}

    def load_state_dict(self, state: State) -> None:
        self._encoder.flat.copy_(state["encoder"])
