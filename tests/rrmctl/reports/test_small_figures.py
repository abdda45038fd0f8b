"""What the figures of single experiments show."""

import numpy as np
import pytest
from scipy.stats import trim_mean

from rrm.imitation.finetune import GradientLog
from rrmctl.errors import UserError
from rrmctl.reports.figures import deployed, gradient_norm
from rrmctl.reports.figures.ablation import ablation
from rrmctl.reports.figures.diagnostics import diagnostics
from rrmctl.reports.figures.gradient_norm import gradient_norms
from rrmctl.reports.figures.human import smooth, smoothed_curves
from rrmctl.reports.figures.less_feedback import less_feedback
from rrmctl.reports.figures.profile import profile
from rrmctl.reports.select import read_sections, sections
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.styles import style
from rrmctl.reports.tables import less_feedback as less_feedback_table
from rrmctl.reports.tables import sim_to_real
from rrmctl.store import load_gradients
from rrmctl.store.files import DamagedError
from rrmctl.store.layout import Layout
from tests.rrmctl.reports import scenes, stores
from tests.rrmctl.reports.frames import RISING, Sweep, together
from tests.rrmctl.reports.pictures import legend, lines, misplaced, panels, words


def titles(figure):
    return [axes.get_title() for axes in panels(figure)]


def iqm(seeds):
    return trim_mean(np.array(seeds), 0.25, axis=0)


def test_an_ablation_panel_is_one_prior():
    """A panel for each prior with and without the residual: the pair, and the methods without any prior."""
    figure = ablation(*scenes.ablation())
    assert titles(figure) == ["button-press: proxy", "button-press: sparse"]
    proxy, sparse = panels(figure)
    drawn = {line.get_color() for line in proxy.get_lines()}
    assert drawn == {style(name).color for name in ("oracle", "pebble", "rrm-proxy")}
    residual, alone = sorted(lines(proxy, "rrm-proxy"), key=lambda line: line.get_linestyle())
    assert (residual.get_markerfacecolor(), alone.get_markerfacecolor()) == (style("rrm-proxy").color, "white")
    np.testing.assert_allclose(residual.get_ydata(), 100 * iqm(RISING["rrm-proxy"]))
    np.testing.assert_allclose(alone.get_ydata(), 100 * iqm(scenes.LOW))
    assert len(lines(sparse, "rrm-sparse")) == 2
    assert "rrm-language (n = 5)" not in legend(figure)


def test_less_feedback_is_a_point_a_budget():
    """Session sizes at the shortest wait from large to small, and waits at the largest session; each the mean of the
    IQM over the steps.
    """
    figure = less_feedback(*scenes.less_feedback(), replicates=200)
    sizes, waits = panels(figure)
    assert [label.get_text() for label in sizes.get_xticklabels()] == ["50", "25", "5"]
    assert [label.get_text() for label in waits.get_xticklabels()] == ["5k", "20k"]
    (pebble,) = lines(sizes, "pebble")
    usual, low = 100 * iqm(RISING["pebble"]).mean(), 100 * iqm(scenes.LOW).mean()
    np.testing.assert_allclose(pebble.get_ydata(), [usual, usual, low])
    np.testing.assert_allclose(pebble.get_xdata(), np.arange(3) - 0.06)
    final = [line for line in sizes.get_lines() if line.get_linestyle() == "None"]
    np.testing.assert_allclose(final[0].get_ydata(), 100 * np.array([iqm(RISING["pebble"])[-1]] * 2 + [0.2]))
    (low_end, high_end), *_ = (segment[:, 1] for segment in sizes.collections[0].get_segments())
    assert low_end < usual < high_end


def test_less_feedback_marks_the_last_evaluations():
    """The hollow points are what the table has as the last step, the filled ones stay the mean over all steps."""
    usual, smooth = (panels(less_feedback(*scenes.less_feedback(), replicates=100, last=last))[0] for last in (1, 2))
    hollow = next(line for line in smooth.get_lines() if line.get_linestyle() == "None")
    ends = 100 * iqm(np.array(RISING["pebble"])[:, -2:].mean(axis=1, keepdims=True))
    np.testing.assert_allclose(hollow.get_ydata(), [*ends, *ends, 20.0])
    filled = [lines(axes, "pebble")[0].get_ydata() for axes in (usual, smooth)]
    np.testing.assert_array_equal(*filled)


