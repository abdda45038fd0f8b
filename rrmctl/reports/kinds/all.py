"""Every table that the data can support, one after the other.

A table that has nothing to show is left out. csv and json name the table
that each row belongs to.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from rrmctl.errors import UserError
from rrmctl.reports import kinds
from rrmctl.reports.document import Report
from rrmctl.reports.series import Section
from rrmctl.reports.settings import Settings

EXPERIMENT = None
OPTIONS = ("plus_minus",)


def make(sections: Sequence[Section], settings: Settings) -> list[Report]:
    """The reports of all other kinds, in the order of their names."""
    made = []
    for name, entry in kinds.kinds().items():
        if entry.path == __name__:
            continue
        try:
            reports = entry.load().make(sections, settings)
        except UserError:  # this table is of other data
            continue
        made += [dataclasses.replace(each, facts=each.facts | {"table": name}) for each in reports]
    return made
