"""`aggregates/<experiment>.parquet`: the IQM curves of an experiment, one row per variant, series and step.

experiment, variant, profile          strings; profile and overrides are the variant
task, method, teacher, feedback       strings; "-" where nothing is asked
step                                  int64, environment steps
iqm, q25, q75                         float64; success as a fraction, true return as it is (by task)
low, high                             float64, 95 % interval of the IQM; NaN below three seeds
n                                     int64, seeds
iqm_kind                              string, "rliable" or "exact"
schema_version                        int64, `rrmctl.reports.iqm_curves.CURVES_VERSION`
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rrmctl.errors import UserError
from rrmctl.reports.iqm_curves import CURVE_COLUMNS, curve_table
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.store.files import remove_leftovers, write_table
from rrmctl.store.frame import TEXT

if TYPE_CHECKING:
    from rrmctl.reports.series import Section
    from rrmctl.store.layout import Layout


def write(layout: Layout, sections: Sequence[Section], settings: Statistics = DEFAULTS) -> None:
    """Replace the files of all experiments in `sections`, each as a whole.

    Raises:
        UserError: some hold runs that do not belong together, which a file has no room to say; theirs stay as they are.
        StorageError: the results folder takes no write; the old files are untouched.
    """
    import pandas as pd
    import pyarrow as pa

    mixed = {section.experiment for section in sections if section.mixed or section.refusal}
    tables = [curve_table(section, settings) for section in sections if section.experiment not in mixed]
    curves = pd.concat(tables, ignore_index=True).groupby("experiment", sort=False) if tables else ()
    kinds = {name: "string" if kind == TEXT else kind for name, kind in CURVE_COLUMNS.items()}
    schema = pa.schema([pa.field(name, kind, nullable=False) for name, kind in kinds.items()])
    for experiment, rows in curves:
        # from_pandas=False: a NaN stays a number and does not become a null.
        columns = [pa.array(rows[field.name].to_numpy(), field.type, from_pandas=False) for field in schema]
        path = layout.aggregate(str(experiment))
        remove_leftovers(path.parent)
        write_table(path, pa.Table.from_arrays(columns, schema=schema))
    if mixed:
        why = "; ".join(str(section.refusal) for section in sections if section.refusal)
        what = f"{', '.join(sorted(mixed))}: runs that are mixed are not kept as one curve"
        raise UserError(f"{what}: {why}" if why else what)