def unequal(steps):
    """One task at 90 % and one that rises to 40 %, each evaluated at its own steps, under two schedules."""
    levels = {"button-press": (0.9, 0.9), "door-open": (0.0, 0.4)}
    labels = [(task, "pebble", "oracle", asked) for task in levels for asked in ("50@5000/5000", "5@5000/500")]
    series = {label: stores.curve(*levels[label[0]], spread=0.1) for label in labels}
    return stores.frames("less-feedback", series, steps={label: steps[label[0]] for label in labels})


@pytest.mark.parametrize("other", [[100, 200], [70, 140]])
def test_the_figure_shows_the_tables_numbers(other):
    """The panel of several tasks is the mean over them, as in `report less-feedback`, whatever steps each has."""
    frames = unequal({"button-press": [100, 200], "door-open": other})
    (report,) = less_feedback_table.make(sections(*frames), Statistics(replicates=200))
    figure = less_feedback(*frames, replicates=200)
    assert titles(figure) == ["button-press", "door-open", "success tasks"]
    for axes, task in zip(panels(figure), ("button-press", "door-open", less_feedback_table.EVERY_TASK), strict=True):
        rows = report.table[report.table["task"] == task]
        np.testing.assert_allclose(lines(axes, "pebble")[0].get_ydata(), 100 * rows["mean_iqm"])
        ends = [segment[:, 1] for segment in axes.collections[0].get_segments()]
        np.testing.assert_allclose(ends, 100 * rows[["low", "high"]])
    hollow = next(each for each in panels(figure)[2].get_lines() if each.get_linestyle() == "None")
    np.testing.assert_allclose(hollow.get_ydata(), [65.0, 65.0])
    assert "mean over the tasks" in words(figure)


def test_a_task_whose_schedules_share_no_step_is_named():
    """It is left out of the figure, which says so, and keeps no other task from being drawn."""
    rows, jobs = unequal({"button-press": [100, 200], "door-open": [100, 200]})
    late = (rows["task"] == "door-open") & (rows["feedback"] == "5@5000/500")
    figure = less_feedback(rows.assign(step=rows["step"] + 5 * late), jobs, replicates=200)
    assert titles(figure) == ["button-press"]
    assert "Not drawn: door-open: no evaluation step is common to all schedules" in words(figure)


def test_less_feedback_pools_the_success_tasks():
    """Tasks asked under equal schedules have panels of their own, and two together."""
    figure = less_feedback(*scenes.less_feedback(("button-press", "door-open")), replicates=100)
    assert titles(figure) == ["button-press"] * 2 + ["door-open"] * 2 + ["success tasks"] * 2
    (pebble,) = lines(panels(figure)[4], "pebble")
    assert pebble.get_ydata()[0] == pytest.approx(100 * iqm(RISING["pebble"] * 2).mean())


def test_a_budget_without_runs_is_left_out():
    """A method that has no run under one schedule keeps its other points."""
    rows, jobs = scenes.less_feedback()
    gone = jobs.index[(jobs["method"] == "pebble") & (jobs["feedback"] == "25@5000/2500")]
    rows = rows[~rows["run"].isin(jobs.loc[gone, "run"])]
    jobs.loc[gone, "state"] = "queued"
    sizes, _ = panels(less_feedback(rows, jobs, replicates=100))
    (pebble,) = lines(sizes, "pebble")
    np.testing.assert_allclose(pebble.get_xdata(), [-0.06, 1.94])


def test_diagnostics_show_what_was_measured():
    """Rewards, true reward and agreement of the residual model on the opposite prior, from where they are known."""
    figure = diagnostics(*scenes.opposite())
    rewards, truth, agreement = panels(figure)
    shown = [line.get_ydata() for line in (*rewards.get_lines(), *truth.get_lines())]
    columns = ("prior_mean", "residual_mean", "reward_mean", "true_reward_mean")
    np.testing.assert_allclose(shown, [scenes.OPPOSITE[name] for name in columns])
    labels, true = agreement.get_lines()
    assert list(labels.get_xdata()) == [200, 300, 400]
    np.testing.assert_allclose(labels.get_ydata(), [80, 95, 98])
    np.testing.assert_allclose(true.get_ydata(), [70, 90, 95])
    assert len({line.get_linestyle() + line.get_marker() for line in rewards.get_lines()}) == 3
    assert "agreement with labels" in legend(figure)


