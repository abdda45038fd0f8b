"""Everything a run has lived through, in order: transitions, and the episodes they make.

Each observation is stored once. A step occupies one row; the observation that ends an episode occupies one row more,
so that the successor of a row is always the next row and a segment is always a run of consecutive rows. Nothing is
evicted: the paper's buffers hold as many transitions as its runs have steps.

Columns: `obs`, `act`, the prior as stored at collection (scaled, and raw), the true reward (read by teachers and
evaluation only), and the reward the agent is trained on, which a feedback session rewrites. In a checkpoint's folder
they are append-only logs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from rrm.buffers.frames import Frames
from rrm.buffers.table import Table
from rrm.checkpoint import KEPT, AppendLog
from rrm.devices import CPU, kind_of
from rrm.transfers import to
from rrm.types import Batch, Segments, Transition

if TYPE_CHECKING:
    from rrm.envs.spaces import Spaces
    from rrm.types import Floats, State

#: What a row is; _END is the observation behind an episode's last step.
_STEP, _TERMINATED, _TRUNCATED, _END = range(4)
_LOGGED = ("obs", "act", "prior", "raw_prior", "true_reward", "kind")
_FRAMES = "frames.bin"
_RELABEL_ROWS = {"cpu": 1 << 11, "cuda": 1 << 14}  # the activations of the ensemble stay within a processor's caches


class Episode(NamedTuple):
    """A finished training episode: where it begins and how long it is, in rows."""

    start: int
    length: int


class Experience:
    """Transitions of one run; rows are appended, only the learned reward changes."""

    def __init__(self, steps: int, horizon: int, spaces: Spaces, window: int = 1, device: str = CPU) -> None:
        """Args:
        steps: transitions to make room for.
        horizon: of an episode that does not end before its time.
        window: consecutive steps that are drawn together, see `windows`.
        device: where what is drawn is learned from. The columns are the host's; a card has some of its own besides.
        """
        rows = steps + steps // horizon + 2  # memory is touched only as they come
        self.device = device
        self._spaces = spaces
        self._table: Table | None = None
        self._make_room(rows)
        self.rows = 0  #: that are filled
        self.generation = 0  #: of the reward column: one more whenever all of it is rewritten
        self._saved_rows = 0
        self._saved_generations = deque([0], maxlen=KEPT)  # of the kept checkpoints
        self._logs: tuple[AppendLog, AppendLog] | None = None
        self.frames = None if spaces.frames is None else Frames(spaces.frames)
        self.seen: Callable[[Tensor], Tensor] = self._observed  #: what a learned reward is shown of rows [..., T]
        self._row_of = torch.empty(steps, dtype=torch.int64)
        self.transitions = 0
        self.window = window
        self._window_of = torch.empty(steps, dtype=torch.int64)  # the row at which a window begins
        self.windows = 0  #: of `window` steps in one episode there are so many
        self.episodes: list[Episode] = []
        self._episode_start = 0

    def _make_room(self, rows: int) -> None:
        spaces = self._spaces
        self.raw_prior = torch.empty(rows)
        self.true_reward = torch.empty(rows)
        self.kind = torch.empty(rows, dtype=torch.uint8)
        self._continues: Tensor | None = None
        if kind_of(self.device) == CPU:
            self.obs, self.act = torch.empty(rows, spaces.obs), torch.empty(rows, spaces.act)
            self.prior, self.reward = torch.empty(rows), torch.empty(rows)
        else:
            self._table = Table(rows, spaces, self.device)
            self.obs, self.act, self.prior, self.reward, self._continues = self._table.columns()
        # numpy writes a number in a tenth of the time.
        self._written = {name: getattr(self, name).numpy() for name in (*_LOGGED, "reward")}
        if self._continues is not None:
            self._written["continues"] = self._continues.numpy()

    @property
    def near(self) -> Experience | Table:
        """The columns `obs`, `act`, `prior` and `reward` where what is drawn is learned from."""
        if self._table is None:
            return self
        self._table.bring(self.rows)
        return self._table

    def reserve(self, rows: int) -> None:
        """Make room for as many rows, with half as many again to come."""
        if rows <= len(self.kind):
            return
        old = {name: getattr(self, name) for name in (*_LOGGED, "reward")}
        self._make_room(rows + rows // 2)
        for name, column in old.items():
            getattr(self, name)[: len(column)] = column
        self._tell_apart()

    def _tell_apart(self) -> None:
        """For a card: whether the value behind each row counts."""
        if self._continues is not None:
            kind = self.kind[: self.rows]
            self._continues[: self.rows] = torch.stack((kind != _TERMINATED, kind == _STEP), dim=1)

    def append(self, step: Transition, reward: float) -> None:
        """One environment step, and the reward that the agent is given for it."""
        row = self.rows
        self.reserve(row + 3)  # with the observation behind it, and the row that one more step would take
        columns = self._written
        for name in ("obs", "act", "prior", "raw_prior", "true_reward"):
            columns[name][row] = getattr(step, name)
        columns["reward"][row] = reward
        columns["kind"][row] = _TERMINATED if step.terminated else _TRUNCATED if step.truncated else _STEP
        columns["obs"][row + 1] = step.next_obs
        if "continues" in columns:
            columns["continues"][row] = not step.terminated, not (step.terminated or step.truncated)
        if self.frames is not None and step.frames is not None and step.next_frames is not None:
            if len(self.frames) == row:  # an episode begins
                self.frames.append(step.frames[-1])
            self.frames.append(step.next_frames[-1])
        self._number(row)
        self.rows = row + 1
        if step.terminated or step.truncated:
            columns["kind"][row + 1] = _END
            for name in ("act", "prior", "raw_prior", "reward", "true_reward"):
                columns[name][row + 1] = 0.0
            self.episodes.append(Episode(self._episode_start, row + 1 - self._episode_start))
            self._episode_start = self.rows = row + 2

    def _number(self, row: int) -> None:
        """Count the transition at this row, and the window that it completes."""
        if self.transitions == len(self._row_of):
            self._row_of, self._window_of = (
                torch.cat((rows, torch.empty_like(rows))) for rows in (self._row_of, self._window_of)
            )
        self._row_of.numpy()[self.transitions] = row
        self.transitions += 1
        if (begin := row - self.window + 1) >= self._episode_start:
            self._window_of.numpy()[self.windows] = begin
            self.windows += 1

    def batch(self, numbers: Tensor, *, time_limits_end: bool = False) -> Batch:
        """The transitions of these numbers [B], counted from 0 in the order in which they were lived. Those on a card
        stay as they are until as many are asked for again.

        Args: time_limits_end: take a time limit for a termination in `continues`.
        """
        rows = self._row_of[numbers]
        return self._filmed(rows, 1, self._batch(rows, time_limits_end=time_limits_end))

    def batch_of_windows(self, numbers: Tensor) -> Batch:
        """The windows of these numbers [B], counted likewise: every field has the axes [B, window], but for frames."""
        rows = self._window_of[numbers]
        return self._filmed(rows, self.window, self._batch(rows[:, None] + torch.arange(self.window)))

    def _filmed(self, rows: Tensor, steps: int, batch: Batch) -> Batch:
        """The batch of so many steps from each of `rows` [B] on, with what was seen before, between and behind them."""
        if self.frames is None:
            return batch
        seen = self.frames.windows(rows.tolist(), self._depth(rows).tolist(), steps + 1)
        return batch._replace(frames=to(self.device, seen))

    def _batch(self, rows: Tensor, *, time_limits_end: bool = False) -> Batch:
        near = self.near
        if isinstance(near, Table):
            return near.batch(rows.numpy(), time_limits_end=time_limits_end)
        kind = self.kind[rows]
        on = kind == _STEP if time_limits_end else kind != _TERMINATED
        return Batch(
            obs=self.obs[rows],
            act=self.act[rows],
            prior=self.prior[rows],
            reward=self.reward[rows],
            next_obs=self.obs[rows + 1],
            continues=on.float(),
        )

    def stacks(self, begin: int, end: int) -> Tensor:
        """What was seen at the rows from `begin` up to `end`, uint8 [rows, stack, channels, height, width]."""
        frames = self._some_frames
        first = max(begin - frames.stack + 1, 0)
        pictures = np.empty((end - first, *frames.shape), np.uint8)
        frames.read(first, pictures)
        rows = torch.arange(begin, end)
        back = torch.arange(frames.stack - 1, -1, -1)
        return torch.from_numpy(pictures)[rows[:, None] - torch.minimum(back, self._depth(rows)[:, None]) - first]

    def _depth(self, rows: Tensor) -> Tensor:
        """How many of the pictures of a stack lie before its row, int64 [B]."""
        depth, inside = torch.zeros_like(rows), torch.ones_like(rows, dtype=torch.bool)
        for back in range(1, self._some_frames.stack):
            inside &= (rows >= back) & (self.kind[(rows - back).clamp(min=0)] != _END)
            depth += inside
        return depth

    @property
    def _some_frames(self) -> Frames:
        assert self.frames is not None  # nobody looks where there is no camera
        return self.frames

    def since(self, transition: int) -> Tensor:
        """Rows of the transitions from number `transition` on."""
        return self._row_of[transition : self.transitions]

    def segments(self, starts: Tensor, length: int) -> Segments:
        """The `length` steps from each row of `starts` [...] on; every field starts with the axes [..., length]."""
        rows = starts.unsqueeze(-1) + torch.arange(length)
        near, there = self.near, to(self.device, rows)
        return Segments(to(self.device, self.seen(rows)), near.act[there], near.prior[there])

    def _observed(self, rows: Tensor) -> Tensor:
        return self.near.obs[to(self.device, rows)]

    def true_rewards(self, starts: npt.NDArray[np.int64], length: int) -> Floats:
        """True reward of the same steps, float32 [..., length]. For teachers and evaluation alone."""
        return self.true_reward.numpy()[starts[..., None] + np.arange(length)]

    def rewards(self, starts: npt.NDArray[np.int64], length: int) -> Floats:
        """Reward the agent is trained on, of the `length` steps from each of `starts` [...] on: [..., length]."""
        return self.reward.numpy()[starts[..., None] + np.arange(length)]

    def relabel(self, predict: Callable[[Tensor, Tensor, Tensor], Tensor]) -> None:
        """Rewrite the reward of every row by `predict(seen, act, prior)`, with the prior as it was stored."""
        near, at_once = self.near, _RELABEL_ROWS[kind_of(self.device)]
        for begin in range(0, self.rows, at_once):
            part = slice(begin, min(begin + at_once, self.rows))
            seen = to(self.device, self.seen(torch.arange(part.start, part.stop)))
            near.reward[part] = predict(seen, near.act[part], near.prior[part])
        if isinstance(near, Table):
            near.rewarded(self.rows)
        self.generation += 1

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
        state = {
            "rows": self.rows,
            "generation": self.generation,
            "transitions": [records.size, records.crc],
            "rewards": [rewards.size, rewards.crc],
            "next_obs": self.obs[self.rows].clone(),
        }
        return state if self.frames is None else state | {"frames": self.frames.save(folder / _FRAMES)}

    def load(self, folder: Path, state: State) -> None:
        """Continue from what `save` returned, on an empty experience; a `CheckpointError` where the logs lack it."""
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
        if self._table is not None:
            self._tell_apart()
            self._table.forget()
        if self.frames is not None:
            self.frames.load(folder / _FRAMES, state["frames"])
        kinds = self.kind[: self.rows].numpy()
        steps, ends = np.flatnonzero(kinds != _END), np.flatnonzero(kinds == _END)
        starts = np.concatenate([[0], ends + 1])
        self.episodes = [Episode(int(s), int(e - s)) for s, e in zip(starts[:-1], ends, strict=True)]
        self._episode_start = int(starts[-1])
        begins = steps - self.window + 1
        windows = begins[begins >= starts[np.searchsorted(ends, steps)]]
        self.transitions, self.windows = len(steps), len(windows)
        self._row_of = torch.cat((torch.from_numpy(steps), self._row_of[self.transitions :]))
        self._window_of = torch.cat((torch.from_numpy(windows), self._window_of[self.windows :]))

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
