import numpy as np
import pandas as pd
import pytest

from rrm.errors import UnknownNameError
from rrmctl.errors import UserError
from rrmctl.labels import Label
from rrmctl.reports.select import of_profile, read_sections, sections, sections_for
from rrmctl.reports.series import at_steps
from tests.rrmctl.reports.frames import FEEDBACK, RISING, SATURATED, Sweep


def only(sweep: Sweep):
    (section,) = sections(*sweep.frames(), evaluation=sweep.evaluation())
    return section


def by_method(section):
    return {each.label.method: each for each in section.series}


def test_a_series_is_a_matrix_of_seeds_and_steps():
    """Rows become [seed, step] in the order of the seeds, whatever the order of the rows."""
    rows, jobs = Sweep().frames()
    (section,) = sections(rows.sample(frac=1, random_state=0), jobs)
    pebble = by_method(section)["pebble"]
    np.testing.assert_array_equal(pebble.values, RISING["pebble"])
    assert pebble.seeds == (0, 1, 2, 3, 4)
    assert list(pebble.steps) == [100, 200, 300, 400]
    assert (pebble.n, pebble.planned, pebble.finished) == (5, 5, True)
    assert pebble.label == Label("button-press", "pebble", "oracle", FEEDBACK)


def test_each_task_has_its_own_score():
    """Meta-World is read by success, DM-Control by the true return."""
    section = only(Sweep(tasks=("button-press", "walker-walk")))
    scores = {each.label.task: (each.score, each.values.max()) for each in section.series}
    assert scores == {"button-press": ("success", 1.0), "walker-walk": ("return", 1000.0)}


def test_seeds_need_not_be_the_same_everywhere():
    """Methods with different numbers of seeds each keep their own."""
    section = only(Sweep(curves=RISING | {"pebble": RISING["pebble"][:2]}))
    assert {name: each.n for name, each in by_method(section).items()} == {"oracle": 5, "pebble": 2, "rrm-proxy": 5}


def test_missing_and_failed_runs_are_named():
    """A failed run counts for nothing, however long its curve; a run without a curve is missing; both are listed."""
    failed, queued = ("button-press", "pebble", 1), ("button-press", "pebble", 3)
    section = only(Sweep(states={failed: "failed", queued: "queued"}, lengths={queued: 0}))
    assert by_method(section)["pebble"].seeds == (0, 2, 4)
    assert [(each.seed, each.state) for each in section.absent] == [(1, "failed"), (3, "queued")]
    assert (section.contained, section.planned) == (13, 15)


def test_finished_runs_are_not_cut_short_by_those_under_way():
    """Where some runs are finished, a series consists of them, at full length."""
    running = ("button-press", "pebble", 0)
    section = only(Sweep(states={running: "running"}, lengths={running: 1}))
    pebble = by_method(section)["pebble"]
    assert (pebble.n, pebble.steps.size) == (4, 4)
    assert [(each.seed, each.state) for each in section.absent] == [(0, "running")]


def test_runs_under_way_are_read_at_their_common_steps():
    """Where no run is finished, those under way count as far as all of them have come."""
    keys = [("button-press", "pebble", seed) for seed in range(5)]
    states = dict(zip(keys, ["running", "interrupted", "running", "running", "failed"], strict=True))
    section = only(Sweep(states=states, lengths=dict(zip(keys, [3, 2, 4, 2, 1], strict=True))))
    pebble = by_method(section)["pebble"]
    assert (pebble.n, list(pebble.steps), pebble.finished) == (4, [100, 200], False)
    (panel,) = section.panels()
    assert list(panel.steps()) == [100, 200]


def test_variants_never_meet():
    """Two variants of one experiment are two sections, each with its own runs."""
    frames = [
        Sweep().frames(),
        Sweep(variant="bbbb", overrides={"agent.batch": 64}, curves=SATURATED).frames(),
    ]
    rows, jobs = (pd.concat(tables, ignore_index=True) for tables in zip(*frames, strict=True))
    first, second = sections(rows, jobs)
    assert (first.overrides, second.overrides) == ({}, {"agent.batch": 64})
    np.testing.assert_array_equal(by_method(first)["pebble"].values, RISING["pebble"])
    assert (by_method(second)["pebble"].values == 1.0).all()


def test_runs_of_several_configurations_are_refused():
    """Runs that differ in more than the seed under one label raise, and each configuration's seeds are named."""
    sweep = Sweep(cells={("button-press", "pebble", 3): "feedfeedfeedfeed"})
    with pytest.raises(UserError, match=r"pebble .*2 different configurations.*\(seeds 0, 1, 2, 4\).*\(seeds 3\)"):
        only(sweep)


def test_what_is_not_a_number_is_left_out_and_told():
    """A step at which a seed has no number is left out of the series, and the run is named."""
    rows, jobs = Sweep().frames()
    run = jobs["run"][(jobs["method"] == "pebble") & (jobs["seed"] == 2)].item()
    rows.loc[(rows["run"] == run) & (rows["step"] == 200), "success"] = np.nan
    (section,) = sections(rows, jobs)
    assert list(by_method(section)["pebble"].steps) == [100, 300, 400]
    assert by_method(section)["pebble"].n == 5
    (problem,) = section.problems
    assert "not a number" in problem
    assert run in problem


def test_a_series_of_nothing_but_nan_is_empty():
    """Where no step has numbers for all seeds the series has no run, and they count as absent."""
    rows, jobs = Sweep().frames()
    rows.loc[rows["method"] == "pebble", "success"] = np.nan
    (section,) = sections(rows, jobs)
    assert by_method(section)["pebble"].n == 0
    assert len(section.absent) == 5
    assert [each.label.method for each in section.panels()[0].present()] == ["oracle", "rrm-proxy"]


