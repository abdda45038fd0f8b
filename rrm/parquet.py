"""Parquet files that are replaced while others read them.

Whoever reads one by its path (pandas and pyarrow do) opens it twice: for the footer, then for the pages that the footer
points at. Where the file was replaced in between, the pages are looked for in its successor. A file therefore keeps the
pages of those it replaced where they were, for `KEPT_S`, and has its own in a gap between them::

    magic | own pages | pages of the version before | pages of the version before that | footer
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from rrm.files import UnfitFileError, read_bounded, write_atomically

if TYPE_CHECKING:
    import pyarrow as pa

#: For how long after its replacement a version can still be read, seconds. Between the two openings lie milliseconds.
KEPT_S = 10.0

_KEY = b"rrm.pages"
_MAGIC = b"PAR1"
_LARGEST = 2**30  # bytes of a file whose readers are looked after


class Pages(NamedTuple):
    """Where the pages of one version lie: bytes `start` to `end` of the file."""

    start: int
    end: int
    replaced: float | None = None  #: when, seconds since the epoch; None for the version that the footer describes


def read_table(file: bytes) -> pa.Table:
    """The table in a parquet file. What `pyarrow` raises, or an `OSError` or `ValueError`, where it is damaged."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    # A thread of Arrow's that is still at work when the process ends aborts it.
    return pq.ParquetFile(pa.BufferReader(file), page_checksum_verification=True).read(use_threads=False)


def write_table(path: Path, table: pa.Table, **settings: Any) -> None:
    """Replace `path` by the table, durably; who is reading it by its path meanwhile gets what it held, or the table.

    A file that holds the same rows, columns and metadata already is left alone, whichever version wrote it. An
    `OSError` names `path`, and leaves the old file untouched. Settings are those of `pyarrow.parquet.ParquetWriter`.
    """
    try:
        before = read_bounded(path, _LARGEST)
    except (FileNotFoundError, UnfitFileError):
        before = b""
    if not _holds(before, table):
        write_atomically(path, table_bytes(table, before, **settings))


def _holds(file: bytes, table: pa.Table) -> bool:
    """Whether a parquet file holds this table. By their bytes in one layout: a NaN is itself there."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        content = pq.ParquetFile(pa.BufferReader(file), page_checksum_verification=True)
        if content.metadata.num_rows != table.num_rows:
            return False
        rows = content.read(use_threads=False)
    except (pa.ArrowException, OSError, ValueError):
        return False
    metadata = {key: value for key, value in (rows.schema.metadata or {}).items() if key != _KEY}
    return table_bytes(rows.replace_schema_metadata(metadata or None)) == table_bytes(table)


def table_bytes(table: pa.Table, before: bytes = b"", **settings: Any) -> bytes:
    """The table as a parquet file, in place of the file `before`, whose readers are not disturbed if it is whole."""
    kept = _kept(before)
    start = len(_MAGIC)
    pages, footer = _encoded_at(start, table, kept, settings)
    for place in kept:  # to the first gap that is large enough, or behind the last
        if start + len(pages) <= place.start:
            break
        start = max(start, place.end)
    if start != len(_MAGIC):
        pages, footer = _encoded_at(start, table, kept, settings)
    data = bytearray(max([start + len(pages), *(place.end for place in kept)]))
    for place in kept:
        data[place.start : place.end] = before[place.start : place.end]
    data[start : start + len(pages)] = pages
    data[: len(_MAGIC)] = _MAGIC
    return bytes(data) + footer


def _kept(before: bytes) -> list[Pages]:
    """The places in a file that its successor must leave as they are, in their order."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    now = time.time()
    try:
        places = [Pages(*place) for place in json.loads(pq.read_metadata(pa.BufferReader(before)).metadata[_KEY])]
    except (pa.ArrowException, OSError, ValueError, TypeError, KeyError, RecursionError):
        return []  # none, a damaged one, or another program's: nobody can have begun to read it as one of these
    kept = [place._replace(replaced=place.replaced or now) for place in places]
    young = [place for place in kept if abs(now - (place.replaced or now)) < KEPT_S]
    return sorted(place for place in young if 0 <= place.start <= place.end <= len(before))


def _encoded_at(start: int, table: pa.Table, kept: list[Pages], settings: dict[str, Any]) -> tuple[bytes, bytes]:
    """Pages that will lie at `start`, and the footer that finds them there."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    with pq.ParquetWriter(sink, table.schema, write_page_checksum=True, **settings) as writer:
        sink.write(bytes(start - sink.tell()))  # the writer notes down where in the stream its pages come to lie
        writer.write_table(table)
        end = sink.tell()
        writer.add_key_value_metadata({_KEY: json.dumps([Pages(start, end), *kept])})
    data = sink.getvalue().to_pybytes()
    return data[start:end], data[end:]
