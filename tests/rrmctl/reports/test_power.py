import numpy as np
import pandas as pd
import pytest
from scipy.stats import mannwhitneyu, trim_mean

from rrmctl.labels import Label
from rrmctl.reports.pairwise import against, decide, every_pair
from rrmctl.reports.render import to_text
from rrmctl.reports.select import sections
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables import kinds
from rrmctl.reports.tables.power import COLUMNS, make
from rrmctl.store.trials import Pairing, Trial
from tests.rrmctl.reports.frames import RISING, SATURATED, Sweep

QUICK = Statistics(replicates=300)
FEEDBACK = ("oracle", "50@5000/5000")


def section(**options):
    (found,) = sections(*Sweep(**options).frames())
    return found


def report(found):
    return make([found], QUICK)[0]


def row(found, method, against):
    table = found.table
    return table[(table["method"] == method) & (table["against"] == against)].iloc[0]


def areas(method, steps=4):
    return np.trapezoid(np.array(RISING[method])[:, :steps], axis=1) / (steps - 1)


def runs(level, count, seed):
    """Flat curves about a level."""
    return [[score] * 4 for score in np.random.default_rng(seed).normal(level, 0.05, count)]


def test_it_is_a_command():
    """The module is found, and its docstring is its help."""
    assert "how many more seeds would likely decide" in kinds()["power"].help


def test_every_pair_is_a_row_with_its_difference():
    """Interquartile means of the runs' areas, and how often a run of one beats one of the other."""
    found = report(section())
    assert list(found.table.columns) == [column.name for column in COLUMNS]
    assert list(zip(found.table["method"], found.table["against"], strict=True)) == [
        ("pebble", "oracle"), ("rrm-proxy", "oracle"), ("rrm-proxy", "pebble")
    ]  # fmt: skip
    each = row(found, "rrm-proxy", "pebble")
    ours, theirs = areas("rrm-proxy"), areas("pebble")
    assert each["difference"] == pytest.approx(trim_mean(ours, 0.25) - trim_mean(theirs, 0.25))
    assert each["improvement"] == pytest.approx(mannwhitneyu(ours, theirs, alternative="greater").statistic / 25)
    assert each["low"] < each["difference"] < each["high"]
    assert (each["n"], each["n_against"]) == (5, 5)


def test_five_seeds_are_open_and_have_an_outlook():
    """Clearly apart, but three comparisons share the level: five seeds cannot decide, ten likely do."""
    each = row(report(section()), "pebble", "oracle")
    assert (each["decision"], each["seeds"], each["more"]) == ("open", 5, 5)
    assert each["chance"] > 0.9


def test_ten_seeds_decide_what_is_apart():
    """Decided methods have no outlook, those that are alike have little of one."""
    curves = {"pebble": runs(0.3, 10, 1), "rrm-proxy": runs(0.8, 10, 2), "surf": runs(0.3, 10, 3)}
    found = report(section(curves=curves))
    apart, alike = row(found, "rrm-proxy", "pebble"), row(found, "surf", "pebble")
    assert (apart["decision"], apart["seeds"]) == ("better", 10)
    assert np.isnan(apart["chance"])
    assert (alike["decision"], alike["chance"] < 0.5) == ("open", True)
    assert "worse (10)" in to_text([found], "markdown")


@pytest.mark.parametrize("curves", [SATURATED, {name: curve[:2] for name, curve in RISING.items()}])
def test_saturated_and_few_runs_are_told_as_they_are(curves):
    """All seeds at 100 %: no width. Two seeds: no interval, no decision, no outlook."""
    found = report(section(curves=curves))
    each = row(found, "rrm-proxy", "pebble")
    text = to_text([found], "markdown")
    if curves is SATURATED:
        assert (each["difference"], each["low"], each["high"], each["improvement"]) == (0.0, 0.0, 0.0, 0.5)
        assert (each["decision"], each["chance"]) == ("open", 0.0)
    else:
        assert np.isnan(each["low"])
        assert (each["decision"], each["seeds"]) == ("open", 0)
        assert "n < 3" in text


def test_runs_under_way_are_not_looked_at():
    """Only what is done has a score over training."""
    states = {("button-press", "pebble", seed): "running" for seed in range(5)}
    found = report(section(states=states))
    assert set(found.table["method"]) | set(found.table["against"]) == {"oracle", "rrm-proxy"}


def test_a_missing_seed_holds_up_its_group():
    """Ten planned, the third of one method failed: what comes after it waits, so that no order is made up later."""
    curves = {"pebble": runs(0.3, 10, 1), "rrm-proxy": runs(0.8, 10, 2)}
    complete = row(report(section(curves=curves)), "rrm-proxy", "pebble")
    failed = {("button-press", "pebble", 2): "failed"}
    lacking = row(report(section(curves=curves, states=failed)), "rrm-proxy", "pebble")
    assert (complete["decision"], complete["seeds"]) == ("better", 5)
    assert (lacking["decision"], lacking["seeds"], lacking["n_against"]) == ("open", 0, 9)


def broken(curves):
    """A section in which the last seed of pebble was not a number at its second and third evaluation."""
    rows, jobs = Sweep(curves=curves).frames()
    last = rows["seed"] == len(curves["pebble"]) - 1
    rows.loc[last & (rows["method"] == "pebble") & rows["step"].isin([200, 300]), "success"] = np.nan
    (found,) = sections(rows, jobs)
    return found


