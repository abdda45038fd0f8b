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


class FromFrames:
    """The notebook's side of a figure's `draw`: of one variant of one experiment."""

    def __init__(self, draw: Callable[[Section, Statistics], Figure]) -> None:
        self._draw = draw
        self.__doc__ = draw.__doc__

    def __call__(
        self,
        rows: pd.DataFrame,
        jobs: pd.DataFrame | None = None,
        *,
        kind: IqmKind = "rliable",
        width: Width = "page",
        replicates: int = REPLICATES,
    ) -> Figure:
        """Draw it.

        Args:
            rows: one variant of one experiment, as `rrmctl.store.load` returns it.
            jobs: as `rrmctl.store.planned`, to say which runs are missing.
            kind: of interquartile mean.
            width: of the figure: `column` (3.3 inches) or `page` (at most 7).
            replicates: resampled data sets behind intervals, where it has any.

        Raises:
            UserError: several variants or experiments at once, runs that do not belong together, or nothing to draw.
        """
        return self._draw(one_section(rows, jobs), Statistics(kind=kind, width=width, replicates=replicates))


def nothing(section: Section, what: str) -> UserError:
    """The refusal of a figure for which a section has `what` ("no ..."); to be raised."""
    return UserError(
        f"{section.experiment}, profile {section.profile}: {what} to draw",
        f"`rrmctl run {section.experiment}` makes runs, `rrmctl plot {section.experiment}` draws what suits them",
    )


def one_section(rows: pd.DataFrame, jobs: pd.DataFrame | None) -> Section:
    """The section of these frames.

    Raises:
        UserError: there is not exactly one, or its runs do not belong together.
    """
    found = sections(rows, jobs)
    if len(found) != 1:
        which = ", ".join(f"{each.experiment}/{each.variant}" for each in found) or "none"
        raise UserError(f"a figure shows one variant of one experiment, not {which}", "filter the rows beforehand")
    return found[0]
