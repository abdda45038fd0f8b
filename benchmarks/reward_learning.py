"""Reward learning: one epoch over the labels and one relabelling, beside what the arithmetic alone would allow.

The floor is taken at the best rate of products that `benchmarks.sac_update` takes, in float32 or bfloat16.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import torch

from benchmarks.lines import Line, in_turns
from benchmarks.sac_update import ACT, OBS, best_products, products_flop
from rrm.buffers.experience import Experience
from rrm.buffers.pairs import PairRing, Preferences, StoredFeedback
from rrm.config import RewardConfig, SacConfig
from rrm.envs import Spaces
from rrm.nets.precision import multiplies
from rrm.precision import Precision
from rrm.rewards.ensemble import ResidualReward
from rrm.rewards.pebble import Pebble
from rrm.types import Transition

ROWS, EPISODE = 500_000, 500
LABELS, SEGMENT = 640, 50
CONFIG = RewardConfig(epochs=1, target_accuracy=1.0)


def lines() -> Iterator[Line]:
    """The paper's sizes in both precisions."""
    torch.set_num_threads(1)
    experience = lived()
    for precision in ("float32", "bfloat16") if multiplies("bfloat16") else ("float32",):
        yield from _lines(experience, precision)


def _lines(experience: Experience, precision: Precision) -> Iterator[Line]:
    reward = ResidualReward(CONFIG, OBS, ACT, torch.Generator().manual_seed(0), precision=precision)
    learner = Pebble(reward, CONFIG, np.random.default_rng(0))
    labels = labelled(experience)
    epoch_s, relabel_s, products_s = in_turns(
        lambda: learner.fit(labels),
        lambda: experience.relabel(reward.predict),
        best_products(SacConfig(), precision),
        turns=3,
    )
    rate = products_flop(SacConfig()) / products_s
    forward, backward = _flop_per_row()
    least = 0.70 if precision == "float32" else None
    steps = 2 * SEGMENT * LABELS
    yield Line(
        item=f"reward epoch, {LABELS} labels, {precision}", ours=epoch_s, unit="s", least_share=least,
        floor=steps * (forward + backward) / rate,
    )  # fmt: skip
    yield Line(
        item=f"relabelling {ROWS:,} transitions, {precision}", ours=relabel_s, unit="s", least_share=least,
        floor=ROWS * forward / rate,
    )  # fmt: skip


def _flop_per_row() -> tuple[float, float]:
    """Operations of the matrix products of the ensemble, forward and backward, for one step of one segment."""
    first, inner, last = (OBS + ACT + 1) * CONFIG.hidden, (CONFIG.layers - 1) * CONFIG.hidden**2, CONFIG.hidden
    forward = 2.0 * CONFIG.members * (first + inner + last)
    return forward, 2 * forward - 2.0 * CONFIG.members * first  # nobody needs the gradient in the inputs


def lived(device: str = "cpu") -> Experience:
    """Random transitions in episodes of Meta-World's length."""
    rng = np.random.default_rng(0)
    experience = Experience(ROWS, EPISODE, Spaces(OBS, ACT), device=device)
    obs = rng.standard_normal((1000, OBS), np.float32)
    act = rng.uniform(-1, 1, (1000, ACT)).astype(np.float32)
    for step in range(ROWS):
        ends = step % EPISODE == EPISODE - 1
        lived = Transition(obs[step % 1000], act[step % 1000], obs[(step + 1) % 1000], 0.0, 0.0, 0.0, False, ends)
        experience.append(lived, 0.0)
    return experience


def labelled(experience: Experience, labels: int = LABELS) -> StoredFeedback:
    """So many labels of random pairs."""
    rng = np.random.default_rng(1)
    starts = np.array([episode.start for episode in experience.episodes])
    preferences = Preferences(labels, SEGMENT)
    preferences.add(rng.choice(starts, (labels, 2)), rng.integers(0, 2, labels).astype(np.float32))
    return StoredFeedback(experience, preferences, PairRing(1, SEGMENT), labels)
