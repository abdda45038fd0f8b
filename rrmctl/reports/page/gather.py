"""Every table that the sections of a page support, and where on the page it stands."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from types import ModuleType
from typing import TYPE_CHECKING

from rrmctl.errors import UserError
from rrmctl.reports.kinds import kinds
from rrmctl.reports.series import Section
from rrmctl.reports.settings import Settings

if TYPE_CHECKING:
    from rrmctl.reports.document import Report

#: Experiment and variant; where a table is of several, it stands before their chapters.
Place = tuple[str, str]
SEVERAL: Place = ("", "")
#: The kind that is all the others.
EVERYTHING = "all"


@dataclass
class Tables:
    """The tables of a page."""

    made: dict[Place, list[tuple[str, Report]]] = field(default_factory=lambda: defaultdict(list))  #: with their kind
    refused: dict[Place, dict[str, str]] = field(default_factory=lambda: defaultdict(dict))  #: kind -> why not


def gather(sections: Sequence[Section], settings: Settings) -> Tables:
    """The tables of all kinds, made of all sections at once: some kinds compare experiments.

    Why a kind has none at all stands at `SEVERAL`.
    """
    places, found = {(section.experiment, section.variant) for section in sections}, Tables()
    for kind, entry in kinds().items() if sections else ():
        if kind == EVERYTHING:
            continue
        module = entry.load()
        try:
            reports = module.make(sections, settings)
        except UserError as error:
            reports, reasons = _one_by_one(module, sections, settings)
            for place, reason in reasons.items() if reports else ((SEVERAL, str(error)),):
                found.refused[place][kind] = reason
        for report in reports:
            place = (report.facts["experiment"], report.facts["variant"])
            found.made[place if place in places else SEVERAL].append((kind, report))
    return found


def _one_by_one(
    module: ModuleType, sections: Sequence[Section], settings: Settings
) -> tuple[list[Report], dict[Place, str]]:
    """A kind's tables where a section stands in the way of its own, and why: no other is kept from being shown."""
    reports, reasons = [], {}
    for section in sections:
        try:
            reports += module.make([section], settings)
        except UserError as error:
            reasons[section.experiment, section.variant] = str(error)
    return reports, reasons
