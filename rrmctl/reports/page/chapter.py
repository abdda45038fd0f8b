"""A variant of an experiment on the page: what it shows, what it is made of, and what that took."""

from __future__ import annotations

import base64
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rrmctl.commands import rrmctl
from rrmctl.errors import UserError
from rrmctl.reports.captions import title
from rrmctl.reports.figure_files import encode
from rrmctl.reports.figures import figures
from rrmctl.reports.page import listings
from rrmctl.reports.page.parts import Part, Picture, identifier
from rrmctl.reports.page.table_parts import Tables, rank, tables_at
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import Statistics
from rrmctl.store.snapshot import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: Bytes a figure may take as SVG; one with more in it, such as a cloud of points, becomes a PNG.
MOST_BYTES = 300_000
#: Of such a PNG, dots per inch; the first that is small enough, or the last.
_DPI = (200, 150, 100, 75)


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


def chapter(variant: Variant, gathered: Tables, settings: Statistics) -> Part:
    """Everything about one variant."""
    name, section = variant.id, variant.section
    states = Counter(str(run.plan["state"]) for run in {run.id: run for run in variant.runs}.values())
    parts = [Part(id=f"{name}-failures", title="Failures", failures=listings.failures(variant.everything))]
    if isinstance(section, Section) and section.contained:
        drawn = list(_figures(section, name, settings))
        parts.append(Part(id=f"{name}-figures", title="Figures", figures=drawn))
        parts.append(tables_at((variant.experiment, variant.name), name, gathered))
    return Part(
        id=name,
        title=title(section) if isinstance(section, Section) else f"{variant.experiment} · {variant.name}",
        paragraphs=[f"{states.total()} planned runs: {', '.join(f'{n} {state}' for state, n in states.items())}."],
        warnings=_warnings(section),
        parts=[*parts, *listings.parts(name, variant.runs, variant.needed)],
    )


def _warnings(section: Section | UserError) -> Sequence[str]:
    if isinstance(section, UserError):
        hint = f" ({section.hint})" if section.hint else ""
        return [f"Its runs cannot be shown together: {section}{hint}."]
    return section.problems if section.contained else ["No run can be shown yet."]


def _figures(section: Section, name: str, settings: Statistics) -> Iterator[Picture | str]:
    for figure, entry in sorted(figures().items(), key=rank):
        module = entry.load()
        if not module.suits(section):
            continue
        caption = f"{entry.help.splitlines()[0]} ({rrmctl('plot', section.experiment, '--figure', figure)})"
        try:
            drawn = module.draw(section, settings)
        except UserError as error:
            yield f"{caption} Not drawn: {error}"
            continue
        told = f"{caption} {title(section)}. The tables hold the numbers."
        yield picture(drawn, f"{name}-figure-{identifier(figure)}", caption, told)


def picture(figure: Figure, name: str, caption: str, alternative: str) -> Picture:
    """A figure inside of the page, sharp when enlarged, and never large."""
    kind, data = "svg+xml", encode(figure, "svg")
    for dpi in _DPI:
        if len(data) <= MOST_BYTES:
            break
        kind, data = "png", encode(figure, "png", dpi)
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    return Picture(name, caption, alternative, round(96 * figure.get_figwidth()), source)
