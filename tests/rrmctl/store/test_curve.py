"""The curve on disk: whole after every row, and refused when damaged."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rrm.parquet import table_bytes
from rrm.types import EvalRow
from rrmctl.store.curve import SETTINGS, CurveWriter, decode, read_curve, table_of
from rrmctl.store.files import DamagedError, StorageError, VersionError
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.schema import IDENTITY, MEASURED, SCHEMA_VERSION, VERSION_KEY, curve_schema
from tests.rrmctl.running.standin import row

WHO = {"run": "0123456789abcdef", "cell": "c", "profile": "smoke", "task": "toy-car", "method": "oracle", "seed": 3}
PATH = Path("curve.parquet")

_KINDS = {"int": st.integers(0, 2**62), "float": st.floats()}
_FIELDS = [field for field in dataclasses.fields(EvalRow) if field.name != "figures"]
_FIGURES = st.dictionaries(st.sampled_from(["alpha", "critic_loss", "anything at all"]), st.floats())
rows = st.builds(EvalRow, figures=_FIGURES, **{field.name: _KINDS[str(field.type)] for field in _FIELDS})


def writer(tmp_path: Path) -> tuple[RunFolder, CurveWriter]:
    folder = Layout(tmp_path).run("0123456789abcdef")
    return folder, CurveWriter(folder, WHO)


def encoded(rows: Iterable[EvalRow]) -> bytes:
    return table_bytes(table_of([WHO | row.columns() for row in rows]), **SETTINGS)


def measured(row: Mapping[str, float]) -> dict[str, object]:
    """NaN as a word, so that equal rows compare equal; a figure that is NaN is as one that is not there."""
    told = {k: "NaN" if isinstance(v, float) and math.isnan(v) else v for k, v in row.items()}
    return {k: v for k, v in told.items() if k in MEASURED or v != "NaN"}


def test_the_columns_are_the_identity_and_every_field_of_an_evaluation() -> None:
    """The schema names each field of EvalRow once, in its order, with its type."""
    kinds = {"int": "int64", "float": "float64"}
    assert {f.name: kinds[str(f.type)] for f in _FIELDS} == MEASURED
    assert [*IDENTITY, *MEASURED] == curve_schema().names


@settings(max_examples=50, deadline=None)
@given(st.lists(rows, max_size=5))
def test_rows_come_back_as_they_were_written(given: list[EvalRow]) -> None:
    """Any values, NaN and infinities among them, survive the file bit for bit."""
    table = decode(encoded(given), PATH)
    back = table.drop_columns(list(IDENTITY)).to_pylist()
    assert [measured(row.columns()) for row in given] == list(map(measured, back))


def test_every_row_is_on_disk_when_add_returns(tmp_path: Path) -> None:
    """Plain pandas reads the file after each row, in order of steps, with a repeated step replaced."""
    folder, curve = writer(tmp_path)
    for step in (10, 30, 20, 30):
        curve.add(row(step, seed=3, success=step / 100).columns())
        assert step in pd.read_parquet(folder.curve)["step"].tolist()
    frame = pd.read_parquet(folder.curve)
    assert frame["step"].tolist() == [10, 20, 30]
    assert frame["success"].tolist() == [0.1, 0.2, 0.3]
    assert frame["method"].unique().tolist() == ["oracle"]
    assert [path.name for path in folder.path.iterdir()] == ["curve.parquet"]


def test_a_second_writer_goes_on_with_the_first_one_s_rows(tmp_path: Path) -> None:
    """Opening a curve again keeps what it holds."""
    _, first = writer(tmp_path)
    first.add(row(10).columns())
    folder, second = writer(tmp_path)
    second.add(row(20).columns())
    assert len(second) == 2
    assert second.last_step == 20
    assert pd.read_parquet(folder.curve)["step"].tolist() == [10, 20]


def test_a_file_cut_short_anywhere_is_refused_by_name() -> None:
    """Whatever the length that is left, reading says which file is damaged."""
    data = encoded([row(10), row(20)])
    for length in range(0, len(data), 97):
        with pytest.raises(DamagedError, match=r"curve\.parquet is damaged"):
            decode(data[:length], PATH)


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_a_flipped_bit_is_refused_or_changes_no_value(data: st.DataObject) -> None:
    """No single flipped bit yields other values: it is refused, or sits where it means nothing."""
    good = encoded([row(10), row(20)])
    at = data.draw(st.integers(0, len(good) - 1))
    flipped = bytearray(good)
    flipped[at] ^= 1 << data.draw(st.integers(0, 7))
    try:
        table = decode(bytes(flipped), PATH)
    except (DamagedError, VersionError):
        return
    assert str(decode(good, PATH).to_pylist()) == str(table.to_pylist())


def test_a_damaged_curve_is_named_and_left_alone(tmp_path: Path) -> None:
    """Whoever writes decides what becomes of the bytes."""
    folder, curve = writer(tmp_path)
    curve.add(row(10).columns())
    torn = folder.curve.read_bytes()[:100]
    folder.curve.write_bytes(torn)
    with pytest.raises(DamagedError, match=r"curve\.parquet is damaged"):
        writer(tmp_path)
    assert torn == folder.curve.read_bytes()


def test_another_schema_version_is_refused_with_its_number(tmp_path: Path) -> None:
    """A file of a later version is not read as one of this version."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    folder = Layout(tmp_path).run("0123456789abcdef")
    folder.path.mkdir(parents=True)
    table = pa.Table.from_pylist([], schema=curve_schema()).replace_schema_metadata({VERSION_KEY: b"99"})
    pq.write_table(table, folder.curve)
    with pytest.raises(VersionError, match=f"schema version 99, this program reads {SCHEMA_VERSION}"):
        read_curve(folder)


def test_a_curve_that_cannot_be_read_now_is_not_damaged(tmp_path: Path) -> None:
    """Nothing is known of it: nobody may set it aside and train it again."""
    folder = Layout(tmp_path).run("0123456789abcdef")
    folder.curve.mkdir(parents=True)
    with pytest.raises(StorageError, match=r"curve\.parquet cannot be read now: not a regular file"):
        writer(tmp_path)
