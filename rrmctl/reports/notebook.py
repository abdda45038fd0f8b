"""Figures from DataFrames: what `rrmctl plot` draws of files, a notebook draws of the frames it has read."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from rrmctl.errors import UserError
from rrmctl.reports.select import sections
from rrmctl.reports.statistics import Statistics, Width
from rrmctl.stats import REPLICATES, IqmKind

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from rrmctl.reports.series import Section


def from_frames(draw: Callable[[Section, Statistics], Figure]) -> Callable[..., Figure]:
    """The notebook's side of a figure's `draw`."""

    def drawn(
        rows: pd.DataFrame,
        jobs: pd.DataFrame | None = None,
        *,
        kind: IqmKind = "rliable",
        width: Width = "page",
        replicates: int = REPLICATES,
    ) -> Figure:
        return draw(one_section(rows, jobs), Statistics(kind=kind, width=width, replicates=replicates))

    drawn.__doc__ = f"""{draw.__doc__}
    Args:
        rows: one variant of one experiment, as `rrmctl.store.load` returns it; several are refused.
        jobs: as `rrmctl.store.planned`, to say which runs are missing.
        kind: of interquartile mean.
        width: of the figure: `column` (3.3 inches) or `page` (at most 7).
        replicates: resampled data sets behind intervals, where it has any.
    """
    return drawn


def one_section(rows: pd.DataFrame, jobs: pd.DataFrame | None) -> Section:
    """The section of these frames.

    Raises:
        UserError: there is not exactly one, or its runs do not belong together.
    """
    read = sections(rows, jobs)
    if len(read) != 1:
        which = ", ".join(f"{section.experiment}/{section.variant}" for section in read) or "none"
        raise UserError(f"a figure shows one variant of one experiment, not {which}", "filter the rows beforehand")
    return read[0]
