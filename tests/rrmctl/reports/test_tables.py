import io
import json
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.stats import trim_mean

from rrmctl.errors import UserError
from rrmctl.reports import published
from rrmctl.reports.iqm_curves import ALL_TASKS
from rrmctl.reports.render import FORMATS, to_text
from rrmctl.reports.report import NoDataError
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables import all as everything
from rrmctl.reports.tables import claims, final, iqm, less_feedback, noisy_teacher, sim_to_real
from tests.rrmctl.reports.stores import FULL, at_the_rig, curve, deployed, frames, section

QUICK = Statistics(replicates=300)
STEPS = [100_000, 200_000, 300_000, 400_000, 500_000]
TEACHERS = {
    "stochastic": ("pebble", "rrm-proxy", "rrm-language", "rrm-imitation"),
    "mistaken-10": ("mrn", "rrm-mrn-proxy", "rrm-mrn-language", "rrm-mrn-imitation"),
    "mistaken-15": ("mrn", "rrm-mrn-proxy", "rrm-mrn-language", "rrm-mrn-imitation"),
}


OWN = "10@5000/100"


def noisy(profile="paper"):
    """The manifest's series: three evaluations under the stochastic teacher, five and two budgets elsewhere."""
    series = {("button-press", "oracle", "-", "-"): curve(0.1, 0.5, 0.7, 0.9, 1.0)}
    for teacher, methods in TEACHERS.items():
        length, schedules = (3, (FULL,)) if teacher == "stochastic" else (5, (FULL, OWN))
        for rank, method in enumerate(methods):
            for feedback in schedules:
                end = 0.3 + 0.2 * rank - (0.1 + 0.05 * (teacher == "mistaken-15") if feedback == OWN else 0)
                series["button-press", method, teacher, feedback] = curve(*np.linspace(0, end, length), spread=0.1)
    return section("noisy-teacher", series, steps=STEPS, profile=profile)


def table_of(kind, found, settings):
    (report,) = kind.make([found], settings)
    return report.table


def row(table, **wanted):
    found = table
    for name, value in wanted.items():
        found = found[found[name] == value]
    (only,) = found.to_dict("records")
    return only


def test_every_published_value_is_in_a_row_of_its_own():
    """Fifteen published values stand beside ours, those under mistaken teachers beside either budget's; the difference
    is ours less theirs.
    """
    table = table_of(noisy_teacher, noisy(), QUICK)
    assert table.groupby("feedback").size().to_dict() == {FULL: 15, OWN: 10}
    assert table["published"].notna().all()
    np.testing.assert_allclose(table["difference"], table["iqm"] - table["published"])
    for feedback in (FULL, OWN):
        proxy = row(table, teacher="mistaken-10", method="rrm-mrn-proxy", feedback=feedback)
        assert (proxy["published"], proxy["published_half"]) == (pytest.approx(0.988), pytest.approx(0.104))


def test_the_oracle_is_read_where_the_stochastic_runs_end():
    """The oracle's run of 500,000 steps is read at 300,000 for the stochastic column, at its end for the others."""
    table = table_of(noisy_teacher, noisy(), QUICK)
    oracles = [row(table, teacher=t, method="oracle", feedback=FULL) for t in TEACHERS]
    assert [each["step"] for each in oracles] == [300_000, 500_000, 500_000]
    assert [each["iqm"] for each in oracles] == [pytest.approx(0.7), 1.0, 1.0]


def test_intervals_are_brackets_unless_the_papers_form_is_asked_for():
    """Ours are [low, high] by default; with ± a teacher is a column, and half the interval stands behind the sign."""
    (listed,) = noisy_teacher.make([noisy()], QUICK)
    assert listed.grid.header[-3:] == ("n", "Paper", "Difference")
    assert not any("±" in cell for cells in listed.grid.rows for cell in cells[:-2])
    (matrix,) = noisy_teacher.make([noisy()], Statistics(replicates=300, plus_minus=True))
    assert matrix.grid.header == (
        "Feedback", "Method", "stochastic", "paper", "mistaken-10", "paper", "mistaken-15", "paper", "n"
    )  # fmt: skip
    names = ["oracle", "baseline", "rrm-proxy", "rrm-language", "rrm-imitation"]
    assert [cells[:2] for cells in matrix.grid.rows] == [(feedback, name) for feedback in (FULL, OWN) for name in names]
    wanted = row(listed.table, teacher="stochastic", method="pebble")
    half = 50 * (wanted["high"] - wanted["low"])
    assert matrix.grid.rows[1][2:4] == (f"{100 * wanted['iqm']:.1f} ± {half:.1f}", "71.8 ± 5.3")
    assert all(cells[-1] == "5/5" for cells in matrix.grid.rows)


