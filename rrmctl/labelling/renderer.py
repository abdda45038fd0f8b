"""The process that draws: a JSON line in asks for a clip, or for what everybody is asked; a line out answers.

A clip is a sprite: all its frames in one WebP, each in a cell whose edge repeats the frame's, as neighbours would bleed
into what is scaled. An episode is lived again from its start; what then differs from what was published is not shown.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import sys
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rrm.errors import LabelError, RenderingError, RrmError
from rrm.files import replace

if TYPE_CHECKING:
    from rrm.envs.base import TaskEnv
    from rrm.teachers.published import PlayedEpisode, PublishedSession
    from rrm.types import Pixels

PAD = 8  #: pixels around each frame
_QUALITY = 80
_COLUMNS = 8


def frames(env: TaskEnv, session: PublishedSession, episode: PlayedEpisode, begin: int) -> Iterator[Pixels]:
    """The pictures of a segment: before its first action, and after each.

    Raises:
        LabelError: living the episode again gives other observations than were published.
        RenderingError: nothing draws here.
    """
    env.load_state_dict(episode.start)
    for at, act in enumerate(episode.act[: begin + session.length]):
        if at == begin:
            yield _picture(env)
        for _ in range(session.repeat):
            obs, _, _, over, _ = env.step(act)
            if over:
                break
        if not np.array_equal(obs, episode.obs[at + 1], equal_nan=True):
            raise LabelError(f"lived again, the episode differs from step {at + 1} on: was it another kind of machine?")
        if at >= begin:
            yield _picture(env)


def _picture(env: TaskEnv) -> Pixels:
    picture = env.render()
    assert isinstance(picture, np.ndarray)
    return picture


def sprite(pictures: list[Pixels]) -> tuple[bytes, dict[str, int]]:
    """The WebP of a clip, and what tells where its frames are."""
    import cv2

    edge = ((PAD, PAD), (PAD, PAD), (0, 0))
    cells = [np.pad(picture, edge, mode="edge") for picture in pictures]
    cells += [np.zeros_like(cells[0])] * (-len(cells) % _COLUMNS)
    rows = [np.concatenate(cells[at : at + _COLUMNS], axis=1) for at in range(0, len(cells), _COLUMNS)]
    sheet = np.ascontiguousarray(np.concatenate(rows)[..., ::-1])
    webp: bytes = cv2.imencode(".webp", sheet, [cv2.IMWRITE_WEBP_QUALITY, _QUALITY])[1].tobytes()
    height, width = pictures[0].shape[:2]
    return webp, {"frames": len(pictures), "columns": _COLUMNS, "width": width, "height": height, "pad": PAD}


@lru_cache(maxsize=4)
def _env(task: str, horizon: int, ranges: frozenset[tuple[str, tuple[float, float]]]) -> TaskEnv:
    from rrm.envs import make

    return make(task, horizon, dict(ranges), render_mode="rgb_array")


@lru_cache(maxsize=4)
def _opened(path: Path, _mark: int) -> tuple[PublishedSession, list[PlayedEpisode]]:
    from rrm.teachers.published import read_episodes, read_session

    return read_session(path), read_episodes(path)


def _draw(asked: Mapping[str, Any]) -> dict[str, Any]:
    path = Path(asked["path"])
    session, episodes = _opened(path, path.stat().st_mtime_ns)
    env = _env(session.task, session.horizon, frozenset(session.ranges.items()))
    webp, cells = sprite(list(frames(env, session, episodes[asked["episode"]], asked["begin"])))
    replace(Path(asked["out"]), webp)
    camera = json.dumps([session.task, cells, _QUALITY, env.metadata["render_fps"], _drawn_by(session.task)])
    return {
        **cells,
        "fps": env.metadata["render_fps"],
        "camera": hashlib.sha256(camera.encode()).hexdigest()[:16],
    }


def _drawn_by(task: str) -> str:
    """Other software, or another view, makes other pictures."""
    from rrm import __version__
    from rrm.envs import TASKS

    if "mujoco" not in TASKS[task].packages:
        return __version__
    from rrm.rendering import renderer

    return f"{__version__} {renderer().name}"


def _answer(asked: Mapping[str, Any]) -> dict[str, Any]:
    from rrmctl.labelling.practice import make_extra

    try:
        if "task" in asked:
            make_extra(Path(asked["folder"]), asked["task"], asked["length"], asked["shared"])
            return {}
        return _draw(asked)
    except RenderingError as error:
        return {"trouble": str(error)}
    except (RrmError, FileNotFoundError) as error:
        return {"refused": str(error)}


def main() -> None:
    """Answer until nobody asks any more. What libraries print goes to standard error."""
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)
    with contextlib.suppress(BrokenPipeError):
        for line in sys.stdin:
            answers.write(json.dumps(_answer(json.loads(line))) + "\n")


if __name__ == "__main__":
    main()