def test_the_oracle_stands_in_every_panel_of_its_task():
    """Schedules are compared in panels of their own; what asks nothing is in each of them."""
    first, second = (
        Sweep(curves={k: RISING[k] for k in ("oracle", "pebble")}),
        Sweep(curves={"pebble": RISING["rrm-proxy"]}, feedback="5@5000/500"),
    )
    changed = [
        table.replace({"run": dict(zip(second.jobs()["run"], "vwxyz", strict=True))}) for table in second.frames()
    ]
    changed = [table.assign(cell="other") for table in changed]
    rows, jobs = (pd.concat(pair, ignore_index=True) for pair in zip(first.frames(), changed, strict=True))
    (section,) = sections(rows, jobs)
    panels = {panel.feedback: [each.label.method for each in panel.present()] for panel in section.panels()}
    assert panels == {FEEDBACK: ["oracle", "pebble"], "5@5000/500": ["oracle", "pebble"]}


def test_the_step_of_comparison_is_the_first_full_one():
    """Four of five seeds of rrm-proxy are at 100 % at step 300, so every method is read there."""
    (panel,) = only(Sweep()).panels()
    read = panel.read_at()
    assert (read.step, read.reached, read.by) == (300, True, ("rrm-proxy",))
    np.testing.assert_array_equal(
        at_steps(panel.series[1], np.array([read.step])), [[row[2]] for row in RISING["pebble"]]
    )


def test_methods_without_a_common_step_are_not_compared():
    """Curves evaluated at different steps raise, naming where each was evaluated."""
    rows, jobs = Sweep().frames()
    rows.loc[rows["method"] == "pebble", "step"] += 1
    (section,) = sections(rows, jobs)
    with pytest.raises(UserError, match=r"no evaluation step is common.*pebble at 101 to 401"):
        section.panels()[0].steps()


def test_without_a_plan_the_rows_are_the_plan():
    """In a notebook the rows alone are enough; nothing can then be missing."""
    (section,) = sections(Sweep().rows())
    assert (section.contained, section.planned, section.absent) == (15, 15, ())


def test_an_unknown_task_is_refused():
    """A task of another version of the program is named with the known ones."""
    rows, jobs = (table.assign(task="button-pres") for table in Sweep().frames())
    with pytest.raises(UnknownNameError, match="button-press"):
        sections(rows, jobs)


def test_the_protocol_is_read_from_the_runs(tmp_path):
    """Episodes, the rule of success and the policy are told as the runs were evaluated."""
    Sweep().write(tmp_path)
    (section,) = read_sections(tmp_path, "main-results")
    assert section.evaluation == ("10 episodes an evaluation, success at any step of an episode, deterministic policy",)


@pytest.mark.slow
def test_the_store_gives_the_same_sections_as_the_frames(tmp_path):
    """Files and DataFrames are two ways to one content."""
    sweep = Sweep(states={("button-press", "pebble", 1): "failed"})
    sweep.write(tmp_path)
    Sweep(experiment="toy-car", tasks=("toy-car",), variant="cccc").write(tmp_path)
    (section,) = read_sections(tmp_path, "main-results")
    expected = only(sweep)
    for found, wanted in zip(section.series, expected.series, strict=True):
        assert (found.label, found.seeds, found.planned) == (wanted.label, wanted.seeds, wanted.planned)
        np.testing.assert_array_equal(found.values, wanted.values)
    assert section.absent == expected.absent
    assert [each.experiment for each in read_sections(tmp_path)] == ["main-results", "toy-car"]


def test_unknown_experiments_and_profiles_suggest_the_nearest(tmp_path):
    """A misspelt name is answered with the near one that is in the store."""
    Sweep().write(tmp_path)
    with pytest.raises(UserError, match='did you mean "main-results"'):
        read_sections(tmp_path, "main-result")
    with pytest.raises(UserError, match='did you mean "laptop"'):
        of_profile(read_sections(tmp_path), "laptp")


def test_what_is_not_asked_for_is_in_nobodys_way(tmp_path):
    """Runs that do not belong together refuse tables of themselves, and no table of others."""
    Sweep().write(tmp_path)
    Sweep(experiment="mine", variant="cccc", versions={("button-press", "pebble", 0): 1}).write(tmp_path)
    assert [one.experiment for one in sections_for(tmp_path, ["main-results", "surf"])] == ["main-results"]
    for asked in ((), ["mine"], ["surf", "mrn"]):
        with pytest.raises(UserError, match=r"mine, profile .* do not belong in one report"):
            sections_for(tmp_path, asked)


def test_an_empty_store_says_what_to_run(tmp_path):
    """Nothing to report is an error with a hint, be it no folder, no experiment or no evaluation."""
    with pytest.raises(UserError, match="no results folder") as missing:
        read_sections(tmp_path / "none")
    with pytest.raises(UserError, match="holds no experiment") as empty:
        read_sections(tmp_path)
    keys = [("button-press", method, seed) for method in RISING for seed in range(5)]
    Sweep(states=dict.fromkeys(keys, "queued"), lengths=dict.fromkeys(keys, 0)).write(tmp_path)
    with pytest.raises(UserError, match="15 queued") as waiting:
        of_profile(read_sections(tmp_path), None)
    assert all("rrmctl run quickstart" in str(found.value.hint) for found in (missing, empty))
    assert f"rrmctl status --results {tmp_path}" in str(waiting.value.hint)
