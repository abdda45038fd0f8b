"""Demonstrations: transitions of whole episodes and where they come from, in one safetensors file.

Tensors: `obs` and `next_obs` float32 [n, O], `act` float32 [n, A], `terminated` uint8 [n], all episodes one behind the
other; `lengths` int64 [E], `returns` float64 [E] (true, undiscounted), `successes` float64 [E] (NaN where the task has
no such notion). The header has one entry, `demonstrations`: a JSON object whose `format` names this layout and whose
`provenance` is an object with `task`, `source`, and whatever else is known; see `rrm.tensors` for its checksum.

Where an agent is to see frames, there is one picture of every state, an episode's last included, in a raw file beside
it: uint8 [n + E, channels, height, width]. The object's `frames` has its `size` and `crc`, and the camera's `space`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import numpy.typing as npt

from rrm import tensors
from rrm.envs.spaces import FrameSpace
from rrm.errors import CheckpointError, DemosError
from rrm.files import UnfitFileError, place, read_bounded, write_atomically

if TYPE_CHECKING:
    from torch import Tensor

    from rrm.buffers.frames import Frames
    from rrm.envs.tasks import Task
    from rrm.types import Batch, Floats

DEMOS_FORMAT = "rrm-demonstrations-1"
_ENTRY = "demonstrations"
_LARGEST = 2**34  # bytes


@dataclass(frozen=True, kw_only=True)
class Demonstrations:
    """Episodes of an expert."""

    obs: Floats  #: float32 [n, O]
    act: Floats  #: float32 [n, A], in [-1, 1]
    next_obs: Floats  #: float32 [n, O]
    terminated: npt.NDArray[np.uint8]  #: [n]; 1 where the task ended there, which a time limit is not
    lengths: npt.NDArray[np.int64]  #: [E], steps of the episodes
    returns: npt.NDArray[np.float64]  #: [E], of the true reward
    successes: npt.NDArray[np.float64]  #: [E], 0 or 1; NaN where the task has no such notion
    provenance: Mapping[str, Any]  #: JSON: task, source, ...
    frames: Frames | None = None  #: n + E, of every state in order, where there are any

    def __len__(self) -> int:
        return len(self.obs)

    @property
    def success(self) -> float:
        """Share of the episodes with success; NaN where the task has no such notion."""
        return float(self.successes.mean())

    def summary(self) -> dict[str, Any]:
        """For people and for what is made of them: provenance, sizes, and how good they are."""
        success = None if np.isnan(self.success) else self.success
        sizes = {"episodes": len(self.lengths), "transitions": len(self)}
        sizes |= {} if self.frames is None else {"pictures": len(self.frames)}
        return {**self.provenance, **sizes, "success": success, "true_return": float(self.returns.mean())}

    def batch(self, numbers: Tensor) -> Batch:
        """Transitions by number, int64 [B], with what is seen before and behind them where there are frames."""
        import torch

        from rrm.types import Batch

        at = numbers.numpy()
        obs, act, next_obs, ended = (torch.from_numpy(getattr(self, name)[at]) for name in _PER_STEP)
        blank, frames = torch.zeros(len(at)), None
        if self.frames is not None:
            ends = self.lengths.cumsum()
            episode = np.searchsorted(ends, at, side="right")
            depths = at - (ends - self.lengths)[episode]
            frames = self.frames.windows((at + episode).tolist(), depths.tolist(), 2)
        return Batch(obs, act, blank, blank, next_obs, 1.0 - ended.float(), frames)

    def save(self, path: str | Path) -> None:
        """Write the file, whole or not at all, and first the pictures. Raises OSError where there is no room or
        permission.
        """
        header: dict[str, Any] = {"format": DEMOS_FORMAT, "provenance": dict(self.provenance)}
        if self.frames is not None:
            header["frames"] = {"space": asdict(self.frames.space), **self.frames.save(film_of(place(path)))}
        arrays = {name: np.ascontiguousarray(getattr(self, name)) for name in _KINDS}
        write_atomically(place(path), tensors.pack(arrays, _ENTRY, header))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """The demonstrations in a file; a `DemosError` where it holds none, is damaged, or its tensors do not fit."""
        try:
            arrays, header = tensors.unpack(read_bounded(place(path), _LARGEST), _ENTRY)
        except (FileNotFoundError, NotADirectoryError, UnfitFileError, ValueError) as error:
            raise DemosError(f"{path} cannot be read as demonstrations: {error}") from error
        provenance = header.get("provenance")
        if header.get("format") != DEMOS_FORMAT or not isinstance(provenance, dict):
            raise DemosError(f"{path} is not a file of demonstrations: its header does not say {DEMOS_FORMAT}")
        missing = [name for name in _KINDS if name not in arrays]
        if missing:
            raise DemosError(f"{path} lacks {', '.join(missing)}")
        frames = _opened(film_of(place(path)), header["frames"]) if "frames" in header else None
        demos = cls(**{name: arrays[name] for name in _KINDS}, provenance=provenance, frames=frames)
        problem = demos._problem()
        if not problem and frames is not None and len(frames) != len(demos) + len(demos.lengths):
            problem = f"there are {len(frames)} pictures of {len(demos) + len(demos.lengths)} states"
        if problem:
            raise DemosError(f"{path}: {problem}")
        return demos

    def _problem(self) -> str | None:
        count, episodes = len(self), len(self.lengths)
        for name, (kind, axes) in _KINDS.items():
            array = getattr(self, name)
            if array.dtype != kind or array.ndim != axes:
                return f"{name} is {array.dtype} with {array.ndim} axes, not {np.dtype(kind)} with {axes}"
            if len(array) != (count if name in _PER_STEP else episodes):
                return f"{name} has {len(array)} entries; there are {count} transitions in {episodes} episodes"
        if not episodes or self.lengths.min() < 1 or self.lengths.sum() != count:
            return f"the episodes' lengths add up to {self.lengths.sum()}, there are {count} transitions"
        if self.obs.shape != self.next_obs.shape:
            return f"obs has shape {self.obs.shape}, next_obs {self.next_obs.shape}"
        if not all(np.isfinite(array).all() for array in (self.obs, self.act, self.next_obs, self.returns)):
            return "not all of it is finite"
        return "an action lies outside [-1, 1]" if np.abs(self.act).max() > 1 else None

    def check(self, task: Task, where: str, frames: FrameSpace | None = None, repeat: int = 1) -> None:
        """Refuse demonstrations of another task, with a `DemosError` that names `where` they come from.

        Args:
            frames: what is seen of it; None where nobody looks.
            repeat: steps of the environment that an action lasts.
        """
        shown = self.provenance.get("task", task.name)
        if shown != task.name:
            raise DemosError(f"{where} shows {shown}, not {task.name}")
        shapes = (self.obs.shape[1], self.act.shape[1])
        if shapes != (task.spaces.obs, task.spaces.act):
            raise DemosError(
                f"{where}: observations of {shapes[0]} and actions of {shapes[1]} numbers; "
                f"{task.name} has {task.spaces.obs} and {task.spaces.act}"
            )
        lasting = self.provenance.get("action_repeat", 1)
        if lasting != repeat:
            raise DemosError(f"{where}: an action lasts {lasting} steps, not action_repeat = {repeat}")
        if frames is not None and (self.frames is None or self.frames.space != frames):
            held = "no pictures" if self.frames is None else f"pictures of {self.frames.space}"
            raise DemosError(f"{where} holds {held}; this run's agent sees {frames}")


def film_of(path: Path) -> Path:
    """Where the pictures of the demonstrations in a file lie."""
    return path.with_name(f"{path.name}.frames")


def _opened(path: Path, described: Any) -> Frames:
    from rrm.buffers.frames import Frames

    try:
        frames = Frames(FrameSpace(**described["space"]))
        frames.load(path, described, finished=True)
    except (CheckpointError, KeyError, TypeError, ValueError) as error:
        raise DemosError(f"the pictures of the demonstrations cannot be read: {error}") from error
    return frames


_KINDS: dict[str, tuple[type[np.generic], int]] = {
    "obs": (np.float32, 2), "act": (np.float32, 2), "next_obs": (np.float32, 2), "terminated": (np.uint8, 1),
    "lengths": (np.int64, 1), "returns": (np.float64, 1), "successes": (np.float64, 1),
}  # fmt: skip
_PER_STEP = ("obs", "act", "next_obs", "terminated")
