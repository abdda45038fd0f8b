"""The tables as DataFrames, for notebooks: `report_table("less-feedback", "results/reference")`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from rrmctl.reports.plugins import choose
from rrmctl.reports.select import sections_for
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.tables import kinds
from rrmctl.store.frame import MAYBE_WHOLE, typed

if TYPE_CHECKING:
    import pandas as pd

_NULLABLE = {"int64": MAYBE_WHOLE, "bool": "boolean"}


def report_table(
    kind: str,
    results: str | Path = "results",
    experiment: str | None = None,
    *,
    profile: str | None = None,
    allow_mixed: bool = False,
    settings: Statistics = DEFAULTS,
) -> pd.DataFrame:
    """What `rrmctl report KIND [EXPERIMENT]` shows, in raw values: success as a fraction, NaN where there is nothing.

    The arguments are those of the command line. The columns are `experiment, profile, variant`, then those of the table
    (docs/reports.md).

    Raises:
        UserError: no such table, nothing to show, or runs that do not belong together.
    """
    import pandas as pd

    module = choose(kinds(), kind, "table").load()
    experiments = [experiment] if experiment else module.EXPERIMENTS
    apart = getattr(module, "APART", False)
    sections = sections_for(results, experiments, profile, allow_mixed=allow_mixed, apart=apart)
    reports = module.make(sections, settings)
    whose = ("experiment", "profile", "variant")
    tables = [report.table.assign(**{name: report.facts[name] for name in whose}) for report in reports]
    common = set.intersection(*(set(table.columns) for table in tables))
    for at, table in enumerate(tables):  # what some tables lack keeps its type beside them
        wider = {name: _NULLABLE.get(str(kind)) for name, kind in table.dtypes.items() if name not in common}
        tables[at] = table.astype({name: kind for name, kind in wider.items() if kind})
    whole = typed(pd.concat(tables, ignore_index=True))
    return whole.reindex(columns=[*whose, *(name for name in whole.columns if name not in whose)])
