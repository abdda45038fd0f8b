"""The rows of a manifest's grids: axes crossed or paired, some rows left out, some added. No settings are looked at."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

from rrmctl.errors import UserError
from rrmctl.planning.manifest import Axis, Grid, GridRows, Include, Manifest
from rrmctl.planning.profiles import Layer

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

    Raises:
        UserError: paired axes differ in length, an exclude matches nothing, or leaves nothing, or there are too many.
    """
    several = len(manifest.grids) > 1
    rows: dict[GridRow, None] = {}
    for number, grid in enumerate(manifest.grids, start=1):
        where = f"{manifest.path} [[grid]] {number}" if several else f"{manifest.path} [grid]"
        rows |= dict.fromkeys(_grid_rows(grid, where))
        _refuse_many(len(rows), where)
    return list(rows)


def _refuse_many(rows: int, where: str) -> None:
    if rows > _MOST_ROWS:
        raise UserError(f"{where}: {rows:,} rows; an experiment has at most {_MOST_ROWS:,}", "divide it into several")


def _grid_rows(grid: Grid, where: str) -> list[GridRow]:
    rows = list(_crossed(grid, where))
    for excluded in grid.exclude:
        left = [row for row in rows if not _agrees(row, excluded)]
        if len(left) == len(rows):
            raise UserError(f"{where} exclude {_spelled(excluded)}: no row of the grid is like that")
        rows = left
    if not rows:
        raise UserError(f"{where}: exclude leaves no row")
    return rows + [_included(row, entry, where) for entry in grid.include for row in rows]


def _crossed(grid: Grid, where: str) -> Iterator[GridRow]:
    """Every combination of the axes; those of a `zip` advance together."""
    values = {axis: getattr(grid, axis) for axis in AXES}
    paired = {axis: group for group in grid.zip for axis in group}
    groups: list[tuple[Axis, ...]] = list(dict.fromkeys(paired.get(axis, (axis,)) for axis in AXES))
    for group in groups:
        if len({len(values[axis]) for axis in group}) > 1:
            lengths = ", ".join(f"{len(values[axis])} {axis}" for axis in group)
            raise UserError(f"{where} zip: paired axes must be equally long; there are {lengths}")
    sizes = [len(values[group[0]]) for group in groups]
    _refuse_many(math.prod(sizes) * (1 + len(grid.include)), where)
    layer, own = Layer(f"{where} set", grid.set), Layer(f"{where} include", {})
    for places in itertools.product(*map(range, sizes)):
        at = {axis: values[axis][place] for group, place in zip(groups, places, strict=True) for axis in group}
        yield GridRow(at["tasks"], at["methods"], at["teachers"], at["feedback"], layer, own)


def _agrees(row: GridRow, wanted: GridRows) -> bool:
    return all(getattr(wanted, name) in (None, getattr(row, name)) for name in AXES.values())


def _included(row: GridRow, entry: Include, where: str) -> GridRow:
    return GridRow(
        entry.task or row.task,
        entry.method or row.method,
        entry.teacher or row.teacher,
        entry.feedback or row.feedback,
        row.grid,
        Layer(f"{where} include {_spelled(entry)} set", entry.set),
    )


def _spelled(rows: GridRows) -> str:
    given = {name: getattr(rows, name) for name in AXES.values()}
    return "{" + ", ".join(f'{name} = "{value}"' for name, value in given.items() if value is not None) + "}"
