"""The rows of a manifest's grids: axes crossed or paired, some rows left out, some added."""

from __future__ import annotations

import itertools
import math
from collections import ChainMap
from dataclasses import dataclass, replace
from typing import Any

from rrmctl.errors import UserError
from rrmctl.planning.manifest import Axis, Grid, Manifest
from rrmctl.planning.settings import Layer

#: The axes of a grid in the order in which rows vary, the last one fastest, and what a row calls its value.
AXES: dict[Axis, str] = {"tasks": "task", "methods": "method", "teachers": "teacher", "feedback": "feedback"}

#: Each is configured by itself: some ten milliseconds.
_MOST_ROWS = 5000


@dataclass(frozen=True)
class GridRow:
    """One row of a grid, before seeds."""

    task: str
    method: str
    teacher: str
    feedback: str
    grid: Layer  #: the `set` of its grid
    own: Layer  #: the `set` of the include it comes from


def rows_of(manifest: Manifest) -> list[GridRow]:
    """Every row, in the manifest's order.

    Paired axes of different lengths, an exclude that matches or leaves nothing, and too many rows are refused.
    """
    rows: dict[GridRow, None] = {}
    for number, grid in enumerate(manifest.grids, start=1):
        where = f"{manifest.path} [[grid]] {number}" if len(manifest.grids) > 1 else f"{manifest.path} [grid]"
        rows |= dict.fromkeys(_grid_rows(grid, where))
        _refuse_many(len(rows), where)
    return list(rows)


def _refuse_many(rows: int, where: str) -> None:
    if rows > _MOST_ROWS:
        raise UserError(f"{where}: {rows:,} rows; an experiment has at most {_MOST_ROWS:,}", "divide it into several")


def _grid_rows(grid: Grid, where: str) -> list[GridRow]:
    rows = _crossed(grid, where)
    for excluded in grid.exclude:
        left = [row for row in rows if not excluded.given.items() <= vars(row).items()]
        if len(left) == len(rows):
            raise UserError(f"{where} exclude {excluded}: no row of the grid is like that")
        rows = left
    if not rows:
        raise UserError(f"{where}: exclude leaves no row")
    added = []
    for entry in grid.include:
        changes: dict[str, Any] = {**entry.given, "own": Layer.read(f"{where} include {entry} set", entry.set)}
        added += [replace(row, **changes) for row in rows]
    return rows + added


def _crossed(grid: Grid, where: str) -> list[GridRow]:
    """Every combination of the axes; those of a `zip` advance together."""
    paired = {axis: group for group in grid.zip for axis in group}
    choices = []
    for group in dict.fromkeys(paired.get(axis, (axis,)) for axis in AXES):
        values = [getattr(grid, axis) for axis in group]
        if len(set(map(len, values))) > 1:
            lengths = ", ".join(f"{len(names)} {axis}" for axis, names in zip(group, values, strict=True))
            raise UserError(f"{where} zip: paired axes must be equally long; there are {lengths}")
        places = [AXES[axis] for axis in group]
        choices.append([dict(zip(places, names, strict=True)) for names in zip(*values, strict=True)])
    _refuse_many(math.prod(map(len, choices)) * (1 + len(grid.include)), where)
    layer, own = Layer.read(f"{where} set", grid.set), Layer(f"{where} include", {})
    cells = (ChainMap(*parts) for parts in itertools.product(*choices))
    return [GridRow(at["task"], at["method"], at["teacher"], at["feedback"], layer, own) for at in cells]
