"""Writing a run's curve: after every row the file on disk is whole and holds every row so far."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rrmctl.store.atomic import DamagedError, set_aside, write_bytes
from rrmctl.store.curve import encode
from rrmctl.store.layout import RunFolder
from rrmctl.store.reader import read_curve
from rrmctl.store.schema import IDENTITY, MEASURED


class CurveWriter:
    """The curve of one run. Only for the holder of the run's lock.

    Args:
        folder: the run's folder.
        identity: values of the columns in `schema.IDENTITY`.
        expected: rows known to have been written before; fewer on disk means that some were lost.

    Raises:
        DamagedError: the curve on disk is damaged, and was set aside as `curve.parquet.corrupt-N`; or rows are missing.
    """

    def __init__(self, folder: RunFolder, identity: Mapping[str, Any], *, expected: int = 0) -> None:
        self._folder = folder
        self._identity = {name: identity[name] for name in IDENTITY}
        self._rows: dict[int, dict[str, Any]] = {row["step"]: row for row in self._saved()}
        if len(self._rows) < expected:
            raise DamagedError(
                f"{folder.curve} holds {len(self._rows)} evaluations, {expected} had been written",
                "bring the file back, or train the run from nothing with --force",
            )

    def __len__(self) -> int:
        return len(self._rows)

    @property
    def last_step(self) -> int:
        """Step of the last evaluation; 0 before the first."""
        return max(self._rows, default=0)

    def add(self, row: Mapping[str, Any]) -> None:
        """Write one evaluation, durably; a row of the same step is replaced.

        Raises:
            StorageError: the folder takes no write; the curve on disk holds the rows before.
            KeyError: the row lacks a measured column.
        """
        rows = self._rows | {int(row["step"]): {name: row[name] for name in MEASURED}}
        write_bytes(self._folder.curve, encode([self._identity | rows[step] for step in sorted(rows)]))
        self._rows = rows

    def _saved(self) -> list[dict[str, Any]]:
        if not self._folder.curve.exists():
            return []
        try:
            table = read_curve(self._folder)
        except DamagedError as error:
            aside = set_aside(self._folder.curve, "corrupt")
            raise DamagedError(
                f"{error}; it was set aside as {aside.name}", "train the run from nothing with --force"
            ) from error
        assert table is not None
        rows: list[dict[str, Any]] = table.select(list(MEASURED)).to_pylist()
        return rows
