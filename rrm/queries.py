"""Which pairs of segments to ask about (PEBBLE's samplers; B-Pref, appendix)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import torch

from rrm.buffers.pairs import Rows

if TYPE_CHECKING:
    from rrm.buffers.experience import Episode, Experience
    from rrm.config import FeedbackConfig
    from rrm.interfaces import RewardFunction

_SCORED_AT_ONCE = 128  # pairs per forward pass of the ensemble
_CENTERS_AT_ONCE = 256  # rows of the distance matrix of k-center


def uniform_pairs(episodes: Sequence[Episode], segment: int, count: int, rng: np.random.Generator) -> Rows:
    """`count` pairs of segments of `segment` steps: first rows, int64 [count, 2].

    Every segment is an independent uniform draw of an episode that is long enough, then of a start within it, its last
    possible start included.
    """
    starts = np.array([e.start for e in episodes if e.length >= segment], np.int64)
    lengths = np.array([e.length for e in episodes if e.length >= segment], np.int64)
    if not len(starts):
        raise ValueError(f"none of {len(episodes)} episodes holds a segment of {segment} steps")
    chosen = rng.integers(len(starts), size=(count, 2))
    offsets = rng.integers(lengths[chosen] - segment + 1)
    rows: Rows = starts[chosen] + offsets
    return rows


def select(
    config: FeedbackConfig,
    count: int,
    *,
    segment: int,
    experience: Experience,
    reward: RewardFunction,
    labelled: Rows,
    rng: np.random.Generator,
    first: bool,
) -> Rows:
    """The `count` pairs to ask about now: first rows, int64 [count, 2].

    Args:
        segment: steps of a segment, the learner's margins included.
        labelled: pairs answered before, which k-center keeps its distance from, int64 [n, 2].
        first: the first session asks uniformly, since the reward has learned nothing to disagree about.
    """
    episodes = experience.episodes[-config.window :]
    if first or config.sampler == "uniform":
        return uniform_pairs(episodes, segment, count, rng)
    pool = uniform_pairs(episodes, segment, config.pool * count, rng)
    spread_out = config.sampler.startswith("kcenter")
    score = config.sampler.removeprefix("kcenter").removeprefix("-")
    if score:
        probability = member_probabilities(experience, reward, pool, segment)
        values = disagreement(probability) if score == "disagreement" else mean_entropy(probability)
        keep = max(count, len(pool) // 2) if spread_out else count
        pool = pool[np.argsort(-values, kind="stable")[:keep]]
    if spread_out:
        pool = pool[_kcenter(_states(experience, pool, segment), _states(experience, labelled, segment), count)]
    return pool


def member_probabilities(
    experience: Experience, reward: RewardFunction, pairs: Rows, segment: int
) -> npt.NDArray[np.float32]:
    """Probability by every member that the second segment is preferred, float32 [N, n]."""
    parts = []
    with torch.no_grad():
        for rows in torch.split(torch.from_numpy(pairs), _SCORED_AT_ONCE):
            first, second = (reward.members(experience.segments(rows[:, i], segment)).sum(-1) for i in (0, 1))
            parts.append(torch.sigmoid(second - first))
    return torch.cat(parts, dim=-1).cpu().numpy()


def disagreement(probability: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Standard deviation over the members of [N, n] probabilities: [n]."""
    spread: npt.NDArray[np.float32] = probability.std(axis=0, ddof=1) if len(probability) > 1 else probability[0] * 0
    return spread


def mean_entropy(probability: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Mean over the members of the binary entropy, nats, of [N, n] probabilities: [n]."""
    p = np.clip(probability, 1e-7, 1 - 1e-7)
    entropy: npt.NDArray[np.float32] = -(p * np.log(p) + (1 - p) * np.log1p(-p)).mean(axis=0)
    return entropy


def _states(experience: Experience, pairs: Rows, segment: int) -> npt.NDArray[np.float32]:
    obs = experience.segments(torch.from_numpy(pairs), segment).obs
    return obs.flatten(1).cpu().numpy()


def _kcenter(points: npt.NDArray[np.float32], centers: npt.NDArray[np.float32], count: int) -> npt.NDArray[np.int64]:
    """Greedy farthest-first: which `count` of `points` [n, D], each farthest from `centers` [m, D] and those chosen."""
    nearest = np.full(len(points), np.inf, np.float32)
    for begin in range(0, len(centers), _CENTERS_AT_ONCE):
        part = torch.from_numpy(centers[begin : begin + _CENTERS_AT_ONCE])
        np.minimum(nearest, torch.cdist(torch.from_numpy(points), part).amin(dim=1).numpy(), out=nearest)
    chosen = []
    for _ in range(count):
        pick = int(nearest.argmax())
        chosen.append(pick)
        np.minimum(nearest, np.linalg.norm(points - points[pick], axis=1), out=nearest)
        nearest[pick] = -1.0
    return np.array(chosen, np.int64)
