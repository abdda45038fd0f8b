"""Which methods are separated so far, and how many more seeds would likely decide.

Each pair of methods of a task: the difference of their interquartile means,
the probability that a run of the one beats a run of the other, the decision
of a sequential test, and where it is open, how many seeds more would likely
separate them. Of every run its mean score over training is compared. The
rules are those of `rrmctl run NAME --until-decided` where that was begun.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rrmctl.reports.columns import METHOD, NOTHING, PLACE, SCORE, Column, Row, estimated
from rrmctl.reports.pairwise import Contest, Contests, decide, without_score
from rrmctl.reports.report import Report, section_report
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import BOOTSTRAP_SEED, LEVEL, SURE, Statistics
from rrmctl.stats import Iqm, difference, improvement, outlook
from rrmctl.store.frame import MAYBE_WHOLE, NUMBER, TEXT, WHOLE

EXPERIMENTS: tuple[str, ...] = ()
EXPLAINED = (
    "Compared is each seed's mean score over training. Difference: interquartile mean of the method minus that of the "
    "other, seeds unpaired. P(better): a run of the method beats one of the other, ties by half. n: runs of both.",
    "Decision: group-sequential permutation test of the means after every group of seeds, Holm's step-down over all "
    "comparisons, one error rate for all of them together; in brackets the seeds it took. It holds where the rules "
    "were fixed before the runs: `rrmctl run NAME --until-decided --max-seeds N` fixes them.",
    "More seeds: after so many, half of the futures imagined from the runs so far are decided; in brackets the share "
    "by the most seeds there may be. A help for planning that believes the runs so far, too hopeful with few.",
)

#: The test's decisions in words, about the method as against the other.
DECISIONS = {"larger": "better", "smaller": "worse", "equal": "not separated", "open": "open"}


def _fewest(row: Row) -> int:
    return int(min(row["n"], row["n_against"]))


def _more(row: Row) -> str:
    """`5 (80 % by 20)`, where so many seeds more are likely enough and there may be 20 in all."""
    if np.isnan(row["chance"]):
        return NOTHING
    likely = f"> {max(0, row['most'] - _fewest(row))}" if row["more"] is None else f"{row['more']}"
    return f"{likely} ({100 * row['chance']:.0f} % by {row['most']})"


COLUMNS = (
    *PLACE, METHOD, Column("against", TEXT, "Against"), SCORE,
    Column("n", WHOLE, "n", lambda row: f"{row['n']}:{row['n_against']}"), Column("n_against", WHOLE),
    *estimated("difference", "Difference", n=_fewest),
    *estimated("improvement", "P(better)", "improvement_", f"its {SURE}", score=lambda _: "success", n=_fewest),
    Column(
        "decision", TEXT, "Decision",
        lambda row: f"{row['decision']} ({row['seeds']})" if row["seeds"] else row["decision"],
    ),
    Column("seeds", WHOLE), Column("more", MAYBE_WHOLE, "More seeds", _more), Column("chance", NUMBER),
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section."""
    reports = []
    for section in sections:
        contests, refused = decide(section, section.trial), [*without_score(section)]
        design, compared = contests.design, len(contests.all)
        notes = [
            *refused,
            *(["Compared is the mean score over training, whatever --final says."] if settings.last > 1 else []),
            f"Decisions: after every {design.group} seeds, at most {design.looks} times, over {compared} "
            f"comparisons with one error rate of {100 * design.alpha:g} %.",
        ]
        if section.trial is None:
            notes.append(
                "No rules were fixed before these runs: the error rate holds only if how many seeds there are did not "
                "follow from what they showed."
            )
        rules = {
            "group": design.group, "looks": design.looks, "alpha": design.alpha, "comparisons": compared,
            "fixed_in_advance": section.trial is not None,
        }  # fmt: skip
        rows = [_row(contest, contests, settings) for contest in contests.all if contest.ours.size]
        facts: dict[str, Any] = {"test": rules, "problems": [*section.problems, *refused]}
        reports.append(section_report(section, replace(settings, last=1), COLUMNS, rows, notes=notes, **facts))
    return reports


def _row(contest: Contest, contests: Contests, settings: Statistics) -> dict[str, Any]:
    both, verdict = ([contest.ours], [contest.theirs]), contest.verdict
    rng = [np.random.default_rng([BOOTSTRAP_SEED, stream]) for stream in range(3)]
    apart = difference(*both, Iqm(settings.kind), rng=rng[0], replicates=settings.replicates, level=LEVEL)
    wins = improvement(*both, rng=rng[1], replicates=settings.replicates, level=LEVEL)
    ahead = outlook(contest.tested, verdict, contests.remaining, rng=rng[2]) if verdict.decision == "open" else None
    return {
        **contest.pair._asdict(), "score": contest.score, "n": contest.ours.size, "n_against": contest.theirs.size,
        **apart.row("difference"), **wins.row("improvement", "improvement_"),
        "decision": DECISIONS[verdict.decision], "seeds": verdict.looks * contests.design.group,
        "more": ahead.more if ahead else None, "chance": ahead.share if ahead else np.nan,
        "most": contests.design.seeds,
    }  # fmt: skip
