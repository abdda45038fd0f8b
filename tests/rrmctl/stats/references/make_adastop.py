"""Make adastop.json: boundaries and decisions of the package `adastop` for single comparisons of few runs.

    python -m pip install adastop==0.1.3
    python make_adastop.py

The designs are small enough for it to go through every sequence of splits. It holds the absolute statistic against
quantiles of the signed one, so that its level is spent once in each direction: it is given half of ours.
"""

from __future__ import annotations

import json
from importlib.metadata import version
from pathlib import Path

import numpy as np
from adastop import MultipleAgentsComparator

#: Runs in a group, looks, and our level: shares that are no whole number of sequences, on which rounding would decide.
DESIGNS = ((5, 1, 0.05), (3, 2, 0.31), (4, 2, 0.101))
SHIFTS = (0.0, 1.0, 2.0)


def measured(group: int, looks: int, alpha: float, shift: float, rng: np.random.Generator) -> dict[str, object]:
    """One comparison, look after look until it is decided."""
    ours, theirs = rng.normal(shift, 1.0, group * looks), rng.normal(0.0, 1.0, group * looks)
    test = MultipleAgentsComparator(n=group, K=looks, B=10_000, alpha=alpha / 2, seed=0)
    for look in range(1, looks + 1):
        test.partial_compare({"ours": ours[: look * group], "theirs": theirs[: look * group]}, verbose=False)
        if test.is_finished:
            break
    return {
        "group": group, "looks": looks, "alpha": alpha, "ours": ours.tolist(), "theirs": theirs.tolist(),
        "boundaries": [float(high) for _, high in test.boundary], "decision": next(iter(test.decisions.values())),
    }  # fmt: skip


def main() -> None:
    """Write the file beside this script."""
    rng = np.random.default_rng(2306)
    found = [measured(*design, shift, rng) for design in DESIGNS for shift in SHIFTS for _ in range(3)]
    told = {"made_by": "make_adastop.py", "versions": {n: version(n) for n in ("adastop", "numpy")}, "cases": found}
    Path(__file__).with_name("adastop.json").write_text(json.dumps(told, indent=1) + "\n")


if __name__ == "__main__":
    main()
