"""The claims of the paper's prose: held, not held, or not enough data.

Each claim is one or more comparisons, settled only where the whole 95 %
interval lies on one side. The table shows the comparison on which the
verdict rests; csv and json have them all. Profiles are judged apart, and
any but the paper's is named in the verdict.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from rrmctl.reports.captions import contents_notes, merged_facts, statistics_notes, title
from rrmctl.reports.claims import CLAIMS
from rrmctl.reports.report import INTERVAL, Grid, Report, interval, number, some
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import DEFAULTS, LEVEL, Statistics
from rrmctl.reports.verdicts import Judgement, at_profile, judge

if TYPE_CHECKING:
    import pandas as pd

EXPERIMENT = None
EXPLAINED = (
    "Held: all comparisons of the claim have their whole interval on its side. Not held: one has all of it on the "
    f"other side, at a level of 1 - {1 - LEVEL:.2g} / the claim's comparisons. Shown: the comparison that decides.",
    '"Reaches" and "near" are taken within 5 points. n: the fewest seeds of a method and task.',
)

COLUMNS = (
    "claim", "says", "where", "asks", "verdict", "task", "comparison", "reading", "unit", "found", "low", "high", "n",
    "comparison_verdict", "why", "decides",
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each profile and set of overrides of the experiments that the claims are about.

    Raises:
        NoDataError: the claims are about others.
    """
    asked = list(dict.fromkeys(claim.experiment for claim in CLAIMS))
    known = [section for section in sections if section.experiment in asked]
    made = [_report(alike, settings) for alike in _variants(known)]
    return some(made, sections, "the paper's prose claims nothing of it", f"its claims are about {', '.join(asked)}")


def table(sections: Sequence[Section], settings: Statistics = DEFAULTS) -> pd.DataFrame:
    """One row per comparison of each claim: columns `COLUMNS`.

    Args:
        sections: of one profile and set of overrides, one an experiment.
        settings: how the intervals are made.
    """
    import pandas as pd

    first = sections[0]
    rows = [row for each in _judged(sections, settings) for row in _rows(each, at_profile(each.verdict, first))]
    return pd.DataFrame(rows, columns=list(COLUMNS)).astype({"n": "Int64"})


def _variants(sections: Sequence[Section]) -> list[list[Section]]:
    """Sections of equal profile and overrides together."""
    found: dict[tuple[str, str], list[Section]] = {}
    for section in sections:
        found.setdefault((section.profile, repr(sorted(section.overrides.items()))), []).append(section)
    return list(found.values())


def _judged(sections: Sequence[Section], settings: Statistics) -> list[Judgement]:
    by_name = {section.experiment: section for section in sections}
    return [judge(claim, by_name, settings) for claim in CLAIMS]


def _rows(judgement: Judgement, verdict: str) -> Iterator[dict[str, Any]]:
    claim = judgement.claim
    for finding in judgement.findings:
        row: dict[str, Any] = {
            "claim": claim.name, "says": claim.says, "where": claim.where, "asks": claim.experiment,
            "verdict": verdict, "task": finding.task, "comparison": str(finding.test),
            "reading": finding.test.reading.words, "unit": finding.unit, "n": 0,
            "comparison_verdict": finding.verdict, "why": finding.why, "decides": finding is judgement.deciding,
        }  # fmt: skip
        if finding.found is not None:
            numbers = (finding.found.estimate, finding.found.low, finding.found.high)
            row |= dict(zip(("found", "low", "high"), map(float, numbers), strict=True)) | {"n": finding.found.n}
        yield row


def _report(sections: Sequence[Section], settings: Statistics) -> Report:
    found = table(sections, settings)
    first = sections[0]
    facts = merged_facts("claims", sections, settings)
    return Report(title(first, "claims"), found, _grid(found), tuple(_notes(sections, found, settings)), facts)


def _grid(found: pd.DataFrame) -> Grid:
    """A row for each claim with the comparison on which the verdict rests."""
    rows = found[found["decides"]].to_dict("records")
    columns: dict[str, Sequence[str]] = {
        "Experiment": [row["asks"] for row in rows],
        "Claim": [row["says"] for row in rows],
        "Verdict": [row["verdict"] for row in rows],
        "Rests on": [_comparison(row) for row in rows],
        "Found": [number(row["found"], row["unit"]) for row in rows],
        INTERVAL: [interval(row["low"], row["high"], row["unit"], row["n"]) for row in rows],
        "n": [str(row["n"]) for row in rows],
    }
    return Grid.of(columns, words=4)


def _comparison(row: dict[Any, Any]) -> str:
    """What is compared, where, and why it settles nothing."""
    told = f"{row['comparison']}: {row['task']}, {row['reading']}"
    return f"{told} ({row['why']})" if row["why"] else told


def _notes(sections: Sequence[Section], found: pd.DataFrame, settings: Statistics) -> Iterator[str]:
    verdicts = found.drop_duplicates("claim")["verdict"].value_counts(sort=False)
    yield f"{len(CLAIMS)} claims: {', '.join(f'{count} {verdict}' for verdict, count in verdicts.items())}."
    for section in sections:
        yield from (f"{section.experiment}: {note}" for note in contents_notes(section))
    yield from dict.fromkeys(note for section in sections for note in statistics_notes(section, settings))
