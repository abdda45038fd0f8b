"""Fine-tuning: the norm of the reward network's gradient over steps, across the change from one loss to the other.

Drawn of runs that left `gradients.parquet`: of the method `finetune` and those after it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from rrmctl.reports.captions import title
from rrmctl.reports.figure_layout import Slot, cells_sheet
from rrmctl.reports.notebook import nothing, one_section
from rrmctl.reports.plot_elements import band, contents, line, methods, panel_name, step_axis
from rrmctl.reports.series import Floats, Section, Series, Steps
from rrmctl.reports.statistics import DEFAULTS, Statistics, Width
from rrmctl.reports.styles import Looks
from rrmctl.stats import IqmKind, iqm
from rrmctl.store.curve import load_gradients

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: Over the length of a run: norms jump from minibatch to minibatch.
_BINS = 60
#: The loss after the change.
_FINE_TUNING = "preferences"


def suits(section: Section) -> bool:
    """Some run left the norms of its gradients."""
    return section.source is not None and any(
        section.source.run(run).gradients.is_file() for each in section.series for run in each.runs
    )


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """A panel for each task, with the median norm in each sixtieth of the steps, before and after the change.

    Raises:
        UserError: no run left norms.
        DamagedError: a file with norms cannot be read.
    """
    runs = [run for each in section.series for run in each.runs]
    if section.source is None:
        raise nothing(section, "no gradients beside the curves")
    return _draw(section, load_gradients(section.source.root, runs), settings)


def gradient_norms(
    rows: pd.DataFrame,
    gradients: pd.DataFrame,
    jobs: pd.DataFrame | None = None,
    *,
    kind: IqmKind = "rliable",
    width: Width = "page",
) -> Figure:
    """The same in a notebook: `gradients` as `rrmctl.store.load_gradients` returns it, the rest as for other figures.

    Raises:
        UserError: several variants or experiments at once, or no norms of these runs.
    """
    return _draw(one_section(rows, jobs), gradients, Statistics(kind=kind, width=width))


def _draw(section: Section, gradients: pd.DataFrame, settings: Statistics) -> Figure:
    told = set(gradients["run"])
    panels, looks = section.panels(), section.looks()
    shown = {panel: [_only(each, told) for each in panel.present() if told.intersection(each.runs)] for panel in panels}
    if not any(shown.values()):
        raise nothing(section, "no norms of gradients")
    return cells_sheet(
        title(section),
        [
            _cell(panel_name(panel, panels), series, looks, gradients, settings.kind)
            for panel, series in shown.items()
            if series
        ],
        size=settings.width,
        handles=methods((each for series in shown.values() for each in series), looks),
        notes=[
            f"Median over the gradient steps in each {_BINS}th of the run, then the interquartile mean over seeds "
            f"({settings.kind}). Band: 25 to 75 % of the seeds. Grey: where the loss changes.",
            *_counted(section, told),
            *contents(section),
        ],
    )


def _only(series: Series, told: set[str]) -> Series:
    """The series of those of its runs that left norms."""
    left = [at for at, run in enumerate(series.runs) if run in told]
    seeds, runs = tuple(series.seeds[at] for at in left), tuple(series.runs[at] for at in left)
    return replace(series, values=series.values[left], seeds=seeds, runs=runs)


def _counted(section: Section, told: set[str]) -> Iterator[str]:
    """How many runs left norms, and which did not though others of their series did."""
    yield f"Norms of {len(told.intersection(run for each in section.series for run in each.runs))} runs."
    for each in section.series:
        lacking = [f"{run} (seed {seed})" for seed, run in zip(each.seeds, each.runs, strict=True) if run not in told]
        if 0 < len(lacking) < each.n:
            yield f"No norms of {each.label}: {', '.join(lacking)}."


def _cell(name: str, shown: Sequence[Series], looks: Looks, gradients: pd.DataFrame, kind: IqmKind) -> Slot:
    def fill(axes: Axes) -> None:
        last = max(int(each.steps[-1]) for each in shown)
        for position, series in enumerate(shown):
            own = gradients[gradients["run"].isin(series.runs)]
            for _, phase in own.groupby(own["loss"] == _FINE_TUNING):
                steps, norms = binned(phase, series.runs, last / _BINS)
                if steps.size:
                    look = looks[series.label.method]
                    line(axes, steps, iqm(norms, kind, axis=0), look, position)
                    band(axes, steps, norms, look)
            before = own["step"][own["loss"] != _FINE_TUNING]
            if len(before):
                axes.axvline(int(before.max()), color="#555555", linewidth=0.8, linestyle=(0, (3, 2)), zorder=1)
        axes.set_yscale("log", nonpositive="clip")
        step_axis(axes, last)

    return Slot(name, "Norm of the reward's gradient", fill)


def binned(gradients: pd.DataFrame, runs: Sequence[str], length: float) -> tuple[Steps, Floats]:
    """Medians of each run in bins of `length` steps, where all runs have one: middles [T], and norms [S, T]."""
    bins = (gradients["step"] // length).rename("bin")
    table = gradients.groupby([gradients["run"], bins])["gradient_norm"].median().unstack("bin").reindex(list(runs))
    table = table.dropna(axis="columns")
    middles = (table.columns.to_numpy(dtype=np.float64) + 0.5) * length
    return middles.astype(np.int64), table.to_numpy(dtype=np.float64)
