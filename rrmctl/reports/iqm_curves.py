"""The IQM table and the IQM curves of a section, as DataFrames, and the curves' files.

Values are raw here: success as a fraction, returns as they are. What must stand beside them is added where a report is
made of them. `aggregates/<experiment>.parquet` holds the curves of an experiment, a row for each variant, series and
step; profile and overrides are the variant.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from rrm.envs.tasks import TASKS
from rrmctl.errors import UserError
from rrmctl.reports.columns import METHOD, PLACE, QUARTILES, RUNS, SCORE, Column, estimated, step
from rrmctl.reports.scores import score
from rrmctl.reports.series import Panel, Section, Series, at_steps
from rrmctl.reports.statistics import BOOTSTRAP_SEED, DEFAULTS, LEVEL, Statistics
from rrmctl.stats import Estimate, Floats, Iqm, area_under_curve, estimate, interval_possible, iqm, quartiles, resample
from rrmctl.store.files import remove_leftovers, write_table
from rrmctl.store.frame import MAYBE_WHOLE, NUMBER, TEXT, WHOLE, frame

if TYPE_CHECKING:
    import pandas as pd

    from rrmctl.store.layout import Layout

#: Of the curves' parquet file; raised by one when a column is added, removed, or changes its meaning.
CURVES_VERSION = 1
#: With their types. Teacher and feedback are "-" where nothing is asked; low and high, the 95 % interval of the IQM,
#: are NaN below three seeds; n counts seeds.
CURVE_COLUMNS = {
    "experiment": TEXT, "variant": TEXT, "profile": TEXT, "task": TEXT, "method": TEXT, "teacher": TEXT,
    "feedback": TEXT, "step": WHOLE, "iqm": NUMBER, "q25": NUMBER, "q75": NUMBER, "low": NUMBER, "high": NUMBER,
    "n": WHOLE, "iqm_kind": TEXT, "schema_version": WHOLE,
}  # fmt: skip

#: Stands for the task in rows that pool all tasks read by success, with what agents see behind it where that differs.
ALL_TASKS = "success tasks"
#: Beside a step that is merely the last one, and before the note that says so.
LAST_MARK = "*"


#: Of the table.
COLUMNS = (
    *PLACE, METHOD, SCORE,
    Column("step", MAYBE_WHOLE, "Step", lambda row: step(row) + (LAST_MARK if row["step_rule"] == "last" else "")),
    Column("step_rule"),
    *estimated("iqm", "IQM", best=True), *QUARTILES, *RUNS, *estimated("auc", "AUC", "auc_", None),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Curve:
    """A series' statistics at each of its steps, of the score that is read there."""

    iqm: Estimate  #: arrays [T]
    q25: Floats  #: [T]
    q75: Floats  #: [T]
    #: Under the IQM curve of single evaluations, as mean heights over the steps of each panel it stands in, by teacher
    #: and feedback.
    areas: Mapping[tuple[str, str], Estimate]


@lru_cache(maxsize=64)  # a table and the file beside it are made of the same curves; replicates are not kept
def curves(section: Section, settings: Statistics = DEFAULTS) -> Mapping[Series, Curve]:
    """The curve of every series that has a run."""
    panels = [panel for panel in section.panels() if panel.comparable()]
    by_series = {}
    for series in (series for series in section.series if series.n):
        ends, areas = at_steps(series, series.steps, settings.last), {}
        point, draws = _drawn(series.values, settings)
        final, final_draws = (point, draws) if settings.last == 1 else _drawn(ends, settings)
        for panel in (panel for panel in panels if series in panel.series):
            steps = panel.steps()
            where = np.searchsorted(series.steps, steps)
            drawn = None if draws is None else area_under_curve(steps, draws[:, where])
            area = area_under_curve(steps, point[where])
            areas[panel.teacher, panel.feedback] = estimate(area, drawn, n=series.n, level=LEVEL)
        whole = estimate(final, final_draws, n=series.n, level=LEVEL)
        by_series[series] = Curve(whole, *quartiles(ends, axis=0), areas)
    return by_series


def _drawn(values: Floats, settings: Statistics) -> tuple[Floats, Floats | None]:
    """The IQM over seeds of values [S, T], and its replicates [R, T] where there are seeds enough for an interval."""
    point, draws = np.asarray(iqm(values, settings.kind, axis=0)), None
    if interval_possible([len(values)]):
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        draws = resample([values], Iqm(settings.kind), rng=rng, replicates=settings.replicates)
    return point, draws


def curve_table(section: Section, settings: Statistics = DEFAULTS) -> pd.DataFrame:
    """The IQM curves of a section, one row per series and step: columns `CURVE_COLUMNS`."""
    whose = (section.experiment, section.variant, section.profile)
    rows = [
        (*whose, *series.label, step, *numbers, series.n, settings.kind, CURVES_VERSION)
        for series, curve in curves(section, settings).items()
        for step, *numbers in zip(
            series.steps, curve.iqm.estimate, curve.q25, curve.q75, curve.iqm.low, curve.iqm.high, strict=True
        )
    ]
    return frame(rows, CURVE_COLUMNS)


