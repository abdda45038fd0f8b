"""Pairs that no run asks: practice, in which the better clip is plain to see, and pairs that everybody is asked.

They are made of the task itself, from a policy that is known to do it, mixed with random actions; where none is known
practice is that of the toy car, and the pairs are of random actions.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rrm.envs import TASKS, make
from rrm.teachers.labels import PRACTICE, SHARED
from rrm.teachers.published import (
    PlayedEpisode,
    PublishedQuery,
    PublishedSession,
    ShownSegment,
    publish,
    segment_id,
)
from rrmctl.labelling.study import EXTRA

if TYPE_CHECKING:
    from rrm.types import Floats

#: Pairs of a practice round.
ROUND = 4
#: Shares of random actions in what everybody is shown.
_MIXED = (0.0, 0.3, 0.6, 1.0)

Policy = Callable[["Floats"], "Floats"]


class _Played(NamedTuple):
    episode: PlayedEpisode
    rewards: Floats
    success: Floats  #: of each step; NaN where the task has no such notion


def make_extra(folder: Path, task: str, length: int, shared: int) -> None:
    """Publish both kinds for a task into `folder`: segments of `length` actions; the same whenever it is called."""
    from rrm.envs.tasks import task as task_of

    known = task_of(task_of(task).expert or task).name
    practised = known if _policy(known) else "toy-car"
    _publish(folder, practised, PRACTICE, min(length, TASKS[practised].horizon), _practice)
    if shared:
        _publish(folder, known, SHARED, length, lambda task, length: _shared(task, length, shared))


def _publish(
    folder: Path, task: str, purpose: str, length: int, make_pairs: Callable[[str, int], Sequence[tuple[_Cut, _Cut]]]
) -> None:
    played: dict[int, int] = {}  # where in the file an episode stands
    episodes: list[PlayedEpisode] = []
    queries = []
    for index, pair in enumerate(make_pairs(task, length)):
        shown = []
        for each, begin in pair:
            if id(each) not in played:
                played[id(each)] = len(episodes)
                episodes.append(each.episode)
            window = slice(begin, begin + length)
            name = segment_id(task, each.episode.obs[:-1][window], each.episode.act[window])
            shown.append(ShownSegment(name, played[id(each)], begin, float(each.rewards[window].sum())))
        first, second = shown
        name = hashlib.sha256(f"{first.id} {second.id}".encode()).hexdigest()[:16]
        queries.append(PublishedQuery(index, name, first, second))
    session = PublishedSession(
        run="", task=task, step=EXTRA[purpose], length=length, repeat=1, horizon=TASKS[task].horizon,
        queries=tuple(queries),
    )  # fmt: skip
    publish(folder, session, episodes)


_Cut = tuple[_Played, int]


def _practice(task: str, length: int) -> list[tuple[_Cut, _Cut]]:
    """Where the task is done, and where nothing useful is; which of them is the first changes."""
    pairs: list[tuple[_Cut, _Cut]] = []
    seed = 0
    while len(pairs) < ROUND:
        good, bad = (_play(task, seed, mixed, 4 * length) for mixed in (0.0, 1.0))
        seed += 1
        done = np.flatnonzero(good.success > 0)
        if not len(done) and seed < 10 * ROUND:
            continue
        begin = max(0, min(int(done[0] if len(done) else 4 * length) + length // 4, len(good.rewards)) - length)
        pair = (good, begin), (bad, 0)
        pairs.append(pair if len(pairs) % 2 else pair[::-1])
    return pairs


def _shared(task: str, length: int, count: int) -> list[tuple[_Cut, _Cut]]:
    rng = np.random.default_rng(0)
    pairs: list[tuple[_Cut, _Cut]] = []
    played = [_play(task, 100 + at, mixed, 3 * length) for at in range(3) for mixed in _MIXED]
    while len(pairs) < count:
        first, second = rng.choice(len(played), size=2, replace=False)
        at = [int(rng.integers(len(played[each].rewards) - length + 1)) for each in (first, second)]
        pairs.append(((played[first], at[0]), (played[second], at[1])))
    return pairs


def _play(task: str, seed: int, mixed: float, steps: int) -> _Played:
    """An episode's beginning under the known policy, with a share of actions that wander."""
    env, rng, policy = make(task), np.random.default_rng(seed), _policy(task)
    obs, _ = env.reset(seed=seed)
    start, seen, acts, rewards, success = env.state_dict(), [obs], [], [], []
    wander = np.zeros(env.action_space.shape, np.float32)
    for _ in range(min(steps, env.horizon)):
        wander = (0.8 * wander + 0.6 * rng.normal(size=wander.shape)).astype(np.float32)
        known = policy(obs) if policy else wander
        act = np.clip((1 - mixed) * np.clip(known, -1, 1) + mixed * wander, -1, 1).astype(np.float32)
        obs, reward, _, _, info = env.step(act)
        seen.append(obs)
        acts.append(act)
        rewards.append(reward)
        success.append(info.get("success", np.nan))
    env.close()
    episode = PlayedEpisode(start, np.array(seen, np.float32), np.array(acts, np.float32))
    return _Played(episode, np.array(rewards, np.float32), np.array(success, np.float32))


def _policy(task: str) -> Policy | None:
    spec = TASKS[task]
    if spec.suite == "metaworld":
        from rrm.envs.metaworld import scripted_policy

        return scripted_policy(task)
    if spec.suite in ("dmc", "panda"):
        return None
    return lambda obs: (2 * (spec.feature("goal", obs) - spec.feature("hand", obs))).astype(np.float32)
