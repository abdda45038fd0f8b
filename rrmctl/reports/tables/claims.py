"""The claims of the paper's prose: held, not held, or not enough data.

Each claim is one or more comparisons, settled only where the whole 95 %
interval lies on one side and there are seeds enough. The table shows the comparison on which the
verdict rests; csv and json have them all. Profiles are judged apart, and
any but the paper's is named in the verdict.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any

from rrmctl.errors import UserError
from rrmctl.planning.profiles import PAPER
from rrmctl.reports.claims import CLAIMS
from rrmctl.reports.columns import Column, Row, TextGrid, estimated
from rrmctl.reports.report import Report, contents_notes, merged_facts, some, statistics_notes, tabled, title
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import LEVEL, Statistics
from rrmctl.reports.verdicts import judge
from rrmctl.store.frame import MAYBE_WHOLE, TEXT

EXPERIMENTS = tuple(dict.fromkeys(claim.experiment for claim in CLAIMS))
#: An experiment whose runs do not belong together costs its own claims, and no others.
APART = True
EXPLAINED = (
    "Held: all comparisons of the claim have their whole interval on its side. Not held: one has all of it on the "
    f"other side, at a level of 1 - {1 - LEVEL:.2g} / the claim's comparisons. Shown: the comparison that decides.",
    "Neither is said where not all planned runs are finished, nor of so few seeds that chance alone could bring all "
    "of them to one side (in 5 %, or 5 % / the claim's comparisons, of studies): five at least against a bound.",
    "Of several: the verdict is on those tasks of the claim that were planned with all that it compares.",
    '"Reaches" and "near" are taken within 5 points. n: the fewest seeds of a method and task.',
)


def _comparison(row: Row) -> str:
    """What is compared, where, and why it settles nothing."""
    words = f"{row['comparison']}: {row['task']}, {row['reading']}"
    return f"{words} ({row['why']})" if row["why"] else words


COLUMNS = (
    Column("claim", TEXT, "Experiment", lambda row: row["asks"]), Column("says", TEXT, "Claim"), Column("where"),
    Column("asks"), Column("verdict", TEXT, "Verdict"), Column("task"),
    Column("comparison", TEXT, "Rests on", _comparison), Column("reading"), Column("unit"),
    *estimated("found", "Found", score=lambda row: row["unit"]), Column("n", MAYBE_WHOLE, "n"),
    Column("comparison_verdict"), Column("why"), Column("decides", "bool"),
)  # fmt: skip


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """A table for each profile and set of overrides of the experiments that the claims are about."""
    variants: dict[tuple[str, str], list[Section]] = {}
    for section in sections:
        if section.experiment in EXPERIMENTS:
            variant = (section.profile, repr(sorted(section.overrides.items())))
            variants.setdefault(variant, []).append(section)
    reports = []
    for alike in variants.values():
        table, rows = tabled(COLUMNS, _rows(alike, settings))
        grid = TextGrid.of(COLUMNS, [row for row in rows if row["decides"]])
        verdicts = Counter({row["claim"]: row["verdict"] for row in rows}.values())
        notes = [f"{len(CLAIMS)} claims: {', '.join(f'{count} {verdict}' for verdict, count in verdicts.items())}."]
        for section in alike:
            own = contents_notes(section) if section.refusal is None else [_refused(section.refusal)]
            notes += [f"{section.experiment}: {note}" for note in own]
        notes += dict.fromkeys(note for section in alike for note in statistics_notes(section, settings))
        facts = merged_facts("claims", alike, settings)
        reports.append(Report(title(alike[0], "claims"), table, grid, tuple(notes), facts))
    hint = f"its claims are about {', '.join(EXPERIMENTS)}"
    return some(reports, sections, "the paper's prose claims nothing of it", hint)


def _refused(refusal: UserError) -> str:
    return f"not judged. {refusal}; {refusal.hint}." if refusal.hint else f"not judged. {refusal}."


def _rows(sections: Sequence[Section], settings: Statistics) -> Iterator[dict[str, Any]]:
    """A row for each comparison of each claim; verdicts name tasks that are not all of the claim's, a scale that is not
    the paper's, and overrides.
    """
    by_name, first = {section.experiment: section for section in sections}, sections[0]
    scale = [] if first.profile == PAPER else [f"profile {first.profile}"]
    scale += [f"{key}={value}" for key, value in first.overrides.items()]
    for claim in CLAIMS:
        judgement = judge(claim, by_name, settings)
        few = len(judgement.tasks) < len(claim.tasks) and judgement.verdict != "not enough data"
        where = [f"{len(judgement.tasks)} of {len(claim.tasks)} tasks"] if few else []
        said = f" ({', '.join([*where, *scale])})" if where or scale else ""
        for finding in judgement.findings:
            row: dict[str, Any] = {
                "claim": claim.name, "says": claim.says, "where": claim.where, "asks": claim.experiment,
                "verdict": judgement.verdict + said, "task": finding.task,
                "comparison": str(finding.test), "reading": finding.test.reading.words, "unit": finding.unit, "n": 0,
                "comparison_verdict": finding.verdict, "why": finding.why, "decides": finding is judgement.deciding,
            }  # fmt: skip
            if finding.estimate is not None:
                row |= finding.estimate.row("found") | {"n": finding.estimate.n}
            yield row
