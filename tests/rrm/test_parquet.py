"""Parquet files that are replaced under their readers."""

from __future__ import annotations

import io
import os
import struct
import threading
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rrm import parquet
from rrm.parquet import read_table, table_bytes, write_table

tables = st.builds(
    lambda values, text: pa.table({"a": values, "b": [text] * len(values)}),
    st.lists(st.integers(-(2**40), 2**40), min_size=1, max_size=60),
    st.text(max_size=40),
)


def read_with_footer_of(old: bytes, data: bytes) -> pa.Table:
    """What a reader gets that opened the file `old` for its footer, and its successor for the pages."""
    return pq.ParquetFile(pa.BufferReader(data), metadata=pq.read_metadata(io.BytesIO(old))).read()


@given(st.lists(tables, min_size=1, max_size=8))
def test_who_read_the_footer_of_any_version_finds_its_pages_in_all_that_follow(versions: list[pa.Table]) -> None:
    """Versions of any sizes, smaller and larger ones in turn."""
    files = [b""]
    for table in versions:
        files.append(table_bytes(table, files[-1]))
        for old, content in zip(files[1:], versions, strict=False):
            assert read_with_footer_of(old, files[-1]).equals(content)
        assert pq.read_table(io.BytesIO(files[-1])).equals(table)


def test_a_damaged_page_is_found() -> None:
    """By whatever file of ours is read so: a number that was changed on the disk is never taken for one."""
    table = pa.table({"a": [1 / 9, 1 / 7, 1 / 3]})
    good, number = table_bytes(table), struct.pack("<d", 1 / 7)
    assert read_table(good).equals(table)
    with pytest.raises(OSError, match="CRC"):
        read_table(good.replace(number, struct.pack("<d", 2 / 7)))


def test_what_nobody_can_be_reading_any_more_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file replaced now and then holds its predecessor's pages and no others."""
    table = pa.table({"a": range(1000)})
    one = table_bytes(table)
    two = table_bytes(table, one)
    monkeypatch.setattr(parquet, "KEPT_S", -1.0)
    assert len(table_bytes(table, two)) == len(one) < len(two)


def test_equal_content_leaves_the_file_alone(tmp_path: Path) -> None:
    """NaN is equal to itself, and another layout is no other content; other values, types or metadata are."""
    path = tmp_path / "table.parquet"
    table = pa.table({"a": [1.0, float("nan")], "b": ["x", "y"]}, metadata={"version": "1"})
    pq.write_table(table, path, compression="gzip", use_dictionary=False)
    for same in (table, pa.table(table.to_pydict(), metadata={"version": "1"})):
        before = (path.read_bytes(), path.stat().st_mtime_ns)
        write_table(path, same)
        assert (path.read_bytes(), path.stat().st_mtime_ns) == before
    others = (
        pa.table({"a": [1.0, 2.0], "b": ["x", "y"]}, metadata={"version": "1"}),
        table.replace_schema_metadata({"version": "2"}),
        table.cast(pa.schema([("a", "float32"), ("b", "string")], metadata={"version": "1"})),
    )
    for other in others:
        write_table(path, other)
        read = pq.read_table(path)
        assert (str(read.to_pydict()), read.schema) == (str(other.to_pydict()), other.schema)
        assert read.schema.metadata[b"version"] == other.schema.metadata[b"version"]


@pytest.mark.parametrize("before", [b"", b"PAR1", b"PAR1" * 9, os.urandom(500)])
def test_a_damaged_predecessor_is_none(before: bytes) -> None:
    """Nor is one without pages, or one that another program wrote."""
    table = pa.table({"a": [1]})
    assert table_bytes(table, before) == table_bytes(table)
    other = io.BytesIO()
    pq.write_table(table, other)
    assert table_bytes(table, other.getvalue()) == table_bytes(table)


@pytest.mark.slow
def test_pandas_reads_while_it_is_replaced(tmp_path: Path) -> None:
    """By the path, thousands of times: every time a whole version."""
    path, stop = tmp_path / "table.parquet", threading.Event()

    def write() -> None:
        rows = 1
        while not stop.is_set():
            write_table(path, pa.table({"a": [rows] * rows}))
            rows = rows % 300 + 1

    write_table(path, pa.table({"a": [1]}))
    thread = threading.Thread(target=write)
    thread.start()
    try:
        for _ in range(2000):
            read = pd.read_parquet(path)["a"]
            assert read.tolist() == [read[0]] * read[0]
    finally:
        stop.set()
        thread.join()