def test_no_other_run_changes_a_runs_number():
    """A sixth seed that was not a number at two steps leaves the others' numbers alone and is named as not compared."""
    curves = RISING | {"pebble": [*RISING["pebble"], [0.1, 0.2, 0.3, 0.4]]}
    found = broken(curves)
    without, beside = decide(section(), None).all, decide(found, None).all
    for one, other in zip(without, beside, strict=True):
        np.testing.assert_array_equal(one.ours, other.ours)
        np.testing.assert_array_equal(one.theirs, other.theirs)
    made = report(found)
    (note,) = (note for note in made.notes if "is not compared" in note)
    assert "pebble (oracle, 50@5000/5000): run " in note
    assert "(seed 5) is not compared: success is not a number at 2 of its evaluations (first at step 200)" in note
    assert note in made.facts["problems"]


def test_a_run_without_a_number_holds_up_its_group():
    """As if it were missing: the seeds after it wait."""
    curves = {"rrm-proxy": runs(0.8, 5, 2), "pebble": runs(0.3, 5, 1)}
    (contest,) = decide(broken(curves), None).all
    assert (contest.verdict.looks, contest.theirs.size + contest.ours.size) == (0, 9)


def test_methods_evaluated_at_different_steps_are_compared():
    """A mean over training needs no step in common."""
    rows, jobs = Sweep().frames()
    rows["step"] += 50 * (rows["method"] == "pebble")
    (found,) = sections(rows, jobs)
    both = decide(found, None).all[-1]
    np.testing.assert_allclose(both.ours, areas("rrm-proxy"))
    np.testing.assert_allclose(both.theirs, areas("pebble"))


def test_a_trial_sets_the_rules():
    """Its pairs, its groups and its level; other pairs have no row, and the note about rules is gone."""
    curves = {"pebble": runs(0.3, 8, 1), "rrm-proxy": runs(0.8, 8, 2), "surf": runs(0.3, 8, 3)}
    (found,) = sections(*Sweep(curves=curves).frames())
    free = report(found)
    pair = Pairing("button-press", *FEEDBACK, "surf", "rrm-proxy")
    trial = Trial(group=4, looks=2, alpha=0.05, pairs=(pair,))
    contests = decide(found, trial)
    assert [(each.pair, each.verdict.decision, each.verdict.looks) for each in contests.all] == [(pair, "smaller", 2)]
    assert decide(found, trial, seeds=range(4)).all[0].verdict.decision == "open"
    assert any("No rules were fixed" in note for note in free.notes)


def test_pairs_of_a_task_with_two_teachers_are_two():
    """What asks nothing is compared under each of the teachers."""
    labels = [series.label for series in section().series]
    other = [label._replace(teacher="mistaken-10") for label in labels if label.teacher != "-"]
    found = every_pair([*labels, *other])
    assert len(found) == 6
    assert {(pair.teacher, pair.against) for pair in found if pair.method == "pebble"} == {
        ("oracle", "oracle"), ("mistaken-10", "oracle")
    }  # fmt: skip


def test_a_mean_over_training_has_no_last_evaluations():
    """What is compared is the mean over the whole training whatever is read elsewhere, and the note says so."""
    usual, other = (make([section()], Statistics(replicates=100, last=last))[0] for last in (1, 2))
    pd.testing.assert_frame_equal(usual.table, other.table)
    assert "Compared is the mean score over training, whatever --final says." in other.notes
    assert not any("Score at a step" in note for note in other.notes)


def test_what_asks_nothing_is_compared_once():
    """Two methods without a teacher are one pair of their task, however many teachers others have."""
    alone = [Label("button-press", name, "-", "-") for name in ("oracle", "sac-proxy")]
    taught = [Label("button-press", "pebble", teacher, "50@5000/5000") for teacher in ("oracle", "mistaken-10")]
    assert every_pair([*alone, *taught])[0] == Pairing("button-press", "-", "-", "sac-proxy", "oracle")
    assert len(every_pair([*alone, *taught])) == 5
    assert [pair[1] for pair in against([*alone, *taught], "oracle")] == ["-", "oracle", "mistaken-10"]


def test_another_teachers_missing_run_holds_up_nothing():
    """The group waits for the seeds of its own two methods, under their own teacher."""
    curves = {"pebble": runs(0.3, 6, 1), "surf": runs(0.9, 6, 3)}
    failed = {("button-press", "pebble", 0): "failed"}
    own, other = Sweep(curves=curves).frames(), Sweep(curves=curves, teacher="mistaken-10", states=failed).frames()
    (found,) = sections(*(pd.concat([a[a["seed"] > 0], b]) for a, b in zip(own, other, strict=True)))
    looks = {each.pair.teacher: each.verdict.looks for each in decide(found, None).all}
    assert looks == {"oracle": 1, "mistaken-10": 0}


@pytest.mark.parametrize("form", ["markdown", "csv", "latex", "json"])
def test_it_is_written_in_every_form(form):
    """The words that must stand beside it are there."""
    text = to_text([report(section())], form)
    assert "rrm-proxy" in text
    assert "open" in text
