"""Every table that the data can support, one after the other.

A table that has nothing to show is left out. csv and json name the table
that each row belongs to.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from rrmctl.errors import UserError
from rrmctl.reports import tables
from rrmctl.reports.captions import facts
from rrmctl.reports.captions import title as title_of
from rrmctl.reports.report import Grid, NoDataError, Report
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import Statistics

EXPERIMENT = None
EXPLAINED = ()
OPTIONS = ("plus_minus",)

Make = Callable[[Sequence[Section], Statistics], list[Report]]


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """The reports of all other kinds, in the order of their names."""
    made = []
    for name, entry in tables.kinds().items():
        if entry.path != __name__:
            made += [_named(name, each) for each in _reports(entry.load().make, sections, settings)]
    return made


def _reports(make: Make, sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """Those of one kind; what stands in the way of one section keeps no other from being shown."""
    try:
        return make(sections, settings)
    except NoDataError:
        return []
    except UserError as error:
        if len(sections) == 1:
            return [_words(sections[0], settings, str(error))]
        return [report for section in sections for report in _reports(make, [section], settings)]


def _named(kind: str, report: Report) -> Report:
    title = report.title if report.title.startswith(kind) else f"{kind}: {report.title}"
    return dataclasses.replace(report, title=title, facts=report.facts | {"table": kind})


def _words(section: Section, settings: Statistics, problem: str) -> Report:
    """What is said in place of a table that cannot be made."""
    import pandas as pd

    known = facts(section, settings)
    known["problems"] = [*known["problems"], problem]
    return Report(title_of(section), pd.DataFrame(), Grid((), ()), (problem,), known)
