"""Writing a run's curve: after every row the file on disk is whole and holds every row so far."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rrmctl.store.curve import SETTINGS, table_of
from rrmctl.store.files import write_table
from rrmctl.store.layout import RunFolder
from rrmctl.store.reader import read_curve
from rrmctl.store.schema import IDENTITY, MEASURED


class CurveWriter:
    """The curve of one run. Only for the holder of the run's lock.

    Args:
        folder: the run's folder.
        identity: values of the columns in `schema.IDENTITY`.

    Raises:
        DamagedError: the curve on disk is damaged.
    """

    def __init__(self, folder: RunFolder, identity: Mapping[str, Any]) -> None:
        self._folder = folder
        self._identity = {name: identity[name] for name in IDENTITY}
        table = read_curve(folder)
        rows: list[dict[str, Any]] = [] if table is None else table.drop_columns(list(IDENTITY)).to_pylist()
        self._rows = {row["step"]: row for row in rows}

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def last_step(self) -> int:
        """Step of the last evaluation; 0 before the first."""
        return max(self._rows, default=0)

    def __contains__(self, step: int) -> bool:
        """Whether it holds an evaluation of this step."""
        return step in self._rows

    def add(self, *rows: Mapping[str, Any]) -> None:
        """Write evaluations, durably; rows of the same steps are replaced.

        Args:
            rows: the measured columns, and figures.

        Raises:
            StorageError: the folder takes no write; the curve on disk holds the rows before.
            KeyError: a row lacks a measured column.
        """
        held = self._rows | {int(row["step"]): {name: row[name] for name in (*MEASURED, *row)} for row in rows}
        table = table_of([self._identity | held[step] for step in sorted(held)])
        write_table(self._folder.curve, table, **SETTINGS)
        self._rows = held