PAPERS_FORM = Statistics(replicates=300, plus_minus=True)


def test_the_papers_form_drops_no_method():
    """Where several methods would share a row of the paper's, each has a row under its own name."""
    names = ("pebble", "surf", "mrn", "rrm-proxy", "rrm-mrn-proxy")
    series = {("door-open", name, "mistaken-10", FULL): curve(0.1 * at) for at, name in enumerate(names)}
    (matrix,) = noisy_teacher.make([section("noisy-teacher", series, steps=[100])], PAPERS_FORM)
    assert [cells[0] for cells in matrix.grid.rows] == list(names)
    assert [cells[1].partition(" ")[0] for cells in matrix.grid.rows] == ["0.0", "10.0", "20.0", "30.0", "40.0"]


def test_schedules_of_a_teacher_are_told_apart():
    """A teacher who is asked under two schedules has rows for each, in either form, and the schedule is named."""
    levels = {FULL: 0.6, "5@5000/500": 0.2}
    series = {("door-open", "pebble", "stochastic", asked): curve(level) for asked, level in levels.items()}
    found = section("noisy-teacher", series, steps=[100])
    (matrix,), (listed,) = (noisy_teacher.make([found], settings) for settings in (PAPERS_FORM, QUICK))
    assert matrix.grid.header == ("Feedback", "Method", "stochastic", "paper", "n")
    asked = [(name, "baseline", f"{100 * level:.1f} ± 0.0", "–", "5/5") for name, level in levels.items()]
    assert list(matrix.grid.rows) == asked
    assert listed.grid.header[:3] == ("Teacher", "Feedback", "Method")
    assert [cells[1] for cells in listed.grid.rows] == list(levels)


def test_the_step_of_every_task_is_told():
    """Two tasks whose runs end apart under one teacher are both named with the step at which they are read."""
    labels = [(task, "pebble", "stochastic", FULL) for task in ("door-open", "button-press")]
    steps = {label: [100 * (at + 1)] for at, label in enumerate(labels)}
    (report,) = noisy_teacher.make([section("noisy-teacher", dict.fromkeys(labels, curve(0.5)), steps=steps)], QUICK)
    assert "Read at the last common step: door-open stochastic at 100, button-press stochastic at 200." in report.notes


@pytest.mark.slow
def test_the_best_method_but_the_oracle_is_bold():
    """Under each teacher the highest value of a method other than the oracle is marked, in both forms."""
    (listed,) = noisy_teacher.make([noisy()], QUICK)
    bold = {listed.grid.rows[at][2] for at, _ in listed.grid.best}
    assert bold == {"rrm-imitation", "rrm-mrn-imitation"}
    assert len(listed.grid.best) == 5
    (matrix,) = noisy_teacher.make([noisy()], Statistics(replicates=300, plus_minus=True))
    assert matrix.grid.best == {(4, 2), (4, 4), (4, 6), (9, 4), (9, 6)}


@pytest.mark.parametrize("kind", [iqm, final])
def test_a_variant_of_the_oracle_is_never_bold(kind):
    """oracle-bfloat16 knows the true reward as well: the best of those that do not is marked."""
    ends = {"oracle": 1.0, "oracle-bfloat16": 1.0, "pebble": 0.4, "pebble-bfloat16": 0.3}
    asked = {name: ("-", "-") if name.startswith("oracle") else ("oracle", FULL) for name in ends}
    series = {("button-press", name, *asked[name]): curve(0.1, end) for name, end in ends.items()}
    (report,) = kind.make([section("precision", series, steps=[100, 200])], QUICK)
    at = report.grid.header.index("Method")
    assert [report.grid.rows[row][at] for row, _ in report.grid.best] == ["pebble"]


def test_other_experiments_have_no_table_of_teachers_who_err():
    """Where nobody errs, the message says which experiment is meant."""
    plain = section("main-results", {("button-press", "pebble", "oracle", FULL): curve(1.0)}, steps=[100])
    with pytest.raises(NoDataError, match="no runs under a teacher who errs"):
        noisy_teacher.make([plain], QUICK)


