"""What a learned reward sees of frames: features, by a copy of the agent's encoder that stands still between sessions.

The agent's own moves with every update, and what a reward says would drift with it; the appendix' algorithm 2 relabels
once a session. What rows show is looked at once and remembered, where there is room for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rrm.transfers import to

if TYPE_CHECKING:
    from rrm.buffers.experience import Experience
    from rrm.interfaces import FrameEncoder
    from rrm.types import Pixels, State

_AT_ONCE = 256  # observations; libraries may round otherwise for another number
_LARGEST = 1 << 29  # bytes of remembered features


class Sight:
    """The features of rows of an experience.

    Remembered are the rows up to the present session in one go, and those since then in another: the same looks in the
    same numbers, and so the same bits, whether or not a run was interrupted.
    """

    def __init__(self, experience: Experience, encoder: FrameEncoder) -> None:
        self._experience = experience
        self._encoder = encoder.frozen()
        self._session_rows = 0  # when the encoder was taken
        self._most = _LARGEST // (2 * encoder.outputs)  # rows whose features are remembered
        self._forget()

    def __call__(self, rows: Tensor) -> Tensor:
        """Features float32 [..., T, R] of rows [..., T], which follow each other along the last axis."""
        experience = self._experience
        if experience.rows <= self._most:
            self._remember(min(self._session_rows, experience.rows))
            self._remember(experience.rows)
            return self._remembered[rows].float()
        runs = rows.reshape(-1, rows.shape[-1])
        seen = torch.stack([self._looked(int(run[0]), int(run[-1]) + 1) for run in runs])
        return seen.view(*rows.shape, -1)

    def one(self, frames: Pixels) -> Tensor:
        """Features [1, R] of what was seen at one step, [stack, channels, height, width]."""
        return self._looks(torch.from_numpy(frames)[None])

    def renew(self, encoder: FrameEncoder) -> None:
        """See with this encoder as it is now."""
        self._encoder = encoder.frozen()
        self._session_rows = self._experience.rows
        self._forget()

    def _forget(self) -> None:
        """Memory is touched only as rows come, and given back here."""
        self._remembered = torch.empty(self._most, self._encoder.outputs, dtype=torch.float16)  # of the host
        self._known = 0

    def _remember(self, rows: int) -> None:
        for begin in range(self._known, rows, _AT_ONCE):
            end = min(begin + _AT_ONCE, rows)
            self._remembered[begin:end] = self._looks(self._experience.stacks(begin, end))
            self._known = end

    def _looked(self, begin: int, end: int) -> Tensor:
        looks = (self._experience.stacks(b, min(b + _AT_ONCE, end)) for b in range(begin, end, _AT_ONCE))
        return torch.cat([self._looks(stacks) for stacks in looks])

    def _looks(self, stacks: Tensor) -> Tensor:
        return self._encoder.encode(to(self._experience.device, stacks))

    def state_dict(self) -> State:
        return {"encoder": self._encoder.flat.clone(), "session_rows": self._session_rows}

    def load_state_dict(self, state: State) -> None:
        self._encoder.flat.copy_(state["encoder"])
        self._session_rows = int(state["session_rows"])
        self._forget()
