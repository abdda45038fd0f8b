"""Rows of equally long columns that grow as they are filled, and their append-only logs in a checkpoint's folder."""

from __future__ import annotations

from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from rrm.checkpoint import KEPT, AppendLog

if TYPE_CHECKING:
    from rrm.types import State

_LOGGED = ("obs", "act", "prior", "raw_prior", "true_reward", "kind")


class Columns:
    """What is known of every row.

    Args:
        rows: to make room for (memory is touched only as they come); more are made room for when they are needed.
    """

    def __init__(self, rows: int, obs_dim: int, act_dim: int) -> None:
        self.obs = torch.empty(rows, obs_dim)
        self.act = torch.empty(rows, act_dim)
        self.prior = torch.empty(rows)
        self.raw_prior = torch.empty(rows)
        self.true_reward = torch.empty(rows)
        self.reward = torch.empty(rows)
        self.kind = torch.empty(rows, dtype=torch.uint8)
        self.rows = 0  #: that are filled
        self.generation = 0  #: of the reward column: one more whenever all of it is rewritten
        self._saved_rows = 0
        self._saved_generations = deque([0], maxlen=KEPT)  # of the kept checkpoints
        self._logs: tuple[AppendLog, AppendLog] | None = None

    def reserve(self, rows: int) -> None:
        """Make room for as many rows, with half as many again to come."""
        if rows <= len(self.kind):
            return
        for name in (*_LOGGED, "reward"):
            old: Tensor = getattr(self, name)
            new = torch.empty(rows + rows // 2, *old.shape[1:], dtype=old.dtype)
            new[: len(old)] = old
            setattr(self, name, new)

    def save(self, folder: Path) -> State:
        """Append what is new to the logs in `folder`; the state returned says how long they are now.

        Rows are never written twice. The reward column is written anew only after a relabelling, whose own cost is
        proportional to its length anyway.
        """
        records, rewards = self._logs or self._open(folder)
        if self.generation != self._saved_generations[-1]:
            rewards = AppendLog(_reward_path(folder, self.generation))
        rows = np.empty(self.rows - self._saved_rows, self._dtype())
        for name in _LOGGED:
            rows[name] = getattr(self, name)[self._saved_rows : self.rows].numpy()
        records.append(rows.tobytes())
        rewards.append(self.reward.numpy()[rewards.size // 4 : self.rows].tobytes())
        self._logs = (records, rewards)
        self._saved_rows = self.rows
        self._saved_generations.append(self.generation)
        return {
            "rows": self.rows,
            "generation": self.generation,
            "transitions": [records.size, records.crc],
            "rewards": [rewards.size, rewards.crc],
            "next_obs": self.obs[self.rows].clone(),
        }

    def load(self, folder: Path, state: State) -> None:
        """Continue from what `save` returned, on empty columns; a `CheckpointError` where the logs do not hold it."""
        self.generation = int(state["generation"])
        records, rewards = self._logs = self._open(folder)
        self.reserve(int(state["rows"]) + 1)
        (size, crc), (reward_size, reward_crc) = state["transitions"], state["rewards"]
        dtype, rewarded = self._dtype(), 0
        for block in records.restore(size, crc, dtype.itemsize):
            rows = np.frombuffer(block, dtype)
            begin, self.rows = self.rows, self.rows + len(rows)
            for name in _LOGGED:
                getattr(self, name).numpy()[begin : self.rows] = rows[name]
        for block in rewards.restore(reward_size, reward_crc, self.reward.itemsize):
            values = np.frombuffer(block, np.float32)
            self.reward.numpy()[rewarded : rewarded + len(values)] = values
            rewarded += len(values)
        self._saved_rows = self.rows
        self._saved_generations = deque([self.generation], maxlen=KEPT)
        self.obs[self.rows] = state["next_obs"]

    def discard(self, folder: Path) -> None:
        """Remove reward columns of generations that no kept checkpoint refers to, once the newest is committed."""
        kept = {_reward_path(folder, generation) for generation in self._saved_generations}
        for path in folder.glob("reward-*.bin"):
            if path not in kept:
                path.unlink()

    def _open(self, folder: Path) -> tuple[AppendLog, AppendLog]:
        return AppendLog(folder / "transitions.bin"), AppendLog(_reward_path(folder, self.generation))

    def _dtype(self) -> np.dtype[np.void]:
        return np.dtype([
            ("obs", "<f4", (self.obs.shape[1],)), ("act", "<f4", (self.act.shape[1],)), ("prior", "<f4"),
            ("raw_prior", "<f4"), ("true_reward", "<f4"), ("kind", "u1"),
        ])  # fmt: skip


def _reward_path(folder: Path, generation: int) -> Path:
    return folder / f"reward-{generation:06d}.bin"
