"""People who teach: what each answered, how a sitting changes it, and how far they agree with one another.

Of the answers to queries of runs, to shared and to repeated ones; neither
practice nor what was taken back. Runs need not have an evaluation yet.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from rrm.envs.tasks import ScoreKind
from rrm.teachers.labels import EQUAL, SHARED, SKIPPED
from rrmctl.commands import rrmctl
from rrmctl.reports.answers import EVERYBODY, Answers, answers, everybody
from rrmctl.reports.columns import NOTHING, Column, Row, TextGrid, number, spread
from rrmctl.reports.report import Report, facts, some, tabled, title
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import BOOTSTRAP_SEED, LEVEL, SURE, Statistics
from rrmctl.stats import Estimate
from rrmctl.stats.agreement import alpha, apart, kappa, share, slope
from rrmctl.store.frame import NUMBER, TEXT, WHOLE

EXPERIMENTS: tuple[str, ...] = ()

#: Answers of a sitting along which something is said to change.
LONG = 20

EXPLAINED = (
    f"In brackets: {SURE} intervals. Shares: Wilson's, which take answers for independent; a difference of two: "
    "Newcombe's. Alpha, kappa and changes: percentile bootstrap over queries, or answers, for the same people.",
    "Latency: the median, from the first frame to the key. Left: the answers that prefer the clip on the left, of all "
    "that prefer one; sides are drawn by lot, so without a bias it is 50 %.",
    "True return: the answers that prefer the clip of the higher true return, of those that prefer one where returns "
    "differ. It is no score: people see what returns do not. With returns shown: its share there less that without.",
    "Itself: queries that somebody answered again, answered alike.",
    "In 100 answers: the change of the latency in percent, of the agreement with the true return in points, by least "
    f"squares within sittings of {LONG} answers or more.",
    "Krippendorff's alpha (nominal) and Cohen's kappa, over queries that two people or more answered, equal as a value "
    "of its own: 1 is full agreement, 0 what chance would give.",
)


def _estimated(name: str, heading: str, unit: ScoreKind = "success", sign: str = " %") -> tuple[Column, ...]:
    """Columns of a number and its interval that people read as one."""

    def text(row: Row) -> str:
        ends = spread(row[f"{name}_low"], row[f"{name}_high"], unit)
        return f"{number(row[name], unit).replace(' %', sign)} {ends}".removesuffix(f" {NOTHING}")

    return Column(name, NUMBER, heading, text), Column(f"{name}_low", NUMBER), Column(f"{name}_high", NUMBER)


_WHO = Column("annotator", TEXT, "Person")
PEOPLE = (
    _WHO, Column("answers", WHOLE, "Answers"), Column("ties", WHOLE, "Ties"), Column("skips", WHOLE, "Skips"),
    Column("undos", WHOLE, "Undos"),
    Column("latency", NUMBER, "Latency", lambda row: f"{row['latency']:.1f} s"),
    *_estimated("left", "Left"), *_estimated("agreement", "True return"), *_estimated("itself", "Itself"),
    Column("repeats", WHOLE, "Repeats"),
)  # fmt: skip
SITTINGS = (
    _WHO, Column("sittings", WHOLE, "Sittings"), Column("longest", WHOLE, "Longest"),
    *_estimated("latency_change", "Latency, in 100 answers"),
    *_estimated("agreement_change", "True return, in 100 answers", sign=" points"),
    *_estimated("hint", "With returns shown", sign=" points"),
)  # fmt: skip
AGREEMENT = (
    _WHO, Column("measure", TEXT, "Measure"), Column("queries", WHOLE, "Queries"),
    *_estimated("alike", "Alike"), *_estimated("beyond_chance", "Beyond chance", "return"),
)  # fmt: skip
COLUMNS = tuple(dict.fromkeys((*PEOPLE, *SITTINGS, *AGREEMENT)))


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """Three tables for each section with answers of people: people, sittings, and the agreement between people."""
    reports = []
    for section in sections:
        given = everybody(answers(section))
        if not given.labels:
            continue
        people = [(name, given.by(name)) for name in given.people]
        people += [(EVERYBODY, given)] if len(people) > 1 else []
        parts: tuple[tuple[str, Sequence[Column], list[Row], Iterable[str]], ...] = (
            ("What people answered", PEOPLE, [_person(*each) for each in people], _notes(given)),
            ("Along a sitting", SITTINGS, [_sitting(*each, settings) for each in people], ()),
            ("Agreement between people", AGREEMENT, [*_agreement(given, settings)], _lacking(given)),
        )
        own = facts(section, settings) | {"interval": f"{SURE}: Wilson, Newcombe, percentile bootstrap over queries"}
        for about, columns, rows, notes in parts:
            table, whole = tabled(columns, rows)
            grid = TextGrid.of([column for column in columns if _told(column, whole)], whole)
            heading = f"{title(section)} · {about.lower()}"
            reports.append(
                Report(heading, table, grid if rows else TextGrid((), ()), tuple(notes), own | {"about": about})
            )
    root = next((section.source.root for section in sections if section.source), None)
    ask = rrmctl("run", "human-study", "--label", results=root)
    return some(reports, sections, "nobody answered a query yet", f"`{ask}` asks people; see docs/human.md")


def _told(column: Column, rows: Sequence[Row]) -> bool:
    """Whether any row has a value: without repeated queries there is no agreement with oneself."""
    return column.kind != NUMBER or not all(math.isnan(row[column.name]) for row in rows)


def _of(name: str, found: Estimate) -> dict[str, float]:
    return found.row(name, f"{name}_")


def _person(name: str, given: Answers) -> dict[str, Any]:
    right, again = given.right(), given.repeated()
    return {
        "annotator": name, "answers": len(given.labels), "ties": given.count(EQUAL), "skips": given.count(SKIPPED),
        "undos": len(given.undone), "latency": float(np.median(given.seconds())), "repeats": len(again),
        **_of("left", share(given.left(), LEVEL)), **_of("agreement", share(right[~np.isnan(right)], LEVEL)),
        **_of("itself", share(again, LEVEL)),
    }  # fmt: skip


def _sitting(name: str, given: Answers, settings: Statistics) -> dict[str, Any]:
    right, shown = given.right(), given.shown() == 1
    told, lengths = ~np.isnan(right), list(map(len, given.sittings(right)))
    slower, worse = (
        slope(
            [sitting for sitting in given.sittings(values) if len(sitting) >= LONG],
            rng=_rng(stream), replicates=settings.replicates, level=LEVEL,
        )
        for stream, values in enumerate((np.log(given.seconds()), right))
    )  # fmt: skip
    return {
        "annotator": name, "sittings": len(lengths), "longest": max(lengths),
        **{key: math.expm1(value) for key, value in _of("latency_change", slower).items()},
        **_of("agreement_change", worse),
        **_of("hint", apart(share(right[told & shown], LEVEL), share(right[told & ~shown], LEVEL))),
    }  # fmt: skip


def _agreement(given: Answers, settings: Statistics) -> Iterator[dict[str, Any]]:
    """Alpha of all, then kappa of each two."""
    people, ratings = given.ratings()
    if not len(ratings):
        return
    how: dict[str, Any] = {"replicates": settings.replicates, "level": LEVEL}
    pairs = list(itertools.combinations(range(len(people)), 2))
    both = {pair: ratings[~np.isnan(ratings[:, pair]).any(axis=1)][:, pair] for pair in pairs}
    alike = np.concatenate([two[:, 0] == two[:, 1] for two in both.values()])
    yield {
        "annotator": EVERYBODY, "measure": "alpha", "queries": len(ratings), "alike": alike.mean(),
        **_of("beyond_chance", alpha(ratings, rng=_rng(2), **how)),
    }  # fmt: skip
    for at, (pair, two) in enumerate(both.items(), start=3):
        if len(two):
            yield {
                "annotator": " / ".join(people[one] for one in pair), "measure": "kappa", "queries": len(two),
                **_of("alike", share(two[:, 0] == two[:, 1], LEVEL)),
                **_of("beyond_chance", kappa(two[:, 0], two[:, 1], rng=_rng(at), **how)),
            }  # fmt: skip


def _rng(stream: int) -> np.random.Generator:
    return np.random.default_rng([BOOTSTRAP_SEED, stream])


def _notes(given: Answers) -> Iterator[str]:
    purposes = [label.purpose for label in given.labels]
    counts = ", ".join(f"{purposes.count(purpose)} {purpose}" for purpose in dict.fromkeys(purposes))
    yield f"Answers: {counts}. Not counted: {given.practice} to practice queries, {len(given.undone)} taken back."
    if not given.repeated():
        yield "No query was asked anybody twice: ask with --repeat 5."


def _lacking(given: Answers) -> Iterator[str]:
    people, ratings = given.ratings()
    if len(people) < 2:
        yield "One person alone answered: there is nobody to agree with."
    elif not len(ratings):
        yield "Not estimable, no shared queries: ask with --shared 20."
    else:
        shared = len({label.query for label in given.labels if label.purpose == SHARED})
        asked = f"{shared} were shared ones" if shared else "--shared 20 asks everybody the same"
        yield f"{len(ratings)} queries were answered by two people or more; {asked}."
