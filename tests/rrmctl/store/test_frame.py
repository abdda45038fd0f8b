"""DataFrames for people: columns have their types, whatever rows there are."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from rrmctl.export.bundle import Bundle, read
from rrmctl.reports import run_facts
from rrmctl.reports.dataframes import report_table as report
from rrmctl.reports.iqm_curves import curve_table, iqm_table
from rrmctl.reports.select import read_sections
from rrmctl.reports.tables import kinds
from rrmctl.store import load, load_gradients, planned
from rrmctl.store.snapshot import Snapshot, table
from tests.rrmctl.reports.frames import FIGURES, Sweep

WHOLE = {"seed", "attempt", "steps", "episodes", "runs", "done", "evaluations", "n", "planned"}


def frames(root: Path) -> Iterator[tuple[str, pd.DataFrame]]:
    """Everything that the library hands out as a frame, with rows and without."""
    runs = Snapshot(root, "main-results").runs()
    (section,) = read_sections(root, "main-results")
    yield "load", load(root)
    yield "load of one experiment", load(root, "main-results")
    yield "planned", planned(root)
    yield "needed, of which there are none", planned(root, needed=True)
    yield "gradients, of which there are none", load_gradients(root, [runs[0].id])
    yield "evaluations", read(root, "main-results").evaluations()
    yield "evaluations of nothing", Bundle("main-results", ()).evaluations()
    yield from (("curves", curve_table(section)), ("iqm", iqm_table(section)))
    counted: tuple[Callable[..., pd.DataFrame], ...] = (
        table, run_facts.spending, run_facts.common_settings, run_facts.differing_settings, run_facts.makings,
    )  # fmt: skip
    for each in counted:
        yield each.__name__, each(runs)
        yield f"{each.__name__} of nothing", each(())
    for name in set(kinds()) - {"less-feedback", "noisy-teacher", "sim-to-real", "human"}:
        yield name, report(name, root, "main-results")


@pytest.mark.slow
def test_columns_have_their_types(tmp_path: Path) -> None:
    """Text is `str`, what is counted whole, and nothing is left as Python's objects."""
    Sweep(states={("button-press", "pebble", 1): "failed"}).write(tmp_path)
    for name, frame in frames(tmp_path):
        for column, kind in frame.dtypes.items():
            assert not pd.api.types.is_object_dtype(kind), (name, column)
            if column in WHOLE:
                assert pd.api.types.is_integer_dtype(kind), (name, column)
    rows = load(tmp_path)
    assert not np.isnan(rows.seed).any()
    assert rows.dtypes["method"] == planned(tmp_path).dtypes["error"] == pd.StringDtype(na_value=np.nan)
    assert (rows.method == "pebble").to_numpy().dtype == bool


def test_a_store_without_an_evaluation_has_the_same_columns(tmp_path: Path) -> None:
    """And the same types as one with, but for the figures, which nothing has told yet."""
    Sweep().write(tmp_path / "full")
    nothing = {("button-press", method, seed): 0 for method in ("oracle", "pebble", "rrm-proxy") for seed in range(5)}
    Sweep(lengths=nothing, states=dict.fromkeys(nothing, "queued")).write(tmp_path / "empty")
    empty = load(tmp_path / "empty")
    assert empty.empty
    full = load(tmp_path / "full").drop(columns=list(FIGURES))
    pd.testing.assert_series_equal(empty.dtypes, full.dtypes)


@pytest.mark.parametrize("given", ["~/ref", Path("~/ref")])
def test_a_home_folder_is_understood(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: str | Path) -> None:
    """By every function that takes a results folder."""
    monkeypatch.setenv("HOME", str(tmp_path))
    Sweep().write(tmp_path / "ref")
    runs = Snapshot(given, "main-results").runs()
    assert len(load(given)) == len(read(given, "main-results").evaluations()) == 60
    assert len(planned(given)) == len(runs) == 15
    assert len(read_sections(given)) == 1
    assert len(report("final", given)) == 3
    assert load_gradients(given, [runs[0].id]).empty
