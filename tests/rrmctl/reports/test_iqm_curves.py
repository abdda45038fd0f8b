import pickle

import numpy as np
import pandas as pd
import pytest
from scipy.stats import trim_mean

from rrmctl.reports.iqm_curves import ALL_TASKS, COLUMNS, CURVE_COLUMNS, curve_table, curves, iqm_table, write_curves
from rrmctl.reports.select import sections
from rrmctl.reports.statistics import Statistics
from rrmctl.store.layout import Layout
from tests.rrmctl.reports.frames import RISING, SATURATED, Sweep

QUICK = Statistics(replicates=300)


def table(sweep: Sweep, settings: Statistics = QUICK) -> pd.DataFrame:
    (section,) = sections(*sweep.frames())
    return iqm_table(section, settings)


def row(found: pd.DataFrame, method: str, task: str = "button-press") -> pd.Series:
    return found[(found["method"] == method) & (found["task"] == task)].iloc[0]


def test_a_method_is_read_at_the_common_step():
    """IQM, quartiles and counts of pebble are those of its five seeds at step 300."""
    pebble = row(table(Sweep()), "pebble")
    at_300 = [seed[2] for seed in RISING["pebble"]]
    assert (pebble["step"], pebble["step_rule"], pebble["n"], pebble["planned"]) == (300, "first", 5, 5)
    assert pebble["iqm"] == pytest.approx(trim_mean(at_300, 0.25))
    assert (pebble["q25"], pebble["q75"]) == tuple(np.quantile(at_300, [0.25, 0.75]))
    assert 0.0 <= pebble["low"] <= pebble["iqm"] <= pebble["high"] <= 0.7


def test_replicates_are_not_kept():
    """What a table and the file beside it share takes no more room for more resampled data sets."""
    (section,) = sections(*Sweep().frames())
    few, many = (len(pickle.dumps(curves(section, Statistics(replicates=each)))) for each in (100, 3000))
    assert abs(many - few) < 1000


def test_the_area_is_that_of_the_iqm_curve():
    """AUC is the mean height of the IQM curve, and its interval comes from whole resampled curves."""
    pebble = row(table(Sweep()), "pebble")
    curve = [trim_mean([seed[t] for seed in RISING["pebble"]], 0.25) for t in range(4)]
    assert pebble["auc"] == pytest.approx(np.trapezoid(curve, dx=1 / 3))
    assert pebble["auc_low"] <= pebble["auc"] <= pebble["auc_high"]


def test_the_kind_of_iqm_changes_the_estimate():
    """Five seeds: rliable averages the middle three, exact weighs the second and fourth by three quarters."""
    at_300 = sorted(seed[2] for seed in RISING["pebble"])
    exact = (0.75 * at_300[1] + at_300[2] + 0.75 * at_300[3]) / 2.5
    assert row(table(Sweep(), Statistics(kind="exact", replicates=300)), "pebble")["iqm"] == pytest.approx(exact)
    assert row(table(Sweep()), "pebble")["iqm"] != pytest.approx(exact)


def test_several_success_tasks_are_pooled():
    """The last rows pool seeds and tasks, each task at its own step, and leave DM-Control out."""
    found = table(Sweep(tasks=("button-press", "door-open", "walker-walk")))
    pooled = row(found, "pebble", ALL_TASKS)
    assert pooled["iqm"] == pytest.approx(trim_mean([seed[2] for seed in RISING["pebble"]] * 2, 0.25))
    assert (pooled["n"], pooled["planned"]) == (10, 10)
    assert pd.isna(pooled["step"])
    assert found["task"].iloc[-1] == ALL_TASKS


def test_tasks_with_schedules_of_their_own_are_pooled():
    """A task may have its own budget; with one schedule a task there is nothing to mix up."""
    frames = [Sweep().frames(), Sweep(tasks=("sweep-into",), feedback="50@5000/10000").frames()]
    rows, jobs = (pd.concat(pair, ignore_index=True) for pair in zip(*frames, strict=True))
    (section,) = sections(rows, jobs)
    pooled = row(iqm_table(section, QUICK), "rrm-proxy", ALL_TASKS)
    assert pooled["feedback"] == "each task's"
    assert pooled["teacher"] == "oracle"


