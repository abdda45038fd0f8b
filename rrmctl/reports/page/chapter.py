"""A variant of an experiment on the page: what it shows, what it is made of, and what that took."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.reports.figures import figures
from rrmctl.reports.kinds import kinds
from rrmctl.reports.page import listings, tables
from rrmctl.reports.page.gather import SEVERAL, Place, Tables
from rrmctl.reports.page.html import Html, element, identifier, joined
from rrmctl.reports.page.pictures import picture
from rrmctl.reports.series import Section
from rrmctl.reports.settings import Settings
from rrmctl.reports.words import title
from rrmctl.store.inventory import Run


@dataclass(frozen=True)
class Part:
    """A piece of the page that the list of contents names."""

    id: str
    title: str
    body: Html
    parts: tuple[Part, ...] = ()

    def html(self, level: int = 2) -> Html:
        """Heading and content."""
        inner = joined(part.html(level + 1) for part in self.parts)
        return element("section", element(f"h{level}", self.title), self.body, inner, id=self.id)

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
    shown = (
        (_figures(section, name, settings), tables_at((variant.experiment, variant.name), name, gathered))
        if isinstance(section, Section) and section.contained
        else ()
    )
    told = (*shown, *listings.parts(name, variant.runs, variant.needed))
    parts = tuple(Part(id_, heading_, body) for id_, heading_, body in told if body)
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


def _figures(section: Section, name: str, settings: Settings) -> tuple[str, str, Html]:
    made = []
    for figure, entry in figures().items():
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
    return f"{name}-figures", "Figures", joined(made)


def tables_at(place: Place, name: str, gathered: Tables) -> tuple[str, str, Html]:
    """The tables of a place, the notes that several share once, and why others are not there."""
    made, refused = gathered.made[place], gathered.refused[place]
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
        pieces.append(element("div", tables.of_grid(report.grid, caption), notes, id=id_))
    if shared:
        pieces += [element("h4", "On several of these tables"), _notes(shared)]
    if refused:
        pieces += [element("h4", "Tables with nothing to show")]
        pieces += [_notes([f"{kind}: {why}" for kind, why in refused.items()])]
    return f"{name}-tables", "Tables", joined(pieces)


def _notes(notes: Sequence[str]) -> Html:
    return element("ul", *(element("li", note) for note in notes), class_="notes") if notes else Html()
