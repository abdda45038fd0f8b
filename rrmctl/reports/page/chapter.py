"""A variant of an experiment on the page: what it shows, what it is made of, and what that took."""

from __future__ import annotations

import base64
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.reports.figure_layout import Figure, encode
from rrmctl.reports.figures import figures
from rrmctl.reports.page import listings
from rrmctl.reports.page.parts import PageColumn, Part, Picture, Table, identifier
from rrmctl.reports.report import Report, title
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables import kinds
from rrmctl.reports.verdicts import Verdict
from rrmctl.store.snapshot import Run

#: Bytes a figure may take as SVG; one with more in it, such as a cloud of points, becomes a PNG.
MOST_BYTES = 300_000
#: Of such a PNG, dots per inch; the first that is small enough, or the last.
_DPI = (200, 150, 100, 75)

#: Experiment and variant; where a table is of several, it stands before their chapters.
Place = tuple[str, str]
SEVERAL: Place = ("", "")
#: What stands first; the rest follows by name.
_MAIN = ("curves", "iqm", "claims")
_UNDECIDED: Verdict = "not enough data"


@dataclass(frozen=True)
class Variant:
    """A variant of an experiment."""

    experiment: str
    name: str
    runs: tuple[Run, ...]  #: all that were planned
    needed: tuple[Run, ...]  #: those that they need
    section: Section | UserError  #: what may be averaged, or why nothing may

    @property
    def everything(self) -> tuple[Run, ...]:
        """The runs, and those that they need."""
        return (*self.runs, *self.needed)

    @property
    def id(self) -> str:
        """Of its chapter."""
        return identifier(self.experiment, self.name)


@dataclass
class Tables:
    """The tables of a page."""

    made: dict[Place, list[tuple[str, Report]]] = field(default_factory=lambda: defaultdict(list))  #: with their kind
    refused: dict[Place, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))  #: kind -> why not


def chapter(variant: Variant, gathered: Tables, settings: Statistics) -> Part:
    """Everything about one variant."""
    name, section = variant.id, variant.section
    states = Counter(str(run.plan["state"]) for run in {run.id: run for run in variant.runs}.values())
    parts = [Part(id=f"{name}-failures", title="Failures", failures=listings.failures(variant.everything))]
    heading, warnings = f"{variant.experiment} · {variant.name}", ["No run can be shown yet."]
    if isinstance(section, UserError):
        hint = f" ({section.hint})" if section.hint else ""
        warnings = [f"Its runs cannot be shown together: {section}{hint}."]
    else:
        heading, place = title(section), (variant.experiment, variant.name)
        if section.contained:
            warnings = [*section.problems]
            parts.append(Part(id=f"{name}-figures", title="Figures", figures=[*_figures(section, name, settings)]))
            parts.append(tables_at(place, name, gathered))
        people = [*_figures(section, name, settings, people=True)]
        told = tables_at(place, name, gathered, people=True)
        parts.append(Part(id=f"{name}-people", title="People", figures=people, parts=[told]))
    return Part(
        id=name,
        title=heading,
        paragraphs=[f"{states.total()} planned runs: {', '.join(f'{n} {state}' for state, n in states.items())}."],
        warnings=warnings,
        parts=[*parts, *listings.parts(name, variant.runs, variant.needed)],
    )


def _figures(section: Section, name: str, settings: Statistics, *, people: bool = False) -> Iterator[Picture | str]:
    for figure, entry in sorted(figures().items(), key=_rank):
        module = entry.load()
        if _of_people(figure) != people or not module.suits(section):
            continue
        caption = f"{entry.help.splitlines()[0]} ({rrmctl('plot', section.experiment, '--figure', figure)})"
        try:
            drawn = module.draw(section, settings)
        except UserError as error:
            yield f"{caption} Not drawn: {error}"
            continue
        words = f"{caption} {title(section)}. The tables hold the numbers."
        yield picture(drawn, f"{name}-figure-{identifier(figure)}", caption, words)


