"""`curve.parquet` as bytes: written with a checksum over its content, and refused where the two do not fit."""

from __future__ import annotations

import math
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rrmctl.commands import rrmctl
from rrmctl.store import validation
from rrmctl.store.files import DamagedError
from rrmctl.store.layout import RunFolder
from rrmctl.store.schema import CHECKSUM_KEY, IDENTITY, MEASURED, VERSION_KEY, curve_schema

if TYPE_CHECKING:
    import pyarrow as pa

#: Settings that read quickest at a few hundred rows; thousands of such files are read at a time.
SETTINGS = {"compression": "snappy", "use_dictionary": False, "write_statistics": False, "write_page_checksum": True}

LARGEST = 2**30  # bytes of a file; a row has some hundred

_TEXTS = [name for name, kind in IDENTITY.items() if kind == "string"]


def table_of(rows: list[dict[str, Any]]) -> pa.Table:
    """Rows, each with every column but those figures it has none of, as `decode` gives them back."""
    import pyarrow as pa

    known = IDENTITY | MEASURED
    schema = curve_schema(dict.fromkeys(name for row in rows for name in row if name not in known))
    missing = dict.fromkeys(schema.names[len(known) :], math.nan)
    table: pa.Table = pa.Table.from_pylist([missing | row for row in rows], schema=schema)
    return table.replace_schema_metadata({**schema.metadata, CHECKSUM_KEY: _checksum(table)})


def decode(data: bytes, path: Path) -> pa.Table:
    """The table in a parquet file of this name.

    Raises:
        DamagedError: it is not an intact curve.
        VersionError: it is of another schema version.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    again = f"bring back a copy, or train the run again: {rerunning(RunFolder(path.parent))}"
    try:
        file = pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True)
        metadata = file.schema_arrow.metadata or {}
        version = int(metadata.get(VERSION_KEY, b"none"))
        table: pa.Table = file.read(use_threads=False)  # callers read many files at a time
        found = _checksum(table)
    except (pa.ArrowException, OSError, ValueError, TypeError) as error:  # TypeError: a text that is missing
        raise DamagedError(f"{path} is damaged: {error}", again) from error
    validation.check_version({"schema_version": version}, path, again)
    schema = curve_schema(name for name in table.schema.names if name not in IDENTITY | MEASURED)
    if sorted(table.schema, key=_name) != sorted(schema, key=_name):
        raise DamagedError(f"{path} is damaged: its columns are not those of a curve", again)
    if metadata.get(CHECKSUM_KEY) != found:
        raise DamagedError(f"{path} is damaged: its content does not match its checksum", again)
    return table.select(schema.names)


def _name(field: pa.Field) -> str:
    return str(field.name)


def rerunning(folder: RunFolder) -> str:
    """Where the command is said that trains a run again."""
    return f"`{rrmctl('show', folder.id, results=folder.results)}` says how"


def _checksum(table: pa.Table) -> bytes:
    """CRC-32 over all values, whatever the file's layout: pages have checksums of their own, its footer has none."""
    crc = 0
    for name, column in zip(table.column_names, table.columns, strict=True):
        values = "\0".join(column.to_pylist()).encode() if name in _TEXTS else column.to_numpy().tobytes()
        crc = zlib.crc32(values, crc)
    return f"{crc:08x}".encode()