def test_diagnostics_of_a_notebook_take_any_residual_model():
    """Where there is no opposite prior, every residual model given is shown."""
    rows, jobs = Sweep().frames()
    assert [title.splitlines() for title in titles(diagnostics(rows, jobs))] == [["button-press", "rrm-proxy"]] * 3
    without = rows["method"] != "rrm-proxy"
    with pytest.raises(UserError, match="no residual model"):
        diagnostics(rows[without], jobs[jobs["method"] != "rrm-proxy"])


def test_gradients_are_medians_before_and_after_the_change():
    """Each phase is a line of its own at the IQM over seeds of the runs' medians; the change is marked."""
    rows, jobs = scenes.finetune().frames()
    figure = gradient_norms(rows, scenes.gradients(jobs), jobs)
    (axes,) = panels(figure)
    assert axes.get_yscale() == "log"
    first, after = lines(axes, "finetune")
    assert set(np.round([*first.get_ydata(), *100 * after.get_ydata()], 9)) == {3.0}  # of 1 to 5, and of a hundredth
    assert max(first.get_xdata()) < 210 < min(after.get_xdata()) + 4
    assert [line.get_xdata()[0] for line in axes.get_lines() if list(line.get_ydata()) == [0, 1]] == [200, 200]
    assert legend(figure) == ["finetune (n = 5)", "finetune-tanh (n = 5)"]
    assert "Norms of 10 runs." in words(figure)


def test_runs_without_norms_cost_no_other_its_place():
    """A series is drawn of its runs that left norms, and the others are named."""
    rows, jobs = scenes.finetune().frames()
    norms = scenes.gradients(jobs)
    run = jobs.query("method == 'finetune' and seed == 4")["run"].item()
    figure = gradient_norms(rows, norms[norms["run"] != run], jobs)
    (axes,) = panels(figure)
    first, _ = lines(axes, "finetune")
    assert set(np.round(first.get_ydata(), 9)) == {2.5}  # of 1 to 4
    assert legend(figure) == ["finetune (n = 4)", "finetune-tanh (n = 5)"]
    assert "Norms of 9 runs." in words(figure)
    assert f"No norms of button-press, finetune (oracle, 50@5000/5000): {run} (seed 4)." in words(figure)


def test_gradients_are_read_from_the_store(tmp_path):
    """`gradients.parquet` beside the curves makes the figure appear; a damaged one is named."""
    sweep = scenes.finetune()
    sweep.write(tmp_path)
    (section,) = read_sections(tmp_path, "finetune")
    assert not gradient_norm.suits(section)
    norms = scenes.gradients(sweep.jobs())
    for run, frame in norms.groupby("run"):
        frame.drop(columns="run").to_parquet(Layout(tmp_path).run(run).gradients)
    assert gradient_norm.suits(section)
    (axes,) = panels(gradient_norm.draw(section))
    assert len(lines(axes, "finetune")) == 2
    read = load_gradients(tmp_path, list(sweep.jobs()["run"]))
    assert read.sort_values(["run", "step"], ignore_index=True).equals(
        norms.sort_values(["run", "step"], ignore_index=True)[list(read)]
    )
    path = Layout(tmp_path).run(norms["run"].iloc[0]).gradients
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DamagedError, match=path.parent.name):
        gradient_norm.draw(section)


def test_a_changed_number_among_gradients_is_noticed(tmp_path):
    """As a run writes them every page has a checksum: no changed bit makes another number."""
    folder, log = Layout(tmp_path).run("0123456789abcdef"), GradientLog()
    folder.path.mkdir(parents=True)
    for step in range(100):
        log.add(step, "airl", step / 7)
    log.write(folder.gradients)
    written, whole = folder.gradients.read_bytes(), load_gradients(tmp_path, [folder.id])
    assert whole["gradient_norm"].tolist() == [step / 7 for step in range(100)]
    refused, footer = 0, int.from_bytes(written[-8:-4], "little")
    for at in range(0, len(written) - 8 - footer, 5):
        folder.gradients.write_bytes(written[:at] + bytes([written[at] ^ 1]) + written[at + 1 :])
        try:
            assert load_gradients(tmp_path, [folder.id]).equals(whole)
        except DamagedError:
            refused += 1
    assert refused