def test_the_last_step_is_read_with_its_interval():
    """`final` is the IQM of the last step, with the quartiles of the seeds."""
    values = curve(0.0, 0.5, spread=0.3, seeds=8)
    table = table_of(final, section("toy", {("toy-car", "pebble", "oracle", FULL): values}, steps=[100, 200]), QUICK)
    found = row(table, method="pebble")
    assert (found["step"], found["n"], found["iqm"]) == (200, 8, pytest.approx(trim_mean(values[:, 1], 0.25)))
    assert found["low"] < found["q25"] + 0.1 < found["iqm"] < found["high"]


def little(tasks=("button-press", "door-open"), methods=("pebble", "rrm-proxy"), schedules=(FULL, "5@5000/500")):
    series = {}
    for t, task in enumerate(tasks):
        for m, method in enumerate(methods):
            for f, feedback in enumerate(schedules):
                series[task, method, "oracle", feedback] = curve(0.1 * t, 0.5 + 0.2 * m - 0.3 * f, 0.8, spread=0.1)
    return section("less-feedback", series, steps=[100, 200, 300])


def test_a_budget_is_the_mean_of_the_iqm_over_the_evaluations():
    """Each point is the mean over the evaluation steps of the IQM over seeds, beside it the IQM at the last one. All
    tasks together are their mean.
    """
    found = little()
    table = table_of(less_feedback, found, QUICK)
    one = row(table, task="door-open", method="pebble", feedback="5@5000/500")
    values = next(s for s in found.series if s.label[:2] == ("door-open", "pebble") and "5@5000/500" in s.label).values
    assert one["mean_iqm"] == pytest.approx(trim_mean(values, 0.25, axis=0).mean())
    assert one["final_iqm"] == pytest.approx(trim_mean(values[:, -1], 0.25))
    assert (one["evaluations"], one["first_step"], one["last_step"], one["n"]) == (3, 100, 300, 5)
    each = table[(table["method"] == "pebble") & (table["feedback"] == "5@5000/500")]
    pooled = each[each["task"] == less_feedback.EVERY_TASK].iloc[0]
    for name, ends in (("mean_iqm", ""), ("final_iqm", "final_")):
        assert pooled[name] == pytest.approx(each[each["task"] != less_feedback.EVERY_TASK][name].mean())
        assert pooled[f"{ends}low"] < pooled[name] < pooled[f"{ends}high"]
    assert pooled["n"] == 10


def test_few_seeds_of_each_task_are_said_to_be_few():
    """Three tasks of two seeds are six runs and no interval: what is few is a task's seeds, not the six."""
    names = ("button-press", "door-open", "door-unlock")
    series = {(t, "pebble", "oracle", asked): curve(0.5, seeds=2) for t in names for asked in (FULL, "5@5000/500")}
    (little_,) = less_feedback.make([section("less-feedback", series, steps=[100])], QUICK)
    assert little_.grid.rows[0][3:] == little_.grid.rows[1][3:] == ("50.0 % n < 3 on a task", "6/6")
    assert little_.grid.rows[4][3:] == ("50.0 % n < 3", "2/2")
    full = {label: values for label, values in series.items() if label[3] == FULL}
    (pooled,) = iqm.make([section("main-results", full, steps=[100])], QUICK)
    assert pooled.grid.rows[-1][0] == ALL_TASKS
    assert "n < 3 on a task" in pooled.grid.rows[-1]


@pytest.mark.parametrize("steps", [[100], [100, 200]])
def test_tasks_are_averaged_however_many_evaluations_they_share(steps):
    """Three tasks at 100 % and one at 0 % are 75 %, also where one evaluation is all that they have."""
    series = {
        (task, "pebble", "oracle", feedback): curve(*[float(at < 3)] * len(steps), seeds=10)
        for at, task in enumerate(("button-press", "door-open", "door-unlock", "window-open"))
        for feedback in (FULL, "5@5000/500")
    }
    table = table_of(less_feedback, section("less-feedback", series, steps=steps), QUICK)
    assert table[table["task"] == less_feedback.EVERY_TASK]["mean_iqm"].tolist() == [0.75, 0.75]


