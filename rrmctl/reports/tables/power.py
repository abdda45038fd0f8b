"""Which methods are separated so far, and how many more seeds would likely decide.

Each pair of methods of a task: the difference of their interquartile means,
the probability that a run of the one beats a run of the other, the decision
of a sequential test, and where it is open, how many seeds more would likely
separate them. Of every run its mean score over training is compared. The
rules are those of `rrmctl run NAME --until-decided` where that was begun.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from rrmctl.reports.captions import contents_notes, facts, statistics_notes, title
from rrmctl.reports.pairwise import Contest, Contests, decide, without_score
from rrmctl.reports.report import INTERVAL, NOTHING, Grid, Report, interval, number, place_columns
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import BOOTSTRAP_SEED, LEVEL, SURE, Statistics
from rrmctl.stats import Iqm, difference, improvement, outlook

if TYPE_CHECKING:
    import pandas as pd

EXPERIMENT = None
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

COLUMNS = (
    "task", "teacher", "feedback", "method", "against", "score", "n", "n_against", "difference", "low", "high",
    "improvement", "improvement_low", "improvement_high", "decision", "seeds", "more", "chance",
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each section."""
    return [_report(section, settings) for section in sections]


def _report(section: Section, settings: Statistics) -> Report:
    import pandas as pd

    found = decide(section, section.trial)
    rows = [_row(each, found, settings) for each in found.contests if each.ours.size]
    table = pd.DataFrame(rows, columns=list(COLUMNS)).astype({"more": "Int64"})
    refused = [why for series in section.series for why in without_score(series)]
    known = facts(section, settings) | {"test": _rules(section, found)}
    known["problems"] += refused
    notes = (*contents_notes(section), *refused, *_notes(section, found, settings))
    return Report(title(section), table, _grid(table, found), notes, known)


def _row(contest: Contest, contests: Contests, settings: Statistics) -> dict[str, Any]:
    both, verdict = ([contest.ours], [contest.theirs]), contest.verdict
    rng = [np.random.default_rng([BOOTSTRAP_SEED, stream]) for stream in range(3)]
    apart = difference(*both, Iqm(settings.kind), rng=rng[0], replicates=settings.replicates, level=LEVEL)
    wins = improvement(*both, rng=rng[1], replicates=settings.replicates, level=LEVEL)
    ahead = outlook(contest.tested, verdict, contests.remaining, rng=rng[2]) if verdict.decision == "open" else None
    return {
        **contest.pair._asdict(), "score": contest.score, "n": contest.ours.size, "n_against": contest.theirs.size,
        "difference": float(apart.estimate), "low": float(apart.low), "high": float(apart.high),
        "improvement": float(wins.estimate), "improvement_low": float(wins.low), "improvement_high": float(wins.high),
        "decision": DECISIONS[verdict.decision], "seeds": verdict.looks * contests.design.group,
        "more": ahead.more if ahead else None, "chance": ahead.share if ahead else np.nan,
    }  # fmt: skip


def _grid(table: pd.DataFrame, contests: Contests) -> Grid:
    """The table for people; columns that say nothing are left out."""
    columns = place_columns(table)
    columns |= {"Method": list(table["method"]), "Against": list(table["against"])}
    words, rows = len(columns), table.to_dict("records")
    columns["n"] = [f"{row['n']}:{row['n_against']}" for row in rows]
    columns["Difference"] = [number(row["difference"], row["score"]) for row in rows]
    columns[INTERVAL] = [
        interval(row["low"], row["high"], row["score"], min(row["n"], row["n_against"])) for row in rows
    ]
    columns["P(better)"] = [number(row["improvement"], "success") for row in rows]
    columns[f"its {SURE}"] = [
        interval(row["improvement_low"], row["improvement_high"], "success", min(row["n"], row["n_against"]))
        for row in rows
    ]
    columns["Decision"] = [_decision(row) for row in rows]
    columns["More seeds"] = [_more(row, contests.design.seeds) for row in rows]
    return Grid.of(columns, words=words)


def _decision(row: dict[Any, Any]) -> str:
    return f"{row['decision']} ({row['seeds']})" if row["seeds"] else row["decision"]


def _more(row: dict[Any, Any], most: int) -> str:
    """`5 (80 % by 20)`, where so many seeds more are likely enough and there may be 20 in all."""
    if np.isnan(row["chance"]):
        return NOTHING
    fewest = min(row["n"], row["n_against"])
    likely = f"{row['more']}" if isinstance(row["more"], int) else f"> {max(0, most - fewest)}"
    return f"{likely} ({100 * row['chance']:.0f} % by {most})"


def _rules(section: Section, contests: Contests) -> dict[str, Any]:
    design = contests.design
    return {
        "group": design.group, "looks": design.looks, "alpha": design.alpha, "comparisons": len(contests.contests),
        "fixed_in_advance": section.trial is not None,
    }  # fmt: skip


def _notes(section: Section, contests: Contests, settings: Statistics) -> Iterator[str]:
    design = contests.design
    yield (
        f"Decisions: after every {design.group} seeds, at most {design.looks} times, over {len(contests.contests)} "
        f"comparisons with one error rate of {100 * design.alpha:g} %."
    )
    if section.trial is None:
        yield (
            "No rules were fixed before these runs: the error rate holds only if how many seeds there are did not "
            "follow from what they showed."
        )
    yield from statistics_notes(section, settings)
