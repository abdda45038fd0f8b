"""Parquet files of a run: its curve, which is whole after every row and refused where damaged, and gradients' norms."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrmctl.commands import rrmctl
from rrmctl.store.files import DamagedError, StorageError, read_bytes, write_table
from rrmctl.store.frame import NUMBER, TEXT, WHOLE, frame, typed
from rrmctl.store.layout import RunFolder, new_results
from rrmctl.store.records import check_version
from rrmctl.store.schema import CHECKSUM_KEY, IDENTITY, MEASURED, VERSION_KEY, curve_schema
from rrmctl.store.status import Status

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

#: Settings that read quickest at a few hundred rows; thousands of such files are read at a time.
SETTINGS = {"compression": "snappy", "use_dictionary": False, "write_statistics": False}

_TEXTS = [name for name, kind in IDENTITY.items() if kind == "string"]
_GRADIENTS = {"run": TEXT, "step": WHOLE, "loss": TEXT, "gradient_norm": NUMBER}


class CurveWriter:
    """The curve of one run, with the values of the columns in `IDENTITY`. Only for the holder of the run's lock."""

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
        """Write evaluations, measured columns and figures, durably; rows of the same steps are replaced."""
        held = self._rows | {int(row["step"]): {name: row[name] for name in (*MEASURED, *row)} for row in rows}
        table = table_of([self._identity | held[step] for step in sorted(held)])
        write_table(self._folder.curve, table, **SETTINGS)
        self._rows = held


def table_of(rows: list[dict[str, Any]]) -> pa.Table:
    """Rows, each with every column but those figures it has none of, as `decode` gives them back."""
    import pyarrow as pa

    fixed = IDENTITY | MEASURED
    schema = curve_schema(dict.fromkeys(name for row in rows for name in row if name not in fixed))
    missing = dict.fromkeys(schema.names[len(fixed) :], math.nan)
    table: pa.Table = pa.Table.from_pylist([missing | row for row in rows], schema=schema)
    return table.replace_schema_metadata({**schema.metadata, CHECKSUM_KEY: _checksum(table)})


def read_curve(folder: RunFolder) -> pa.Table | None:
    """The run's curve as an arrow table; None before its first evaluation."""
    data = read_bytes(folder.curve)
    if data is None:
        return None
    table = decode(data, folder.curve)
    others = set(table["run"].unique().to_pylist()) - {folder.id}
    if others:
        raise DamagedError(
            f"{folder.curve} is the curve of run {', '.join(sorted(others))}, not of {folder.id}",
            f"bring back its own, or train the run again: {_rerunning(folder)}",
        )
    return table


def decode(data: bytes, path: Path) -> pa.Table:
    """The table in a parquet file of this name."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    again = f"bring back a copy, or train the run again: {_rerunning(RunFolder(path.parent))}"
    try:
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        metadata = file.schema_arrow.metadata or {}
        version = int(metadata.get(VERSION_KEY, b"none"))
        table: pa.Table = file.read(use_threads=False)  # callers read many files at a time
        checksum = _checksum(table)
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:  # TypeError: a text that is missing
        raise DamagedError(f"{path} is damaged: {error}", again) from error
    check_version(version, path, again)
    schema = curve_schema(name for name in table.schema.names if name not in IDENTITY | MEASURED)
    if sorted(table.schema, key=attrgetter("name")) != sorted(schema, key=attrgetter("name")):
        raise DamagedError(f"{path} is damaged: its columns are not those of a curve", again)
    if metadata.get(CHECKSUM_KEY) != checksum:
        raise DamagedError(f"{path} is damaged: its content does not match its checksum", again)
    return table.select(schema.names)


def _rerunning(folder: RunFolder) -> str:
    """Where the command is said that trains a run again."""
    return f"`{rrmctl('show', folder.id, results=folder.results)}` says how"


def _checksum(table: pa.Table) -> bytes:
    """CRC-32 over all values, whatever the file's layout: pages have checksums of their own, its footer has none."""
    crc = 0
    for name, column in zip(table.column_names, table.columns, strict=True):
        values = "\0".join(column.to_pylist()).encode() if name in _TEXTS else column.to_numpy().tobytes()
        crc = zlib.crc32(values, crc)
    return f"{crc:08x}".encode()


def lost_rows(folder: RunFolder, status: Status) -> str | None:
    """What is wrong with the curve of a run that is done, in words; None when every evaluation is there."""
    try:
        table = read_curve(folder)
    except (DamagedError, StorageError) as error:
        return str(error)
    rows = 0 if table is None else table.num_rows
    if rows >= status.rows:
        return None
    if table is None:
        return f"{folder.curve} is missing, with {status.rows} evaluations"
    return f"{folder.curve} holds {rows} evaluations, {status.rows} had been written"


def load_gradients(results: str | Path, runs: Sequence[str]) -> pd.DataFrame:
    """The norms of the gradients in the reward of these runs, at every gradient step.

    Args:
        results: the results root.
        runs: their ids; those that left no `gradients.parquet` are left out.

    Returns:
        Columns `run`, `step` (environment steps), `loss` (text) and `gradient_norm`.
    """
    import pandas as pd
    import pyarrow as pa
    import pyarrow.parquet as pq

    frames = [frame([], _GRADIENTS)]
    for folder in map(new_results(results).run, dict.fromkeys(runs)):
        data = read_bytes(folder.gradients) if folder.gradients.is_file() else None
        if data is None:
            continue
        try:
            file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
            norms: pd.DataFrame = file.read(use_threads=False).to_pandas(use_threads=False)
            if ["run", *norms.columns] != list(_GRADIENTS):
                raise ValueError(f"its columns are {', '.join(norms.columns)}")
            frames.append(typed(norms.assign(run=folder.id)[list(_GRADIENTS)], _GRADIENTS))
        except (pa.ArrowException, OSError, ValueError, TypeError) as error:
            hint = f"remove the file, or train the run again: {_rerunning(folder)}"
            raise DamagedError(f"{folder.gradients} is damaged: {error}", hint) from error
    return pd.concat(frames, ignore_index=True)