def test_the_mean_over_tasks_is_surer_than_one_task():
    """Its interval comes from resampling every task on its own, so that independent deviations even out."""
    table = table_of(less_feedback, little(), Statistics(replicates=2000))
    width = (table["high"] - table["low"]).groupby(table["task"] == less_feedback.EVERY_TASK).mean()
    assert 0.55 < width[True] / width[False] < 0.85  # the square root of a half, were they normal


def test_budgets_are_rows_and_methods_columns():
    """The grid has a column for each method, a row for the mean over steps and one for the last, the best of a row in
    bold (both where they are level), and n.
    """
    (report,) = less_feedback.make([little()], QUICK)
    assert report.grid.header == ("Task", "Feedback", "IQM", "pebble", "rrm-proxy", "n")
    assert [cells[2] for cells in report.grid.rows] == ["over steps", "last step"] * 6
    means, lasts = ({(at, 4) for at in range(start, 12, 2)} for start in (0, 1))
    assert report.grid.best == means | lasts | {(at, 3) for at, _ in lasts}
    assert report.grid.rows[0][-1] == "10/10"


def test_a_task_without_a_second_schedule_is_left_out():
    """Only tasks asked about by several schedules are in the table; without any there is none."""
    with pytest.raises(NoDataError, match="several schedules"):
        less_feedback.make([little(schedules=(FULL,))], QUICK)


def test_checkpoints_stand_beside_the_physical_robots():
    """Each task and method has three checkpoints with success and return, all published; of success the difference."""
    table = table_of(sim_to_real, deployed(), QUICK)
    assert len(table) == 6 * 3 * 2
    assert table["published"].notna().all()
    push = row(table, task="panda-push", method="rrm-h2o", paper_step=600_000, score="return")
    assert (push["step"], push["published"], push["episodes"]) == (600_000, -16.8, 20)
    assert np.isnan(push["difference"])  # other units
    reach = row(table, task="panda-reach", method="pebble", paper_step=50_000, score="success")
    assert reach["iqm"] == pytest.approx(0.1 - 0.1, abs=0.02)  # of the first deployment
    assert reach["difference"] == pytest.approx(reach["iqm"] - reach["published"])
    assert reach["simulation"] == pytest.approx(0.1 + 0.5 * 2 / 9)  # of the evaluation at 45,000, the last before it


def test_shorter_profiles_are_deployed_at_the_same_share():
    """A training of a fifth of the length is deployed at a fifth of the steps, and they are told apart."""
    (report,) = sim_to_real.make([deployed(profile="laptop")], QUICK)
    push = report.table[report.table["task"] == "panda-push"]
    assert set(push["step"]) == {80_000, 120_000, 160_000}
    assert push["n"].eq(5).all()
    assert "80,000 (400,000)" in {cells[1] for cells in report.grid.rows}


def test_checkpoints_that_are_not_deployed_are_left_open():
    """Deployments under way give those that they have passed, with n 0 for the others; of a shorter training under way
    nobody knows yet which steps they are.
    """
    table = table_of(sim_to_real, deployed(played=(1,)), QUICK)
    push = table[(table["task"] == "panda-push") & (table["score"] == "success") & (table["method"] == "pebble")]
    assert list(push["n"]) == [5, 0, 0]
    assert push["iqm"].isna().tolist() == [False, True, True]
    nothing = section(
        "sim-to-real", {("panda-push", "pebble", "oracle", FULL): curve(0.5, 0.6)}, steps=[400_000, 10**6]
    )
    (report,) = sim_to_real.make([nothing], QUICK)
    assert report.table.query("score == 'success'")["simulation"].tolist() == [0.5, 0.5, 0.5]
    assert any("Nothing was deployed yet" in note for note in report.notes)


def test_a_checkpoint_of_ones_own_is_a_row():
    """What the paper did not deploy has no value of its."""
    label, rig = (("panda-push", name, "oracle", FULL) for name in ("pebble", "pebble deployed"))
    after = frames("sim-to-real", {rig: at_the_rig(curve(0.7))}, steps=[500_000])
    found = section("sim-to-real", {label: curve(0.5, 0.6)}, steps=[500_000, 10**6], deployments=after)
    own = row(table_of(sim_to_real, found, QUICK), step=500_000, score="success")
    assert (own["iqm"], own["simulation"]) == (pytest.approx(0.7), pytest.approx(0.5))
    assert math.isnan(own["published"])


