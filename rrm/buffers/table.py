"""What learning reads of an experience, on a graphics card.

One table of float32, a row for each of the experience's: `obs`, `act`, `prior`, `reward`, and whether the value behind
a row counts. The host's columns are views of such a table, too, in memory that the card reads by itself: rows go up by
one copy, when they are first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from rrm.nets.captured import to
from rrm.types import Batch

if TYPE_CHECKING:
    from collections.abc import Callable

    from rrm.envs.spaces import Spaces


class Table:
    """The rows of an experience on a device.

    Args:
        rows: to make room for.
        continues: of a slice of rows, whether the value behind each counts, and whether it does where a time limit is
            taken for a termination: two columns, bool [n].
    """

    def __init__(
        self, rows: int, spaces: Spaces, device: str, continues: Callable[[slice], tuple[Tensor, Tensor]]
    ) -> None:
        self.device = device
        width, pinned = spaces.obs + spaces.act + 4, torch.device(device).type != "cpu"
        self._host = torch.empty(rows, width, pin_memory=pinned)
        self._there = torch.empty(rows, width, device=device)
        self._continues = continues
        self._split = [spaces.obs, spaces.act, 1, 1, 2]
        self._known = 0  # rows that are there, and will not change any more
        self.obs, self.act, self.prior, self.reward, self._on = self._columns(self._there)

    def columns(self) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The host's: obs, act, prior and reward."""
        return self._columns(self._host)[:4]

    def _columns(self, table: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        obs, act, prior, reward, on = torch.split(table, self._split, dim=1)
        return obs, act, prior[:, 0], reward[:, 0], on

    def bring(self, rows: int) -> None:
        """What has been filled in since the last call, up to row `rows`: of that one, where it is, the observation."""
        if self._known == rows:
            return
        part = slice(self._known, rows)
        on, inside = self._continues(part)
        self._host[part, -2], self._host[part, -1] = on, inside
        upto = slice(self._known, min(rows + 1, len(self._host)))
        self._there[upto].copy_(self._host[upto], non_blocking=True)
        self._known = rows

    def forget(self) -> None:
        """Have every row brought anew."""
        self._known = 0

    def batch(self, rows: Tensor, *, time_limits_end: bool = False) -> Batch:
        """The transitions at `rows`, int64 [...] of the host: every field starts with these axes."""
        numbers = to(self.device, torch.stack((rows, rows + 1)))
        here, behind = self._there[numbers]
        obs, act, prior, reward, on = torch.split(here, self._split, dim=-1)
        return Batch(
            obs=obs, act=act, prior=prior[..., 0], reward=reward[..., 0], next_obs=behind[..., : self._split[0]],
            continues=on[..., 1 if time_limits_end else 0],
        )  # fmt: skip

    def rewarded(self, rows: int) -> None:
        """The reward of the first `rows` was written anew there: bring it back."""
        self._columns(self._host)[3][:rows] = self.reward[:rows].cpu()
