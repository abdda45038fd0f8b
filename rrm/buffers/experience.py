"""Everything a run has lived through, in order: replay buffer and trajectory store in one.

Each observation is stored once. A step occupies one row; the observation that ends an episode occupies one row more,
so that the successor of a row is always the next row and a segment is always a run of consecutive rows. Nothing is
evicted: the paper's buffers hold as many transitions as its runs have steps.

Columns: `obs`, `act`, the prior as stored at collection (scaled, and raw), the true reward (read by teachers and
evaluation only), and the reward the agent is trained on, which a feedback session rewrites.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from rrm.checkpoint import AppendLog
from rrm.interfaces import Floats
from rrm.types import Batch, Segments, State

_STEP, _TERMINATED, _TRUNCATED, _END = (
    0,
    1,
    2,
    3,
)  # what a row is; _END is the observation behind an episode's last step
_RELABEL_ROWS = 1 << 11  # keeps the activations of the reward ensemble within the caches' reach
_SPARE_NEIGHBOURS = 4  # candidates beyond the k nearest, for those that rounding puts in the wrong order


@dataclass(frozen=True)
class Episode:
    """A finished training episode: where it begins and how long it is, in rows."""

    start: int
    length: int


class Experience:
    """Transitions of one run; rows are appended, only the learned reward changes."""

    def __init__(self, steps: int, obs_dim: int, act_dim: int) -> None:
        """Args: steps: transitions to make room for (memory is touched only as they come)."""
        rows = 2 * steps + 2  # were every episode one step long
        self.obs = torch.empty(rows, obs_dim)
        self.act = torch.empty(rows, act_dim)
        self.prior = torch.empty(rows)
        self.raw_prior = torch.empty(rows)
        self.reward = torch.empty(rows)
        self.true_reward = torch.empty(rows)
        self.continues = torch.empty(rows)
        self._kind = np.empty(rows, np.uint8)
        self._row_of = torch.empty(steps, dtype=torch.int64)
        self._views = {name: getattr(self, name).numpy() for name in ("obs", "act")}
        self.rows = 0
        self.transitions = 0
        self.episodes: list[Episode] = []
        self._episode_start = 0
        self._saved_rows = 0
        self.generation = 0  #: of the reward column: one more with every relabelling
        self._saved_generation = 0
        self._logs: tuple[AppendLog, AppendLog] | None = None

    def append(
        self,
        *,
        obs: Floats,
        act: Floats,
        prior: float,
        raw_prior: float,
        reward: float,
        true_reward: float,
        next_obs: Floats,
        terminated: bool,
        truncated: bool,
    ) -> None:
        """One environment step. `terminated` cuts the bootstrap, `truncated` does not."""
        row = self.rows
        self._views["obs"][row] = obs
        self._views["act"][row] = act
        self.prior[row] = prior
        self.raw_prior[row] = raw_prior
        self.reward[row] = reward
        self.true_reward[row] = true_reward
        self.continues[row] = 0.0 if terminated else 1.0
        self._kind[row] = _TERMINATED if terminated else _TRUNCATED if truncated else _STEP
        self._views["obs"][row + 1] = next_obs
        self._enter(row)
        if terminated or truncated:
            self._write_end(row + 1)
            self._close_episode(row + 2)

    def _enter(self, row: int) -> None:
        self._row_of[self.transitions] = row
        self.transitions += 1
        self.rows = row + 1

    def _write_end(self, row: int) -> None:
        self._kind[row] = _END
        for column in (self.act, self.prior, self.raw_prior, self.reward, self.true_reward, self.continues):
            column[row] = 0.0

    def _close_episode(self, next_row: int) -> None:
        self.episodes.append(Episode(self._episode_start, next_row - 1 - self._episode_start))
        self._episode_start = self.rows = next_row

    def sample(
        self, count: int, generator: torch.Generator, *, newest: int | None = None, time_limits_end: bool = False
    ) -> Batch:
        """`count` transitions, uniformly with replacement.

        Args:
            newest: of the last so many alone.
            time_limits_end: take a time limit for a termination in `continues`.
        """
        first = 0 if newest is None else max(0, self.transitions - newest)
        rows = self._row_of[torch.randint(first, self.transitions, (count,), generator=generator)]
        return self._batch(rows, time_limits_end=time_limits_end)

    def newest(self, count: int) -> Batch:
        """The last `count` transitions, or all where there are fewer, in order."""
        return self._batch(self.since(max(0, self.transitions - count)))

    def _batch(self, rows: Tensor, *, time_limits_end: bool = False) -> Batch:
        on = torch.from_numpy(self._kind)[rows] == _STEP if time_limits_end else self.continues[rows]
        return Batch(
            obs=self.obs[rows],
            act=self.act[rows],
            prior=self.prior[rows],
            reward=self.reward[rows],
            next_obs=self.obs[rows + 1],
            continues=on.float(),
        )

    def segments(self, starts: Tensor, length: int) -> Segments:
        """The `length` steps from each row of `starts` [...] on; every field starts with the axes [..., length]."""
        rows = starts.unsqueeze(-1) + torch.arange(length)
        return Segments(self.obs[rows], self.act[rows], self.prior[rows])

    def true_rewards(self, starts: npt.NDArray[np.int64], length: int) -> Floats:
        """True reward of the same steps, float32 [..., length]. For teachers and evaluation alone."""
        rows = starts[..., None] + np.arange(length)
        return self.true_reward.numpy()[rows]

    def rewards(self, starts: npt.NDArray[np.int64], length: int) -> Floats:
        """Reward the agent is trained on, of the `length` steps from each of `starts` [...] on: [..., length]."""
        return self.reward.numpy()[starts[..., None] + np.arange(length)]

    def relabel(self, predict: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
        """Rewrite the reward of every row by `predict(obs, act, prior)`, with the prior as it was stored."""
        for begin in range(0, self.rows, _RELABEL_ROWS):
            part = slice(begin, min(begin + _RELABEL_ROWS, self.rows))
            self.reward[part] = predict(self.obs[part], self.act[part], self.prior[part])
        self.generation += 1

    def neighbour_distance(self, obs: Tensor, k: int) -> Tensor:
        """Distance of each of `obs` [B, O] to its k-th nearest neighbour among all stored states, itself left out: [B].

        `obs` come from this buffer, so each is its own nearest neighbour. Raw observations, Euclidean (PEBBLE,
        section 4.1).
        """
        stored = self.obs[: self.rows]
        # A matrix product finds the candidates; it loses the digits of small distances, so theirs are taken again.
        center = obs.mean(dim=0)
        distance = torch.cdist(obs - center, stored - center, compute_mode="use_mm_for_euclid_dist")
        distance[:, [e.start + e.length for e in self.episodes]] = torch.inf  # not states of a transition
        rank = min(k, self.transitions - 1)
        candidates = min(rank + 1 + _SPARE_NEIGHBOURS, self.transitions)
        nearest = distance.topk(candidates, largest=False, sorted=False).indices
        exact = (stored[nearest] - obs.unsqueeze(1)).square().sum(dim=-1).sqrt()
        return exact.sort(dim=-1).values[:, rank]

    def since(self, transition: int) -> Tensor:
        """Rows of the transitions from number `transition` on."""
        return self._row_of[transition : self.transitions]

    def save(self, folder: Path) -> State:
        """Append what is new to the logs in `folder`; the state returned says how long they are now.

        The transitions are never written twice. The reward column is written anew only after a relabelling, whose own
        cost is proportional to its length anyway.
        """
        transitions, rewards = self._logs or self._open(folder, self.generation)
        if self.generation != self._saved_generation:
            rewards = AppendLog(self._reward_path(folder, self.generation))
            self._saved_generation = self.generation
        transitions.append(self._records(self._saved_rows, self.rows).tobytes())
        rewards.append(self.reward.numpy()[rewards.size // 4 : self.rows].tobytes())
        self._logs = (transitions, rewards)
        self._saved_rows = self.rows
        return {
            "rows": self.rows,
            "generation": self.generation,
            "transitions": [transitions.size, transitions.crc],
            "rewards": [rewards.size, rewards.crc],
            "next_obs": self.obs[self.rows].clone(),
        }

    def load(self, folder: Path, state: State) -> None:
        """Continue from what `save` returned, on an empty experience.

        Raises:
            CheckpointError: the logs do not hold what the state says.
        """
        generation = int(state["generation"])
        transitions, rewards = self._open(folder, generation)
        dtype, rows, labelled = self._dtype(), 0, 0
        (size, crc), (reward_size, reward_crc) = state["transitions"], state["rewards"]
        for block in transitions.restore(size, crc, dtype.itemsize):
            rows = self._read_records(rows, np.frombuffer(block, dtype))
        self._find_episodes(rows)
        for block in rewards.restore(reward_size, reward_crc, self.reward.itemsize):
            values = np.frombuffer(block, np.float32)
            self.reward.numpy()[labelled : labelled + len(values)] = values
            labelled += len(values)
        self._logs = (transitions, rewards)
        self.generation = self._saved_generation = generation
        self._saved_rows = rows
        self.obs[rows] = state["next_obs"]

    def discard(self, folder: Path, kept_generations: Collection[int]) -> None:
        """Remove reward columns of generations that no kept checkpoint refers to."""
        kept = {self._reward_path(folder, g) for g in kept_generations}
        for path in folder.glob("reward-*.bin"):
            if path not in kept:
                path.unlink()

    def _open(self, folder: Path, generation: int) -> tuple[AppendLog, AppendLog]:
        return AppendLog(folder / "transitions.bin"), AppendLog(self._reward_path(folder, generation))

    @staticmethod
    def _reward_path(folder: Path, generation: int) -> Path:
        return folder / f"reward-{generation:06d}.bin"

    def _dtype(self) -> np.dtype[np.void]:
        return np.dtype([
            ("obs", "<f4", (self.obs.shape[1],)), ("act", "<f4", (self.act.shape[1],)), ("prior", "<f4"),
            ("raw_prior", "<f4"), ("true_reward", "<f4"), ("kind", "u1"),
        ])  # fmt: skip

    def _records(self, begin: int, end: int) -> npt.NDArray[np.void]:
        records = np.empty(end - begin, self._dtype())
        for name in ("obs", "act", "prior", "raw_prior", "true_reward"):
            records[name] = getattr(self, name)[begin:end].numpy()
        records["kind"] = self._kind[begin:end]
        return records

    def _read_records(self, begin: int, records: npt.NDArray[np.void]) -> int:
        """Put records into the rows from `begin` on; returns the row behind them."""
        end = begin + len(records)
        for name in ("obs", "act", "prior", "raw_prior", "true_reward"):
            getattr(self, name).numpy()[begin:end] = records[name]
        self._kind[begin:end] = records["kind"]
        return end

    def _find_episodes(self, rows: int) -> None:
        """Everything that follows from the kinds of the first `rows` rows."""
        kinds = self._kind[:rows]
        self.continues.numpy()[:rows] = (kinds == _STEP) | (kinds == _TRUNCATED)
        steps = np.flatnonzero(kinds != _END)
        self._row_of.numpy()[: len(steps)] = steps
        self.transitions, self.rows = len(steps), rows
        ends = np.flatnonzero(kinds == _END)
        starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
        self.episodes = [Episode(int(s), int(e - s)) for s, e in zip(starts, ends, strict=True)]
        self._episode_start = int(ends[-1]) + 1 if len(ends) else 0