def picture(figure: Figure, name: str, caption: str, alternative: str) -> Picture:
    """A figure inside of the page, sharp when enlarged, and never large."""
    kind, data = "svg+xml", encode(figure, "svg")
    for dpi in _DPI:
        if len(data) <= MOST_BYTES:
            break
        kind, data = "png", encode(figure, "png", dpi)
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    return Picture(name, caption, alternative, round(96 * figure.get_figwidth()), source)


def _of_people(name: str) -> bool:
    """Whether a figure or table of this name is of what people answered."""
    return name in ("human", "human-returns", "human-sitting")


def _rank(named: tuple[str, object]) -> int:
    """Where a table or figure of this name stands among others."""
    return _MAIN.index(named[0]) if named[0] in _MAIN else len(_MAIN)


def gather(sections: Sequence[Section], settings: Statistics) -> Tables:
    """The tables of all kinds, made of all sections at once: some kinds compare experiments.

    Where one section stands in the way, each is asked alone. Why a kind has none at all stands at `SEVERAL`.
    """
    tables = Tables()
    for kind, entry in kinds().items():
        own = [section for section in sections if section.contained or _of_people(kind)]
        if kind == "all" or not own:  # all: the others
            continue
        make, places = entry.load().make, [(section.experiment, section.variant) for section in own]
        try:
            reports = make(own, settings)
        except UserError as error:
            reports, refused = [], {}
            for place, section in zip(places, own, strict=True):
                try:
                    reports += make([section], settings)
                except UserError as reason:
                    refused[place] = str(reason)
            for place, why in (refused if reports else {SEVERAL: str(error)}).items():
                tables.refused[place][kind] = why
        for report in reports:
            place = (report.facts["experiment"], report.facts["variant"])
            tables.made[place if place in places else SEVERAL].append((kind, report))
    return tables


def tables_at(place: Place, name: str, gathered: Tables, *, people: bool = False) -> Part:
    """The tables of a place, the notes that several share once, and why others are not there; or those of people."""
    tables = sorted((made for made in gathered.made[place] if _of_people(made[0]) == people), key=_rank)
    counted = Counter(note for _, report in tables for note in dict.fromkeys(report.notes))
    shared = [note for note, count in counted.items() if count > 1]
    seen: Counter[str] = Counter()
    parts = []
    for kind, report in tables:
        seen[kind] += 1
        heading = f"{report.title}. " if place == SEVERAL else ""
        about = report.facts.get("about", kinds()[kind].help.splitlines()[0])
        caption = f"{heading}{about} (rrmctl report {kind})"
        id_ = f"{name}-{identifier(kind)}" + (f"-{seen[kind]}" if seen[kind] > 1 else "")
        notes = [note for note in report.notes if note not in shared]
        parts.append(replace(_table(report, caption), id=id_, notes=notes))
    reasons = [f"{kind}: {why}" for kind, why in gathered.refused[place].items() if _of_people(kind) == people]
    parts.append(Part(title="On several of these tables", notes=shared))
    parts.append(Part(title="Tables with nothing to show", notes=reasons, folded=True))
    return Part(id=f"{name}-{'answers' if people else 'tables'}", title="Answers" if people else "Tables", parts=parts)


def _table(report: Report, caption: str) -> Part:
    """The table; of claims those that are decided, and the others folded below."""
    grid = report.grid
    columns = [PageColumn(name, at, at >= grid.words) for at, name in enumerate(grid.header)]
    table = Table(caption, columns, grid.rows, best=grid.best)
    if "Verdict" not in grid.header:
        return Part(tables=[table])
    verdict = grid.header.index("Verdict")
    undecided = [row for row in grid.rows if row[verdict].startswith(_UNDECIDED)]
    decided = replace(table, rows=[row for row in grid.rows if row not in undecided])
    words = f"{len(decided.rows)} of {len(grid.rows)} claims are decided by these runs."
    others = Part(title=f"{len(undecided)} claims: {_UNDECIDED}", tables=[replace(table, rows=undecided)], folded=True)
    return Part(paragraphs=[words], tables=[decided], parts=[others])
