"""What learning reads of an experience, on a graphics card.

One table of float32, a row for each of the experience's: `obs`, `act`, `prior`, `reward`, and whether the value behind
a row counts. The host's columns are views of such a table, too, in memory that the card reads by itself: rows go up by
one copy, when they are first asked for.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from rrm.types import Batch

if TYPE_CHECKING:
    import numpy.typing as npt

    from rrm.envs.spaces import Spaces

    Rows = npt.NDArray[np.int64]


#: Draws between two moments at which what was drawn is waited for: the places for their numbers are used in turns.
_LAP = 64


class _Draw:
    """So many rows and those behind them, in a place of their own."""

    def __init__(self, table: Tensor, shape: tuple[int, ...], split: list[int]) -> None:
        self._table = table
        pinned = table.device.type != "cpu"
        self._numbers = torch.empty(_LAP, 2, math.prod(shape), dtype=torch.int64, pin_memory=pinned)
        self._written = self._numbers.numpy()
        self._turn = 0
        self._index = torch.empty(2 * math.prod(shape), dtype=torch.int64, device=table.device)
        self._rows = torch.empty(len(self._index), table.shape[1], device=table.device)
        here, behind = self._rows.view(2, *shape, -1)
        obs, act, prior, reward, on = torch.split(here, split, dim=-1)
        next_obs = behind[..., : split[0]]
        self.batches = [
            Batch(obs, act, prior[..., 0], reward[..., 0], next_obs, continues=on[..., ends]) for ends in (0, 1)
        ]

    def __call__(self, rows: Rows) -> None:
        if self._turn == _LAP:
            if self._numbers.is_pinned():
                torch.cuda.current_stream(self._table.device).synchronize()
            self._turn = 0
        written = self._written[self._turn]
        written[0] = rows.reshape(-1)
        np.add(written[0], 1, out=written[1])
        self._index.copy_(self._numbers[self._turn].view(-1), non_blocking=True)
        torch.index_select(self._table, 0, self._index, out=self._rows)
        self._turn += 1


class Table:
    """The rows of an experience on a device.

    Args:
        rows: to make room for.
    """

    def __init__(self, rows: int, spaces: Spaces, device: str) -> None:
        self.device = device
        width, pinned = spaces.obs + spaces.act + 4, torch.device(device).type != "cpu"
        self._host = torch.empty(rows, width, pin_memory=pinned)
        self._there = torch.empty(rows, width, device=device)
        self._split = [spaces.obs, spaces.act, 1, 1, 2]
        self._draws: dict[tuple[int, ...], _Draw] = {}
        self._known = 0  # rows that are there, and will not change any more
        self.obs, self.act, self.prior, self.reward, self._on = self._columns(self._there)

    def columns(self) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """The host's: obs, act, prior, reward; and whether the value behind a row counts, [rows, 2], always and where a
        time limit is taken for a termination.
        """
        return self._columns(self._host)

    def _columns(self, table: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        obs, act, prior, reward, on = torch.split(table, self._split, dim=1)
        return obs, act, prior[:, 0], reward[:, 0], on

    def bring(self, rows: int) -> None:
        """What has been filled in since the last call, up to row `rows`: of that one, where it is, the observation."""
        if self._known == rows:
            return
        upto = slice(self._known, min(rows + 1, len(self._host)))
        self._there[upto].copy_(self._host[upto], non_blocking=True)
        self._known = rows

    def forget(self) -> None:
        """Have every row brought anew."""
        self._known = 0

    def batch(self, rows: Rows, *, time_limits_end: bool = False) -> Batch:
        """The transitions at `rows`, int64 [...]: every field starts with these axes, and stays as it is until as many
        are asked for again.
        """
        draw = self._draws.get(rows.shape)
        if draw is None:
            draw = self._draws[rows.shape] = _Draw(self._there, rows.shape, self._split)
        draw(rows)
        return draw.batches[time_limits_end]

    def rewarded(self, rows: int) -> None:
        """The reward of the first `rows` was written anew there: bring it back."""
        self._columns(self._host)[3][:rows] = self.reward[:rows].cpu()
