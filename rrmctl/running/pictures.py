"""What the agent of a run sees, in one picture for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from rrmctl.errors import UserError
from rrmctl.running.config_file import load_config

if TYPE_CHECKING:
    from rrm.envs.spaces import FrameSpace
    from rrm.training.run_config import RunConfig
    from rrm.types import Pixels
    from rrmctl.store.layout import RunFolder

_MOMENTS = 8


def sheet(folder: RunFolder) -> tuple[bytes, str]:
    """A PNG, and what it is of, in words: a moment a column, its stack from the oldest picture down.

    Raises:
        UserError: the run's agent sees no pictures.
        RenderingError: nothing draws here, and the run has stored none.
    """
    import cv2

    from rrm.training.run_config import RunConfig

    config = load_config(folder)
    space = config.spaces.frames if isinstance(config, RunConfig) else None
    if space is None:
        raise UserError(
            f"run {folder.id} ({config.task}, {config.method}) sees no pictures", "it learns from states alone"
        )
    assert isinstance(config, RunConfig)
    stacks, source = _stored(folder.checkpoint / "frames.bin", space), "pictures that the run has stored"
    if not stacks:
        stacks, source = _played(config, space), "an episode of random actions"
    picture = np.array(stacks).transpose(1, 3, 0, 4, 2)  # stack and height, moments and width, channels
    rows = picture.reshape(space.stack * space.height, len(stacks) * space.width, space.channels)
    png: bytes = cv2.imencode(".png", np.ascontiguousarray(rows[..., ::-1]))[1].tobytes()
    return png, f"{len(stacks)} moments of {source}, each from its oldest picture down"


def _stored(path: Path, space: FrameSpace) -> Sequence[Pixels]:
    """Spread over what there is; the run may go on meanwhile. Now and then one belongs to two episodes."""
    rows = path.stat().st_size // math.prod(space.planar) if path.exists() else 0
    if rows < space.stack:
        return []
    pictures = np.memmap(path, np.uint8, "r", shape=(rows, *space.planar))
    return [pictures[begin : begin + space.stack] for begin in _spread(rows - space.stack)]


def _played(config: RunConfig, space: FrameSpace) -> Sequence[Pixels]:
    from rrm.envs.observer import Observer

    observer = Observer(config.task, config.horizon, space, config.action_repeat, config.env.ranges())
    rng = np.random.default_rng(0)
    try:
        seen = [observer.reset(seed=0).frames]
        for _ in range(config.episode_steps // config.action_repeat - 1):
            act = rng.uniform(-1.0, 1.0, config.spaces.act).astype(np.float32)
            seen.append(observer.step(act)[0].frames)
    finally:
        observer.close()
    return [frames for moment in _spread(len(seen) - 1) if (frames := seen[moment]) is not None]


def _spread(last: int) -> list[int]:
    return [round(last * moment / (_MOMENTS - 1)) for moment in range(_MOMENTS)]