def test_what_happened_at_the_rig_is_said():
    """Episodes in which the cube was lost from sight."""
    (report,) = sim_to_real.make([deployed(lost=1)], QUICK)
    said = "Of 1800 episodes 90 ended without success because the cube was lost from sight: panda-reach pebble 15, "
    assert any(note.startswith(said) for note in report.notes)


def test_deployments_that_are_missing_are_named_and_the_simulation_is_of_the_same_seeds():
    """A seed that failed at the rig is said, with its state, and is in neither of the two numbers of a row."""
    label, rig = (("panda-push", name, "oracle", FULL) for name in ("pebble", "pebble deployed"))
    values = np.array([[0.0, 0.0], [0.2, 1.0], [0.4, 1.0], [0.6, 1.0]])
    states = {("pebble deployed", 0): "failed", ("pebble deployed", 3): "queued"}
    after = frames("sim-to-real", {rig: at_the_rig(curve(0.5, seeds=4))}, steps=[600_000], states=states)
    found = section("sim-to-real", {label: values}, steps=[600_000, 10**6], deployments=after)
    (report,) = sim_to_real.make([found], QUICK)
    own = row(report.table, paper_step=600_000, score="success")
    assert (own["n"], own["planned"], own["simulation"]) == (2, 4, pytest.approx(0.3))
    assert row(report.table, paper_step=800_000, score="success")["simulation"] == pytest.approx(0.3)
    assert "2 of 4 planned deployments." in report.notes
    gone = [note for note in report.notes if "pebble deployed" in note and note.startswith("Not contained")]
    assert [note.split(":")[0] for note in gone] == ["Not contained, failed", "Not contained, queued"]
    assert gone[0].endswith("seed 0.")


