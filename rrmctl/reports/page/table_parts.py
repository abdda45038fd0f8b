"""Every table that the sections of a page support, and where on the page it stands."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from types import ModuleType
from typing import TYPE_CHECKING

from rrmctl.errors import UserError
from rrmctl.reports.page.parts import Column, Part, Table, identifier
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables import kinds

if TYPE_CHECKING:
    from rrmctl.reports.report import Report
    from rrmctl.reports.verdicts import Verdict

#: Experiment and variant; where a table is of several, it stands before their chapters.
Place = tuple[str, str]
SEVERAL: Place = ("", "")
#: What stands first; the rest follows by name.
_MAIN = ("curves", "iqm", "claims")
_UNDECIDED: Verdict = "not enough data"


@dataclass
class Tables:
    """The tables of a page."""

    made: dict[Place, list[tuple[str, Report]]] = field(default_factory=lambda: defaultdict(list))  #: with their kind
    refused: dict[Place, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))  #: kind -> why not


def gather(sections: Sequence[Section], settings: Statistics) -> Tables:
    """The tables of all kinds, made of all sections at once: some kinds compare experiments.

    Where one section stands in the way, each is asked alone. Why a kind has none at all stands at `SEVERAL`.
    """
    places, found = [(section.experiment, section.variant) for section in sections], Tables()
    for kind, entry in kinds().items() if sections else ():
        if kind == "all":  # the others
            continue
        reports, reason = _made(entry.load(), sections, settings)
        if reason:
            alone = [_made(entry.load(), [section], settings) for section in sections]
            reports = [report for made, _ in alone for report in made]
            reasons = zip(places, (why for _, why in alone), strict=True) if reports else [(SEVERAL, reason)]
            for place, why in reasons:
                if why:
                    found.refused[place][kind] = why
        for report in reports:
            place = (report.facts["experiment"], report.facts["variant"])
            found.made[place if place in places else SEVERAL].append((kind, report))
    return found


def _made(module: ModuleType, sections: Sequence[Section], settings: Statistics) -> tuple[list[Report], str]:
    """A kind's tables, or why there are none."""
    try:
        return module.make(sections, settings), ""
    except UserError as error:
        return [], str(error)


def rank(named: tuple[str, object]) -> int:
    """Where a table or figure of this name stands among others."""
    return _MAIN.index(named[0]) if named[0] in _MAIN else len(_MAIN)


def tables_at(place: Place, name: str, gathered: Tables) -> Part:
    """The tables of a place, the notes that several share once, and why others are not there."""
    made = sorted(gathered.made[place], key=rank)
    counted = Counter(note for _, report in made for note in dict.fromkeys(report.notes))
    shared = [note for note, count in counted.items() if count > 1]
    seen: Counter[str] = Counter()
    parts = []
    for kind, report in made:
        seen[kind] += 1
        title = f"{report.title}. " if place == SEVERAL else ""
        caption = f"{title}{kinds()[kind].help.splitlines()[0]} (rrmctl report {kind})"
        id_ = f"{name}-{identifier(kind)}" + (f"-{seen[kind]}" if seen[kind] > 1 else "")
        notes = [note for note in report.notes if note not in shared]
        parts.append(replace(_table(report, caption), id=id_, notes=notes))
    reasons = [f"{kind}: {why}" for kind, why in gathered.refused[place].items()]
    parts.append(Part(title="On several of these tables", notes=shared))
    parts.append(Part(title="Tables with nothing to show", notes=reasons, folded=True))
    return Part(id=f"{name}-tables", title="Tables", parts=parts)


def _table(report: Report, caption: str) -> Part:
    """The table; of claims those that are decided, and the others folded below."""
    grid = report.grid
    columns = [Column(name, at, at >= grid.words) for at, name in enumerate(grid.header)]
    table = Table(caption, columns, grid.rows, best=grid.best)
    if "Verdict" not in grid.header:
        return Part(tables=[table])
    verdict = grid.header.index("Verdict")
    undecided = [row for row in grid.rows if row[verdict].startswith(_UNDECIDED)]
    decided = replace(table, rows=[row for row in grid.rows if row not in undecided])
    told = f"{len(decided.rows)} of {len(grid.rows)} claims are decided by these runs."
    others = Part(title=f"{len(undecided)} claims: {_UNDECIDED}", tables=[replace(table, rows=undecided)], folded=True)
    return Part(paragraphs=[told], tables=[decided], parts=[others])
