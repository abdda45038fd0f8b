"""Queries that a run puts before people: a file a session, `queries/<step>.safetensors` in the run's folder.

It holds what is needed to show both segments again, and no picture: every episode that a segment lies in, by the state
of its environment at its start and the actions taken since. Written by the run, read by whoever shows it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from rrm.errors import LabelError
from rrm.files import make_folder, read_bounded, refresh, write_atomically
from rrm.tensors import TREE, unpack

if TYPE_CHECKING:
    from rrm.types import Floats, State

FOLDER = "queries"
_LARGEST = 1 << 30  # bytes


@dataclass(frozen=True)
class ShownSegment:
    """One of the two segments of a query."""

    id: str  #: sixteen hex digits that stand for task, observations and actions, see `segment_id`
    episode: int  #: of the file's
    begin: int  #: its first step in that episode, counted in actions
    true_return: float  #: of the segment


@dataclass(frozen=True)
class PublishedQuery:
    """A question as people are asked it."""

    index: int  #: among all queries of the run, from 0
    query: str  #: its id in the run's journal
    first: ShownSegment
    second: ShownSegment


@dataclass(frozen=True, kw_only=True)
class PublishedSession:
    """The queries of one feedback session."""

    run: str  #: its identity
    task: str
    step: int  #: environment step before which they are asked
    length: int  #: actions of a segment
    repeat: int  #: environment steps that an action lasts
    horizon: int  #: environment steps of an episode
    queries: tuple[PublishedQuery, ...]
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)  #: what is drawn anew at every reset


class PlayedEpisode(NamedTuple):
    """How to live an episode again, up to the end of the last segment that is shown of it."""

    start: State  #: of the environment, before the first action
    obs: Floats  #: before each action and behind the last, float32 [n + 1, O]
    act: Floats  #: float32 [n, A]


def session_path(folder: Path, step: int) -> Path:
    """The file of the session before this step, in the folder of its run."""
    return folder / FOLDER / f"{step}.safetensors"


def published_steps(folder: Path) -> list[int]:
    """The steps of a run's sessions that were put before people, in their order."""
    refresh(folder)
    return sorted(int(path.stem) for path in (folder / FOLDER).glob("*.safetensors") if path.stem.isdecimal())


def publish(folder: Path, session: PublishedSession, episodes: Sequence[PlayedEpisode]) -> None:
    """Write a session's file, durably. One that holds the same already is left alone."""
    from rrm.checkpoint import encode

    path = session_path(folder, session.step)
    make_folder(path.parent)
    write_atomically(path, encode({"session": asdict(session), "episodes": [e._asdict() for e in episodes]}))


def read_session(path: Path) -> PublishedSession:
    """What is asked, without the episodes and without torch; a `LabelError` where the file holds no session."""
    try:
        _, tree = unpack(read_bounded(path, _LARGEST), TREE)
        return _session(tree["session"])
    except (ValueError, KeyError, TypeError) as error:
        raise LabelError(f"{path} holds no published session: {error}") from error


def read_episodes(path: Path) -> list[PlayedEpisode]:
    """The episodes of a session's file; raises as `read_session`."""
    from rrm.checkpoint import decode
    from rrm.errors import CheckpointError

    try:
        return [PlayedEpisode(**episode) for episode in decode(read_bounded(path, _LARGEST))["episodes"]]
    except (CheckpointError, KeyError, TypeError) as error:
        raise LabelError(f"{path} holds no published session: {error}") from error


def segment_id(task: str, obs: Floats, act: Floats) -> str:
    """Sixteen hex digits for what a segment shows, obs [T, O] and act [T, A], wherever it is stored."""
    digest = hashlib.sha256(task.encode())
    digest.update(np.ascontiguousarray(obs, np.float32).tobytes())
    digest.update(np.ascontiguousarray(act, np.float32).tobytes())
    return digest.hexdigest()[:16]


def _session(plain: dict[str, Any]) -> PublishedSession:
    queries = tuple(
        PublishedQuery(each["index"], each["query"], ShownSegment(**each["first"]), ShownSegment(**each["second"]))
        for each in plain["queries"]
    )
    ranges = {name: (low, high) for name, (low, high) in plain["ranges"].items()}
    return PublishedSession(**{**plain, "queries": queries, "ranges": ranges})
