"""Bootstrap intervals of the interquartile mean, beside rliable's: replicates per second, tasks as strata.

Final scores are a matrix of runs x tasks; curves have an evaluation axis besides, and an interval at each evaluation.
Both programs go from scores to estimate and interval. They draw different numbers, so their intervals agree within
Monte-Carlo error and no closer; that they do is checked, with every answer that was timed.

The floor is the drawing of the runs, and one product of ordered scores and weights (already floating-point) for each
evaluation.
"""

from __future__ import annotations

import importlib.util
import math
import sys
from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from benchmarks.lines import Line, in_turns
from rrmctl.stats import Estimate, Iqm, bootstrap, resample

Floats = npt.NDArray[np.float64]

RUNS, TASKS, EVALUATIONS = 10, 8, 100
REPLICATES = 2_000
LEVEL = 0.95

#: Of ours behind the comparison, so that the error is mostly the other's.
_MANY = 50_000

#: Standard errors by which the two may differ; with two hundred ends to compare, chance alone stays below five.
_ERRORS = 5.0


def lines() -> list[Line]:
    curves = learning_curves()
    return [
        _line(f"IQM bootstrap, final scores, {RUNS} x {TASKS}", curves[..., -1], turns=9),
        _line(f"IQM bootstrap, curves, {RUNS} x {TASKS} x {EVALUATIONS}", curves, turns=3),
    ]


def learning_curves() -> Floats:
    """Scores of runs that learn at speeds of their own, without ties: [run, task, evaluation]."""
    rng = np.random.default_rng(0)
    learned = rng.uniform(0.2, 1.2, size=(RUNS, TASKS, 1)) * np.linspace(0.0, 1.0, EVALUATIONS)
    return np.clip(learned, 0.0, 1.0) + rng.normal(0.0, 0.1, size=learned.shape)


def _line(item: str, scores: Floats, turns: int) -> Line:
    strata = [scores[:, task] for task in range(TASKS)]
    answers: list[tuple[Floats, Floats]] = []

    def ours() -> Estimate:
        return bootstrap(strata, Iqm(), rng=np.random.default_rng(0), replicates=REPLICATES, level=LEVEL)

    rliable = _rliable(scores)
    timed: list[Callable[[], object]] = [ours, _least(scores)]
    if rliable is not None:
        timed.append(lambda: answers.append(rliable()))
    rates = [REPLICATES / seconds for seconds in in_turns(*timed, turns=turns)]
    if answers:
        _check(ours(), resample(strata, Iqm(), rng=np.random.default_rng(1), replicates=_MANY), answers)
    return Line(
        item=item, ours=rates[0], unit="/s", floor=rates[1], peers={"rliable": rates[2]} if answers else {},
        least_ratio=100.0, note=f"{REPLICATES:,} replicates",
    )  # fmt: skip


def _least(scores: Floats) -> Callable[[], object]:
    """What no program that draws the same runs can leave out."""
    rng = np.random.default_rng(0)
    evaluations = math.prod(scores.shape[2:])
    ordered, weights = rng.random(RUNS * TASKS), rng.random((RUNS * TASKS, REPLICATES))

    def work() -> None:
        for _ in range(TASKS):
            rng.integers(RUNS, size=(REPLICATES, RUNS), dtype=np.int32)
        for _ in range(evaluations):
            ordered @ weights

    return work


def _rliable(scores: Floats) -> Callable[[], tuple[Floats, Floats]] | None:
    """Point estimate and interval [2, ...] by rliable; None where it is not installed."""
    arch = importlib.util.find_spec("arch")
    if arch is None or importlib.util.find_spec("rliable") is None:
        return None
    # The package behind rliable's bootstrap loads models of markets first, which do not import with pandas 3. The
    # bootstrap does without them.
    sys.modules.setdefault("arch", importlib.util.module_from_spec(arch))
    from rliable import library, metrics

    def statistic(drawn: Floats) -> Floats:
        if drawn.ndim == 2:
            return np.array([metrics.aggregate_iqm(drawn)])
        return np.array([metrics.aggregate_iqm(drawn[..., at]) for at in range(drawn.shape[-1])])

    def work() -> tuple[Floats, Floats]:
        points, intervals = library.get_interval_estimates(
            {"": scores}, statistic, reps=REPLICATES, confidence_interval_size=LEVEL
        )
        return points[""], intervals[""]

    np.random.seed(0)  # rliable draws from the global generator
    return work


def _check(ours: Estimate, draws: Floats, answers: Sequence[tuple[Floats, Floats]]) -> None:
    """Refuse figures of two programs that do not compute the same.

    Args:
        draws: many of our replicates, [R, ...].
        answers: rliable's estimates [...] and ends [2, ...].

    Raises:
        ValueError: estimates differ by more than rounding, or ends by more than the Monte-Carlo error of both.
    """
    for point, _ in answers:
        if not np.allclose(ours.estimate, point, rtol=1e-12):
            raise ValueError(f"the estimates differ: {ours.estimate} and {point}")
    ends = np.mean([interval for _, interval in answers], axis=0)
    for tail, end in zip(((1 - LEVEL) / 2, (1 + LEVEL) / 2), ends, strict=True):
        # In quantiles, whose error is the same for every distribution.
        slack = _ERRORS * math.sqrt(tail * (1 - tail) * (1 / len(draws) + 1 / (REPLICATES * len(answers))))
        least, most = np.quantile(draws, [tail - slack, tail + slack], axis=0)
        if ((end < least) | (end > most)).any():
            raise ValueError(f"an end of the interval differs by more than chance: {end}, ours {least} to {most}")