def test_evaluations_that_are_not_a_number_are_passed_over():
    """A checkpoint is read at the evaluation before; runs without any number leave theirs open, in every profile."""
    label, whole = ("panda-push", "pebble", "oracle", FULL), [200_000 * (at + 1) for at in range(5)]
    values = curve(0.1, 0.2, 0.3, 0.4, 0.5)
    values[0, 2] = np.nan
    steps = [each // 5 for each in whole]
    found = section("sim-to-real", {label: {"success": values, "true_return": values}}, steps=steps, profile="laptop")
    read = table_of(sim_to_real, found, QUICK).query("score == 'success'")["simulation"]
    assert read.tolist() == pytest.approx([0.2, 0.2, 0.4])
    for profile in ("laptop", "paper"):
        nothing = section("sim-to-real", {label: np.full((5, 5), np.nan)}, steps=whole, profile=profile)
        assert table_of(sim_to_real, nothing, QUICK)["simulation"].isna().all()


def test_the_robots_grid_has_both_scores():
    """Success and return stand beside one another with the simulation's, the paper's and the difference; n is in every
    row, and the title says where it was.
    """
    (report,) = sim_to_real.make([deployed()], QUICK)
    assert report.title.endswith("simulated rig")
    assert report.grid.header[3:] == (
        "Success", "Success, 95 %", "Success, sim", "Success, paper",
        "Return", "Return, 95 %", "Return, sim", "Return, paper", "n",
    )  # fmt: skip
    assert len(report.grid.rows) == 18
    assert [cells[:3] for cells in report.grid.rows[:2]] == [
        ("panda-reach", "50,000", "pebble"),
        ("panda-reach", "50,000", "rrm-1d"),
    ]
    assert {report.grid.rows[line][2] for line, _ in report.grid.best} >= {"rrm-1d", "rrm-h2o"}


def test_the_robots_oracle_is_not_bold():
    """A policy trained on the true reward stands in the table, outside of the comparison."""
    names = [("oracle", "-", "-"), ("pebble", "oracle", FULL)]
    series = {("panda-push", *name): curve(0.5, 1.0 - 0.5 * at) for at, name in enumerate(names)}
    after = {
        ("panda-push", f"{name[0]} deployed", *name[1:]): at_the_rig(curve(0.9 - 0.5 * at))
        for at, name in enumerate(names)
    }
    found = section(
        "sim-to-real", series, steps=[600_000, 1_000_000], deployments=frames("sim-to-real", after, steps=[600_000])
    )
    (report,) = sim_to_real.make([found], QUICK)
    assert {report.grid.rows[line][2] for line, _ in report.grid.best} == {"pebble"}


def test_a_store_without_the_robot_says_so():
    """Without runs of the robot's tasks there is no table, and the message names them."""
    plain = section("main-results", {("button-press", "pebble", "oracle", FULL): curve(1.0)}, steps=[100])
    with pytest.raises(NoDataError, match="panda-reach"):
        sim_to_real.make([plain], QUICK)


def test_published_values_are_percentages_and_complete():
    """Every success is a percentage, each robot task has three checkpoints for two methods, and sources are named."""
    told = tomllib.loads(published.PATH.read_text())
    assert {told[name]["source"] for name in told} == {"Tab. wrongiqm1", "Tab. realiqm"}
    for methods in told["noisy-teacher"]["button-press"].values():
        assert all(0 <= value <= 100 and half > 0 for value, half in methods.values())
        assert len(methods) == 5
    for task in published.deployed_tasks():
        methods = {name: value for name, value in told["sim-to-real"][task].items() if isinstance(value, dict)}
        assert len(methods) == 2
        assert all(len(each["success"]) == len(each["return"]) == 3 for each in methods.values())


def test_nothing_of_ours_comes_from_the_paper(monkeypatch):
    """Without the published values every number of ours is the same."""
    before = table_of(noisy_teacher, noisy(), QUICK)
    monkeypatch.setattr(published, "final", lambda *_: (math.nan, math.nan))
    after = table_of(noisy_teacher, noisy(), QUICK)
    assert after["published"].isna().all()
    ours = ["teacher", "method", "step", "iqm", "low", "high", "n"]
    pd.testing.assert_frame_equal(before[ours], after[ours])


@pytest.mark.slow
def test_everything_at_once_leaves_out_what_there_is_no_data_for():
    """`all` holds every table of the data and names each one's kind; tables of other data are left out."""
    made = everything.make([noisy(), little()], QUICK)
    kinds = [report.facts["table"] for report in made]
    assert set(kinds) == {"claims", "final", "iqm", "less-feedback", "noisy-teacher", "power"}
    assert kinds.count("noisy-teacher") == 1


@pytest.mark.slow
def test_the_docs_name_every_fact():
    """What stands beside the rows of csv and json is in docs/reports.md, between backticks."""
    text = (Path(__file__).parents[3] / "docs" / "reports.md").read_text(encoding="utf-8")
    named = set(re.findall(r"\w+", " ".join(re.findall(r"`([^`\n]*)`", text.replace("\n", " ")))))
    settings = Statistics(replicates=300, last=2)
    told = {fact for report in everything.make([noisy(), little()], settings) for fact in report.facts}
    assert told - named == set()


def test_a_section_that_cannot_be_compared_keeps_no_other_back():
    """Methods without a common step cost their own table, which says why, and nothing else."""
    labels = [("button-press", name, "oracle", FULL) for name in ("pebble", "rrm-proxy")]
    apart = section(
        "other", dict.fromkeys(labels, curve(0.1, 0.2)), steps=dict(zip(labels, ([1, 2], [3, 4]), strict=True))
    )
    with pytest.raises(UserError, match="no evaluation step is common"):
        final.make([apart, little()], QUICK)
    made = [report for report in everything.make([apart, little()], QUICK) if report.facts["table"] == "final"]
    assert "no evaluation step is common" in made[0].notes[0]
    assert len(made[1].table) == 8
    for form in FORMATS:
        assert "no evaluation step is common" in " ".join(to_text(made, form).split()), form
    assert "|  |" not in to_text(made, "markdown")
    rows = pd.read_csv(io.StringIO(to_text(made, "csv")))
    assert len(rows) == 9
    assert rows["problems"].str.contains("no evaluation step is common").sum() == 1


VALUES = np.array([[0.0, 0.2, 0.4, 0.9], [0.1, 0.5, 0.3, 1.0], [0.0, 0.4, 0.5, 0.6], [0.2, 0.2, 0.8, 0.7]])


@pytest.mark.parametrize("last", [1, 2, 3, 9])
def test_a_score_at_a_step_can_be_of_several_evaluations(last):
    """In every table that reads a step a run's score there is the mean of its last evaluations, or of those there are;
    areas, means over steps and the step itself stay as they are.
    """
    label, steps = ("button-press", "pebble", "stochastic", FULL), [100, 200, 300, 400]
    plain = section("noisy-teacher", {label: VALUES}, steps=steps)
    schedules = {("button-press", "pebble", "oracle", asked): VALUES for asked in (FULL, OWN)}
    sparing = section("less-feedback", schedules, steps=steps)
    ours = {("panda-push", "pebble", "oracle", FULL): VALUES}
    deployed_ = section("sim-to-real", ours, steps=[400_000, 600_000, 800_000, 1_000_000])
    settings, wanted = Statistics(replicates=300, last=last), trim_mean(VALUES[:, -last:].mean(axis=1), 0.25)
    before = table_of(iqm, plain, QUICK)
    for kind in (iqm, final, noisy_teacher):
        found = table_of(kind, plain, settings)
        assert found["iqm"].tolist() == [pytest.approx(wanted)], kind.__name__
        assert (found["low"] <= found["iqm"]).all()
        assert found["step"].tolist() == [400]
    found = table_of(iqm, plain, settings)
    assert found["auc"].tolist() == before["auc"].tolist()
    np.testing.assert_allclose(found["q75"], np.quantile(VALUES[:, -last:].mean(axis=1), 0.75))
    found = table_of(less_feedback, sparing, settings)
    assert found["final_iqm"].tolist() == [pytest.approx(wanted)] * 2
    assert found["mean_iqm"].tolist() == [pytest.approx(trim_mean(VALUES, 0.25, axis=0).mean())] * 2
    third = row(table_of(sim_to_real, deployed_, settings), paper_step=800_000, score="success")
    assert third["simulation"] == pytest.approx(trim_mean(VALUES[:, max(0, 3 - last) : 3].mean(axis=1), 0.25))


def test_no_evaluation_is_no_score():
    """In a notebook too a score is of one evaluation at least."""
    with pytest.raises(UserError, match="last=0"):
        Statistics(last=0)


@pytest.mark.parametrize("last", [1, 3, 9])
def test_notes_say_what_a_score_at_a_step_is(last):
    """Of how many evaluations it is, and where there are fewer, stands below the table; of one nothing does."""
    (report,) = final.make([little()], Statistics(last=last, replicates=300))
    said = [note for note in report.notes if "valuations up to it" in note or "fewer" in note]
    mean = f"Score at a step: mean of the last {last} evaluations up to it, or of those that there are."
    few = "There are fewer: button-press, 3 at step 300; door-open, 3 at step 300."
    assert said == {1: [], 3: [mean], 9: [mean, few]}[last]
    assert report.facts.get("score_at_step") == (None if last == 1 else f"mean of the last {last} evaluations")


GOLDEN = Path(__file__).with_name("golden")
RECORDED = {
    "noisy-teacher": lambda: noisy_teacher.make([noisy(profile="laptop")], QUICK),
    "noisy-teacher-plus-minus": lambda: noisy_teacher.make([noisy()], Statistics(replicates=300, plus_minus=True)),
    "less-feedback": lambda: less_feedback.make([little()], QUICK),
    "sim-to-real": lambda: sim_to_real.make([deployed()], QUICK),
    "final": lambda: final.make([little(schedules=(FULL,))], QUICK),
    "claims": lambda: claims.make([noisy()], QUICK),
}


@pytest.mark.parametrize(("form", "suffix"), [("markdown", "md"), ("latex", "tex"), ("terminal", "txt")])
@pytest.mark.parametrize("name", RECORDED)
def test_text_is_as_recorded(name, form, suffix):
    """The text of every kind is that of the golden file, to the byte."""
    assert to_text(RECORDED[name](), form) == (GOLDEN / f"{name}.{suffix}").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", RECORDED)
def test_values_are_as_recorded(name):
    """CSV and JSON of every kind are the golden files', but for the last digits of a processor's sums."""

    def rounded(text):
        return json.loads(text, parse_float=lambda digits: round(float(digits), 9))

    reports = RECORDED[name]()
    found, wanted = (pd.read_csv(each) for each in (io.StringIO(to_text(reports, "csv")), GOLDEN / f"{name}.csv"))
    pd.testing.assert_frame_equal(found, wanted, rtol=1e-9)
    recorded = (GOLDEN / f"{name}.json").read_text(encoding="utf-8")
    assert rounded(to_text(reports, "json")) == rounded(recorded)
