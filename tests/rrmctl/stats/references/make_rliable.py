"""Make rliable.json: what rliable computes for a few matrices of scores. Needs the extra `bench`.

python -m tests.rrmctl.stats.references.make_rliable
"""

from __future__ import annotations

import importlib.util
import json
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np

# The package behind rliable's bootstrap first loads models of markets, which do not import with pandas 3; the bootstrap
# does without them.
sys.modules.setdefault("arch", importlib.util.module_from_spec(importlib.util.find_spec("arch")))
from rliable import library, metrics  # noqa: E402

REPLICATES = 20_000


def cases() -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Pairs of score matrices [runs, tasks]: ten episodes a run, five seeds, normal returns, and saturated ones."""
    rng = np.random.default_rng(2306)
    episodes = rng.binomial(10, 0.6, (10, 4)) / 10, rng.binomial(10, 0.4, (8, 4)) / 10
    few = rng.beta(2, 1, (5, 3)), rng.beta(1, 2, (5, 3))
    returns = rng.normal(0.5, 0.4, (12, 1)), rng.normal(0.7, 0.2, (10, 1))
    saturated = np.ones((6, 2)), np.column_stack([np.ones(6), rng.binomial(10, 0.7, 6) / 10])
    return {"episodes": episodes, "few": few, "returns": returns, "saturated": saturated}


def measured(ours: np.ndarray, theirs: np.ndarray) -> dict[str, object]:
    """Every estimate and 95 % percentile interval that both programs know."""
    estimates = {
        "iqm": metrics.aggregate_iqm,
        "mean": metrics.aggregate_mean,
        "optimality_gap": metrics.aggregate_optimality_gap,
    }
    found: dict[str, object] = {"ours": ours.tolist(), "theirs": theirs.tolist()}
    for name, function in estimates.items():
        point, interval = intervals({"x": ours}, lambda scores, f=function: np.array([f(scores)]))
        found[name] = [point[0], *interval[:, 0]]
    point, interval = intervals(
        {"x": [ours, theirs]}, lambda x, y: np.array([metrics.probability_of_improvement(x, y)])
    )
    found["improvement"] = [point[0], *interval[:, 0]]
    thresholds = np.linspace(0.0, 1.0, 11)
    np.random.seed(0)
    profile, band = library.create_performance_profile({"x": ours}, thresholds, reps=REPLICATES)
    found["thresholds"], found["profile"] = thresholds.tolist(), [profile["x"].tolist(), *band["x"].tolist()]
    return found


def intervals(scores: dict, function: object) -> tuple[np.ndarray, np.ndarray]:
    """Rliable's point estimate and interval; its resampling uses numpy's global generator."""
    np.random.seed(0)
    points, found = library.get_interval_estimates(scores, function, reps=REPLICATES)
    return points["x"], found["x"]


def main() -> None:
    """Write the file beside this script."""
    versions = {name: version(name) for name in ("rliable", "arch", "numpy", "scipy")}
    values = {name: measured(*pair) for name, pair in cases().items()}
    told = {"made_by": "make_rliable.py", "versions": versions, "replicates": REPLICATES, "cases": values}
    Path(__file__).with_name("rliable.json").write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