def test_tasks_on_images_are_pooled_by_themselves():
    """Their agents and heuristics are others: no mean holds both kinds, and each kind keeps its own methods."""
    seen = {"pebble": RISING["oracle"], "rrm-penalty": RISING["rrm-proxy"]}
    sweeps = (Sweep(tasks=("button-press", "door-open")), Sweep(seen, ("button-press-image", "sweep-into-image")))
    frames = [sweep.frames() for sweep in sweeps]
    (section,) = sections(*(pd.concat(pair, ignore_index=True) for pair in zip(*frames, strict=True)))
    found = iqm_table(section, QUICK)
    states, images = (f"{ALL_TASKS} on {what}" for what in ("states", "images"))
    pooled = found[found["task"].str.startswith(ALL_TASKS)]
    assert list(zip(pooled["task"], pooled["method"], strict=True)) == [
        (states, "oracle"), (states, "pebble"), (states, "rrm-proxy"), (images, "pebble"), (images, "rrm-penalty")
    ]  # fmt: skip
    assert set(pooled["n"]) == {10}
    assert row(found, "pebble", states)["iqm"] < row(found, "pebble", images)["iqm"]


def test_a_method_missing_on_one_task_is_not_pooled():
    """A mean over fewer tasks than the others' is no comparison and does not appear."""
    keys = [("door-open", "pebble", seed) for seed in range(5)]
    found = table(Sweep(tasks=("button-press", "door-open"), states=dict.fromkeys(keys, "failed")))
    assert set(found["method"][found["task"] == ALL_TASKS]) == {"oracle", "rrm-proxy"}
    lost = row(found, "pebble", "door-open")
    assert (lost["n"], lost["planned"]) == (0, 5)
    assert np.isnan(lost["iqm"])


def test_returns_are_read_at_the_last_step():
    """DM-Control's scores are true returns at the final step."""
    pebble = row(table(Sweep(tasks=("walker-walk",))), "pebble", "walker-walk")
    assert (pebble["score"], pebble["step"], pebble["step_rule"]) == ("return", 400, "final")
    assert pebble["iqm"] == pytest.approx(trim_mean([1000 * seed[3] for seed in RISING["pebble"]], 0.25))


def test_saturated_scores_are_a_point():
    """All seeds at 100 % throughout: estimate, interval, quartiles and area are exactly one, at the first step."""
    found = table(Sweep(curves=SATURATED))
    assert (found[["iqm", "low", "high", "q25", "q75", "auc"]] == 1.0).all(axis=None)
    assert set(found["step"]) == {100}


@pytest.mark.parametrize("seeds", [1, 2])
def test_one_or_two_seeds_have_no_interval(seeds):
    """Below three seeds there is an estimate and no interval."""
    found = table(Sweep(curves={method: curve[:seeds] for method, curve in RISING.items()}))
    assert found[["low", "high", "auc_low", "auc_high"]].isna().all(axis=None)
    assert found["iqm"].notna().all()


def test_a_row_depends_on_its_own_runs_alone():
    """Adding a method changes nothing in the rows of the others, not even the last digit of their intervals."""
    alone = table(Sweep(curves={k: RISING[k] for k in ("oracle", "rrm-proxy")}))
    together = table(Sweep())
    pd.testing.assert_series_equal(row(alone, "oracle"), row(together, "oracle"), check_names=False)


def test_columns_are_as_documented():
    """The tables have the documented columns and no others."""
    (section,) = sections(*Sweep().frames())
    assert list(iqm_table(section, QUICK).columns) == [column.name for column in COLUMNS]
    assert list(curve_table(section, QUICK).columns) == list(CURVE_COLUMNS)


def test_curves_are_kept_as_parquet(tmp_path):
    """The aggregated file has one row per series and step, plain types, and NaN where there is no interval."""
    short = Sweep(curves=RISING | {"pebble": RISING["pebble"][:2]})
    (section,) = sections(*short.frames())
    write_curves(Layout(tmp_path), [section], QUICK)
    read = pd.read_parquet(tmp_path / "aggregates" / "main-results.parquet")
    assert len(read) == 3 * 4
    pebble = read[read["method"] == "pebble"]
    assert pebble["iqm"].tolist() == [np.mean([seed[t] for seed in RISING["pebble"][:2]]) for t in range(4)]
    assert pebble["low"].isna().all()
    assert set(read["iqm_kind"]) == {"rliable"}
    assert read["step"].dtype == np.int64
    assert [path.name for path in (tmp_path / "aggregates").iterdir()] == ["main-results.parquet"]