def write_curves(layout: Layout, sections: Sequence[Section], settings: Statistics = DEFAULTS) -> None:
    """Replace the files of all experiments in `sections`, each as a whole.

    A UserError names those that hold runs that do not belong together, which a file has no room to say; theirs stay as
    they are.
    """
    import pandas as pd
    import pyarrow as pa

    mixed = {section.experiment for section in sections if section.mixed or section.refusal}
    tables = [curve_table(section, settings) for section in sections if section.experiment not in mixed]
    by_experiment = pd.concat(tables, ignore_index=True).groupby("experiment", sort=False) if tables else ()
    kinds = {name: "string" if kind == TEXT else kind for name, kind in CURVE_COLUMNS.items()}
    schema = pa.schema([pa.field(name, kind, nullable=False) for name, kind in kinds.items()])
    for experiment, rows in by_experiment:
        # from_pandas=False: a NaN stays a number and does not become a null.
        columns = [pa.array(rows[field.name].to_numpy(), field.type, from_pandas=False) for field in schema]
        path = layout.aggregate(str(experiment))
        remove_leftovers(path.parent)
        write_table(path, pa.Table.from_arrays(columns, schema=schema))
    if mixed:
        why = "; ".join(str(section.refusal) for section in sections if section.refusal)
        what = f"{', '.join(sorted(mixed))}: runs that are mixed are not kept as one curve"
        raise UserError(f"{what}: {why}" if why else what)


def iqm_table(section: Section, settings: Statistics = DEFAULTS) -> pd.DataFrame:
    """Per task and method the IQM at the task's common step, with its interval: columns `COLUMNS`."""
    return frame(iqm_rows(section, settings), {column.name: column.kind for column in COLUMNS})


def iqm_rows(section: Section, settings: Statistics) -> list[dict[str, Any]]:
    """Its rows; what is missing is not there."""
    panels, by_series, rows = section.panels(), curves(section, settings), []
    for panel in panels:
        read = panel.read_at()
        rule = "final" if panel.score == "return" else "first" if read.reached else "last"
        for series in panel.series:
            rows.append(panel.row(series) | {"step": read.step, "step_rule": rule})
            if series in by_series:
                curve = by_series[series]
                at, area = int(np.searchsorted(series.steps, read.step)), curve.areas[panel.teacher, panel.feedback]
                here = {"iqm": curve.iqm.estimate, "low": curve.iqm.low, "high": curve.iqm.high}
                here |= {"q25": curve.q25, "q75": curve.q75}
                rows[-1] |= {name: float(values[at]) for name, values in here.items()} | area.row("auc", "auc_")
    return rows + [row for name, group in across_tasks(panels) for row in _group_rows(name, group, settings)]


def across_tasks(panels: Sequence[Panel]) -> list[tuple[str, list[Panel]]]:
    """Panels of different success tasks that may be pooled, and what those are called together.

    Each group has all tasks on which agents see the same kind of thing, states or images: there agents and heuristics
    are the same.
    """
    success = [panel for panel in panels if panel.score == "success"]
    on_images = [panel for panel in success if _on_images(panel.task)]
    if not on_images or len(on_images) == len(success):
        return [(ALL_TASKS, group) for group in _alike(success)]
    on_states = [panel for panel in success if panel not in on_images]
    return [
        (f"{ALL_TASKS} on {what}", group)
        for what, those in (("states", on_states), ("images", on_images))
        for group in _alike(those)
    ]


def _alike(panels: Sequence[Panel]) -> list[list[Panel]]:
    """Groups of one teacher and schedule, with as many tasks in each as there are, or no group."""
    tasks = {panel.task for panel in panels}
    if len(tasks) < 2:
        return []
    if len(panels) == len(tasks):
        return [list(panels)]  # one teacher and schedule for each task, though a schedule may be the task's own
    groups: dict[tuple[str, str], list[Panel]] = defaultdict(list)
    for panel in panels:
        groups[panel.teacher, panel.feedback].append(panel)
    return [group for group in groups.values() if len(group) == len(tasks)]


def _on_images(name: str) -> bool:
    return name in TASKS and TASKS[name].spaces.frames is not None


def _group_rows(name: str, group: Sequence[Panel], settings: Statistics) -> Iterator[dict[str, Any]]:
    """A row for every method that has runs on all tasks of the group, each task read at its own common step."""
    by_task = [{series.label.method: series for series in panel.present()} for panel in group]
    named = ({panel.teacher for panel in group}, "several"), ({panel.feedback for panel in group}, "each task's")
    teacher, feedback = (names.pop() if len(names) == 1 else otherwise for names, otherwise in named)
    for method in (name for name in by_task[0] if all(name in methods for methods in by_task)):
        series = [methods[method] for methods in by_task]
        scores = [
            at_steps(one, [panel.read_at().step], settings.last) for one, panel in zip(series, group, strict=True)
        ]
        q25, q75 = quartiles(np.concatenate(scores))
        yield {
            "task": name, "teacher": teacher, "feedback": feedback, "method": method, "score": "success",
            "step_rule": "each", "q25": float(q25), "q75": float(q75), "n": sum(one.n for one in series),
            "planned": sum(one.planned for one in series),
            **score(scores, settings, pooled=True).estimate().row("iqm"),
        }  # fmt: skip
