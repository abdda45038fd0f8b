"""Every table that the data can support, one after the other.

A table that has nothing to show is left out. csv and json name the table
that each row belongs to.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

from rrmctl.errors import UserError
from rrmctl.reports import tables
from rrmctl.reports.columns import TextGrid
from rrmctl.reports.report import NoDataError, Report, facts, title
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import Statistics

EXPERIMENTS: tuple[str, ...] = ()
EXPLAINED = ()
OPTIONS = ("plus_minus",)


def make(sections: Sequence[Section], settings: Statistics) -> list[Report]:
    """The reports of all other kinds, in the order of their names."""
    reports = []
    for kind, entry in tables.kinds().items():
        if entry.path != __name__:
            for report in _reports(entry.load().make, sections, settings):
                heading = report.title if report.title.startswith(kind) else f"{kind}: {report.title}"
                reports.append(dataclasses.replace(report, title=heading, facts=report.facts | {"table": kind}))
    return reports


def _reports(
    make: Callable[[Sequence[Section], Statistics], list[Report]], sections: Sequence[Section], settings: Statistics
) -> list[Report]:
    """Those of one kind; what stands in the way of one section keeps no other from being shown."""
    import pandas as pd

    try:
        return make(sections, settings)
    except NoDataError:
        return []
    except UserError as error:
        if len(sections) > 1:
            return [report for section in sections for report in _reports(make, [section], settings)]
        problem, own = str(error), facts(sections[0], settings)
        own["problems"].append(problem)
        return [Report(title(sections[0]), pd.DataFrame(), TextGrid((), ()), (problem,), own)]