def test_human_curves_are_smoothed_and_say_so():
    """The line is the IQM of smoothed seeds, a thin one that of the seeds as they are, and the window is told."""
    figure = smoothed_curves(*scenes.human())
    (axes,) = panels(figure)
    thin, thick = lines(axes, "pebble")
    np.testing.assert_allclose(thin.get_ydata(), 100 * iqm(RISING["pebble"]))
    np.testing.assert_allclose(thick.get_ydata(), 100 * iqm(smooth(np.array(RISING["pebble"]), 5)))
    assert thin.get_linewidth() < thick.get_linewidth()
    assert "centred mean over 5 evaluations" in words(figure)
    assert axes.get_ylabel() == "Success rate (%), smoothed"


def test_smoothing_is_a_centred_mean():
    """Three under the window, one at each end: nothing is shifted."""
    np.testing.assert_allclose(smooth(np.array([0.0, 3.0, 0.0, 0.0, 6.0]), 3), [0, 1, 1, 2, 6])
    values = np.random.default_rng(0).random((4, 20))
    np.testing.assert_allclose(smooth(values, 1), values)
    line = np.linspace(2, 5, 20)
    np.testing.assert_allclose(smooth(line, 7), line)
    np.testing.assert_allclose(smooth(values[:, ::-1], 5), smooth(values, 5)[:, ::-1])
    middle = np.apply_along_axis(lambda row: np.convolve(row, np.ones(5) / 5, "valid"), 1, values)
    np.testing.assert_allclose(smooth(values, 5)[:, 2:-2], middle)
    assert smooth(values[:, :2], 5).shape == (4, 2)


def test_a_profile_is_the_share_of_runs_above():
    """At each score the share of the seeds that end higher, at the last step of all methods."""
    figure = profile(*Sweep().frames(), replicates=100)
    (axes,) = panels(figure)
    (pebble,) = lines(axes, "pebble")
    final = np.array([seed[-1] for seed in RISING["pebble"]])
    expected = [100 * (100 * final > score).mean() for score in pebble.get_xdata()]
    np.testing.assert_allclose(pebble.get_ydata(), expected)
    assert axes.get_title() == "button-press, step 400"
    assert len(axes.collections) == 3


def test_a_profile_pools_tasks_unless_that_loses_a_method():
    """Success tasks share a panel; where a method has no runs on one of them, each has its own."""
    assert titles(profile(*scenes.main_results(), replicates=100)) == [
        "walker-walk, step 400",
        "success tasks, last step",
    ]
    few = {name: RISING[name] for name in ("oracle", "rrm-proxy")}
    figure = profile(*together(Sweep(), Sweep(curves=few, tasks=("door-open",))), replicates=100)
    assert titles(figure) == ["button-press, step 400", "door-open, step 400"]


def test_deployed_checkpoints_are_points():
    """A panel a task: at the rig with an interval, the simulation hollow, the paper's robot as a dash; as its table."""
    section = stores.deployed(lost=1)
    figure = deployed.draw(section, Statistics(replicates=300))
    assert titles(figure) == ["panda-reach", "panda-push", "panda-pick-and-reach"]
    push = panels(figure)[1]
    assert [label.get_text() for label in push.get_xticklabels()] == ["400k", "600k", "800k"]
    (report,) = sim_to_real.make([section], Statistics(replicates=300))
    told = report.table.query("task == 'panda-push' and method == 'rrm-h2o' and score == 'success'")
    ours, simulated, paper = (line for line in push.get_lines() if line.get_color() == style("rrm-h2o").color)
    for drawn, column in ((ours, "iqm"), (simulated, "simulation"), (paper, "published")):
        np.testing.assert_allclose(drawn.get_ydata(), 100 * told[column])
    assert (simulated.get_markerfacecolor(), paper.get_marker()) == ("white", "_")
    assert "the cube was lost from sight" in words(figure)
    assert not deployed.suits(stores.section("x", {("panda-push", "pebble", "oracle", "a"): [[0.1]]}, steps=[1]))


@pytest.mark.parametrize("width", ["column", "page"])
def test_deployments_are_not_cut_off(width):
    """Titles, names of axes, legend and notes lie on the page and not on one another."""
    assert misplaced(deployed.draw(stores.deployed(), Statistics(width=width, replicates=100))) == []
