"""A variant of an experiment on the page: what it shows, what it is made of, and what that took."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.reports.figures import figures
from rrmctl.reports.kinds import kinds
from rrmctl.reports.page import listings, tables
from rrmctl.reports.page.gather import SEVERAL, Place, Tables
from rrmctl.reports.page.html import Html, element, folded, identifier, joined
from rrmctl.reports.page.pictures import picture
from rrmctl.reports.series import Section
from rrmctl.reports.settings import Settings
from rrmctl.reports.words import title
from rrmctl.store.inventory import Run

if TYPE_CHECKING:
    from rrmctl.reports.document import Report
    from rrmctl.reports.judging import Verdict

#: What stands first; the rest follows by name.
_MAIN = ("curves", "iqm", "claims")
_UNDECIDED: Verdict = "not enough data"


@dataclass(frozen=True)
class Part:
    """A piece of the page that the list of contents names."""

    id: str
    title: str
    body: Html
    parts: tuple[Part, ...] = ()
    folded: bool = False  #: until somebody presses its heading

    def html(self, level: int = 2) -> Html:
        """Heading and content."""
        inner, heading = joined(part.html(level + 1) for part in self.parts), element(f"h{level}", self.title)
        if self.folded:  # a link to what is inside unfolds it
            return folded(heading, element("section", self.body, inner, id=self.id))
        return element("section", heading, self.body, inner, id=self.id)

    def entry(self) -> Html:
        """Its line in the list of contents, with those of its parts."""
        inner = element("ul", *(part.entry() for part in self.parts)) if self.parts else None
        return element("li", element("a", self.title, href=f"#{self.id}"), inner)


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


def chapter(variant: Variant, gathered: Tables, settings: Settings) -> Part:
    """Everything about one variant."""
    name, section = variant.id, variant.section
    heading = title(section) if isinstance(section, Section) else f"{variant.experiment} · {variant.name}"
    shown = [Part(f"{name}-failures", "Failures", listings.failures(variant.everything))]
    if isinstance(section, Section) and section.contained:
        shown += [_figures(section, name, settings), tables_at((variant.experiment, variant.name), name, gathered)]
    listed = listings.parts(name, variant.runs, variant.needed)
    shown += [Part(id_, heading_, body, folded=True) for id_, heading_, body in listed]
    parts = tuple(part for part in shown if part.body)
    return Part(name, heading, joined(_state(variant.runs, section)), parts)


def _state(runs: Sequence[Run], section: Section | UserError) -> Iterator[Html]:
    """What is there and what is not, in sentences."""
    states = Counter(str(run.plan["state"]) for run in {run.id: run for run in runs}.values())
    yield element("p", f"{states.total()} planned runs: {', '.join(f'{n} {state}' for state, n in states.items())}.")
    if isinstance(section, UserError):
        hint = f" ({section.hint})" if section.hint else ""
        yield element("p", f"Its runs cannot be shown together: {section}{hint}.", class_="warning")
    elif not section.contained:
        yield element("p", "No run can be shown yet.", class_="warning")
    else:
        yield from (element("p", problem, class_="warning") for problem in section.problems)


def _first(named: tuple[str, object]) -> int:
    return _MAIN.index(named[0]) if named[0] in _MAIN else len(_MAIN)


def _figures(section: Section, name: str, settings: Settings) -> Part:
    made = []
    for figure, entry in sorted(figures().items(), key=_first):
        module = entry.load()
        if not module.suits(section):
            continue
        caption = f"{entry.help.splitlines()[0]} ({rrmctl('plot', section.experiment, '--figure', figure)})"
        try:
            drawn = module.draw(section, settings)
        except UserError as error:
            made.append(element("p", f"{caption} Not drawn: {error}", class_="warning"))
            continue
        told = f"{caption} {title(section)}. The tables hold the numbers."
        made.append(picture(drawn, f"{name}-figure-{identifier(figure)}", caption, told))
    return Part(f"{name}-figures", "Figures", element("div", *made, class_="figures") if made else Html())


def tables_at(place: Place, name: str, gathered: Tables) -> Part:
    """The tables of a place, the notes that several share once, and why others are not there."""
    made, refused = sorted(gathered.made[place], key=_first), gathered.refused[place]
    counted = Counter(note for _, report in made for note in dict.fromkeys(report.notes))
    shared = [note for note, count in counted.items() if count > 1]
    seen: Counter[str] = Counter()
    pieces = []
    for kind, report in made:
        seen[kind] += 1
        title_ = f"{report.title}. " if place == SEVERAL else ""
        caption = f"{title_}{kinds()[kind].help.splitlines()[0]} (rrmctl report {kind})"
        notes = _notes([note for note in report.notes if note not in shared])
        id_ = f"{name}-{identifier(kind)}" + (f"-{seen[kind]}" if seen[kind] > 1 else "")
        pieces.append(element("div", _table(report, caption), notes, id=id_))
    if shared:
        pieces += [element("h4", "On several of these tables"), _notes(shared)]
    if refused:
        reasons = _notes([f"{kind}: {why}" for kind, why in refused.items()])
        pieces.append(folded("Tables with nothing to show", reasons))
    return Part(f"{name}-tables", "Tables", joined(pieces))


def _table(report: Report, caption: str) -> Html:
    """The table; of claims those that are decided, and the others folded below."""
    grid = report.grid
    if "Verdict" not in grid.header:
        return tables.of_grid(grid, caption)
    parted: tuple[list[tuple[str, ...]], list[tuple[str, ...]]] = ([], [])
    for row in grid.rows:
        parted[row[grid.header.index("Verdict")].startswith(_UNDECIDED)].append(row)
    decided, undecided = (replace(grid, rows=tuple(rows)) for rows in parted)
    told = element("p", f"{len(decided.rows)} of {len(grid.rows)} claims are decided by these runs.")
    pieces = [told, tables.of_grid(decided, caption)] if decided.rows else [told]
    if undecided.rows:
        pieces.append(folded(f"{len(undecided.rows)} claims: {_UNDECIDED}", tables.of_grid(undecided, caption)))
    return joined(pieces)


def _notes(notes: Sequence[str]) -> Html:
    return element("ul", *(element("li", note) for note in notes), class_="notes") if notes else Html()
