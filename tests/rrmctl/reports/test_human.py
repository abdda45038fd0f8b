"""`rrmctl report human`: what people answered, read out of stores whose truth is known."""

import dataclasses
import json
import math
import re

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from rrm.teachers.labels import EQUAL, FIRST, PRACTICE, SECOND, SKIPPED, Label, read_labels, write_labels
from rrmctl.cli.app import app
from rrmctl.errors import UserError
from rrmctl.reports.answers import Answers, answers
from rrmctl.reports.dataframes import report_table
from rrmctl.reports.figures import human_returns, human_sitting
from rrmctl.reports.page.assembly import build
from rrmctl.reports.select import read_sections
from rrmctl.reports.statistics import Statistics
from rrmctl.store.layout import Layout
from tests.rrmctl.reports.frames import Sweep
from tests.rrmctl.reports.people import FIVE, LENGTH, Person, study, sweep
from tests.rrmctl.reports.pictures import legend, misplaced, panels, words

QUICK = Statistics(replicates=400)


def rrmctl(*arguments):
    return CliRunner().invoke(app, [str(each) for each in arguments])


def label(**told):
    """An answer of anna's; the first clip is on the left and worth more."""
    plain = {
        "run": "", "step": 1, "index": 0, "query": "q", "first": "a", "second": "b", "answer": FIRST,
        "shown_left": FIRST, "return_first": 2.0, "return_second": 1.0, "return_shown": True,
        "annotator": "anna", "purpose": "train",
        "latency_ms": 1000.0, "loops": 1.0, "speed": 1.0, "input": "key", "shown_at": 0.0, "at": 1.0,
    }  # fmt: skip
    return Label(**plain | told)


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Five people, ten runs of a hundred queries, half of them with returns shown, twenty shared ones."""
    root = tmp_path_factory.mktemp("human") / "results"
    study(root, FIVE, np.random.default_rng(0), repeat=5, hint=lambda at: at % 2 == 0)
    return root


def table(root, about, **settings):
    """One of the three tables, by what all of its columns but the person's are called."""
    whole = report_table("human", root, settings=dataclasses.replace(QUICK, **settings)).set_index("annotator")
    return whole[whole[about].notna()]


def test_what_was_put_in_is_counted(results):
    """Answers by person; no number of one person's is another's."""
    told = table(results, "answers")
    given = [each for run in Layout(results).run_ids() for each in read_labels(Layout(results).run(run).labels)]
    given += read_labels(Layout(results).extra_labels)
    for person in FIVE:
        own = [each for each in given if each.annotator == person.name]
        assert told["answers"][person.name] == len(own) == 230
        assert told["ties"][person.name] == sum(each.answer == EQUAL for each in own)
        assert told["skips"][person.name] == sum(each.answer == SKIPPED for each in own)
        assert told["latency"][person.name] == pytest.approx(np.median([each.latency_ms for each in own]) / 1000)
    assert told["answers"]["everybody"] == len(given)


def within(row, name, truth):
    return row[f"{name}_low"] <= truth <= row[f"{name}_high"]


@pytest.mark.slow
def test_the_report_recovers_what_was_put_in(tmp_path):
    """Error, bias to the left, tiring, slowing, reliance on the returns: over many studies the intervals of each hold
    the truth about as often as they say.
    """
    studies, names = 20, ("left", "agreement", "latency_change", "agreement_change", "hint")
    held = {name: [] for name in names}
    for number in range(studies):
        root = tmp_path / str(number)
        study(root, FIVE, np.random.default_rng([11, number]), repeat=5, hint=lambda at: at % 2 == 0)
        whole = report_table("human", root, settings=QUICK)
        for person in FIVE:
            rows = whole[whole["annotator"] == person.name]
            people, sittings = rows[rows["answers"].notna()].iloc[0], rows[rows["sittings"].notna()].iloc[0]
            places = np.arange(230) % LENGTH
            shown = places % 2 == 0
            right = np.array([person.right(hint, at) for hint, at in zip(shown, places, strict=True)])
            held["left"].append(within(people, "left", 0.5 + person.left / 2))
            held["agreement"].append(within(people, "agreement", right.mean()))
            held["latency_change"].append(within(sittings, "latency_change", math.expm1(person.slowing)))
            tiring = person.tiring * (1 - person.left)
            if not person.hint:
                held["agreement_change"].append(within(sittings, "agreement_change", -tiring))
            held["hint"].append(within(sittings, "hint", right[shown].mean() - right[~shown].mean()))
    for name, each in held.items():
        assert np.mean(each) >= 0.90, name
        assert len(each) >= 4 * studies


@pytest.mark.slow
def test_one_study_shows_each_failing_apart(tmp_path):
    """Failings that are large are found in the one whose they are, and in nobody else."""
    people = (
        Person("plain"), Person("left", left=0.4), Person("tired", tiring=0.4, slowing=0.7),
        Person("led", error=0.3, hint=0.8),
    )  # fmt: skip
    study(tmp_path / "r", people, np.random.default_rng(1), queries=200, hint=lambda at: at % 2 == 0)
    left, slower = table(tmp_path / "r", "answers"), table(tmp_path / "r", "sittings")
    assert [name for name in left.index if left["left_low"][name] > 0.5] == ["left", "everybody"]
    assert [name for name in slower.index if slower["latency_change_low"][name] > 0.2] == ["tired"]
    assert [name for name in slower.index if slower["agreement_change_high"][name] < -0.15] == ["tired"]
    assert [name for name in slower.index if slower["hint_low"][name] > 0.1] == ["led"]


def test_agreement_is_over_what_several_answered(results):
    """Alpha over the shared queries, kappa of each two; people who err more agree less."""
    told = report_table("human", results, settings=QUICK)
    told = told[told["measure"].notna()].set_index("annotator")
    assert list(told["measure"]) == ["alpha"] + ["kappa"] * 10
    assert set(told["queries"]) <= {18, 19, 20}  # skipped ones are no answers
    assert (told["beyond_chance_low"] <= told["beyond_chance"]).all()
    assert told["beyond_chance"]["anna / cleo"] > told["beyond_chance"]["ben / dilan"]


def test_only_what_counts_is_counted():
    """Neither practice nor what was taken back; of a run's query the newest answer; of shared ones each person's."""
    rows = [
        label(purpose=PRACTICE, query="p"), label(undone=True), label(answer=SECOND, at=2.0),
        label(answer=EQUAL, at=1.5),  # of a clock that was set back
        label(purpose="shared", query="s"), label(purpose="shared", query="s", annotator="ben"),
        label(index=7, annotator="", answer=SKIPPED, input="unshown", latency_ms=0.0),  # nobody's
    ]  # fmt: skip
    given = Answers.of(rows)
    assert [(each.purpose, each.answer, each.annotator) for each in given.labels] == [
        ("train", EQUAL, "anna"), ("shared", FIRST, "anna"), ("shared", FIRST, "ben"),
    ]  # fmt: skip
    assert (given.practice, len(given.undone), given.people) == (1, 1, ["anna", "ben"])


def test_what_is_no_preference_is_no_error():
    """Ties, skips and equal returns agree with no return and stand on no side."""
    rows = [
        label(index=0), label(index=1, answer=SECOND), label(index=2, answer=EQUAL), label(index=3, answer=SKIPPED),
        label(index=4, return_second=2.0), label(index=5, answer=SECOND, shown_left=SECOND, return_second=3.0),
    ]  # fmt: skip
    given = Answers.of(rows)
    assert given.right() == pytest.approx([1, 0, np.nan, np.nan, np.nan, 1], nan_ok=True)
    assert list(given.left()) == [1, 0, 1, 1]


def test_repeats_are_compared_with_what_was_said_before():
    """The same query again, whichever side it stood on; one that was skipped says nothing."""
    rows = [
        label(query="a", index=0), label(query="a", purpose="repeat", index=0, shown_left=SECOND, at=2.0),
        label(query="b", index=1), label(query="b", purpose="repeat", index=1, answer=SECOND, at=3.0),
        label(query="c", index=2, answer=SKIPPED), label(query="c", purpose="repeat", index=2, at=4.0),
        label(query="a", index=9, annotator="ben", at=5.0),
    ]  # fmt: skip
    assert Answers.of(rows).repeated() == [True, False]


def test_first_sessions_of_one_seed_are_shared_without_asking():
    """Two runs with a query in common, answered by two people."""
    rows = [label(run="1", query="a"), label(run="2", query="a", annotator="ben", answer=SECOND, at=2.0)]
    people, ratings = Answers.of(rows).ratings()
    assert (people, ratings.tolist()) == (["anna", "ben"], [[FIRST, SECOND]])


def drawn_of(results, figure):
    (section,) = read_sections(results, "human-study")
    return section, figure.draw(section, QUICK)


def test_a_line_with_returns_shown_and_one_without(results):
    """Points hold all decided answers, at rising differences; without a task's answers there is no panel."""
    section, drawn = drawn_of(results, human_returns)
    shown, hidden = (line for line in panels(drawn)[0].get_lines() if len(line.get_xdata()) > 2)
    assert legend(drawn) == ["returns shown", "returns not shown"]
    for line in (shown, hidden):
        assert (np.diff(line.get_xdata()) > 0).all()
        assert 50 < np.mean(line.get_ydata()) < 100
    given = answers(section)["window-open"]
    assert f"{int(np.sum(~np.isnan(given.right())))} answers." in words(drawn)


def test_closer_pairs_are_told_apart_less(tmp_path):
    """The curve of people who cannot tell small differences rises."""
    people = [dataclasses.replace(person, blur=20.0) for person in FIVE]
    study(tmp_path, people, np.random.default_rng(0), queries=200)
    _, drawn = drawn_of(tmp_path, human_returns)
    (line,) = (line for line in panels(drawn)[0].get_lines() if len(line.get_xdata()) > 2)
    assert legend(drawn) == ["returns shown"]
    assert line.get_ydata()[0] < line.get_ydata()[3] - 5 < line.get_ydata()[-1] - 10


def test_a_sitting_has_a_line_for_everybody_and_each(results):
    """Both panels, a point for each stretch of twenty answers."""
    section, drawn = drawn_of(results, human_sitting)
    latency, right = panels(drawn)
    assert legend(drawn) == ["everybody", *(person.name for person in FIVE)]
    lines = [line for line in latency.get_lines() if len(line.get_xdata()) > 2]
    assert [list(line.get_xdata()) for line in lines] == [[10, 30, 50, 70, 90]] * 6
    cleo = answers(section)["window-open"].by("cleo")
    first = np.concatenate([sitting[:20] for sitting in cleo.sittings(cleo.seconds())])
    assert lines[3].get_ydata()[0] == pytest.approx(np.median(first))
    assert lines[3].get_ydata()[-1] > lines[3].get_ydata()[0]
    assert right.get_ylim()[0] <= 45


@pytest.mark.slow
def test_few_answers_and_strange_names_are_shown_as_they_are(tmp_path):
    """Three answers tell no change along a sitting, however they differ; names are words, not formulas or markup."""
    names = ("_ann", "$x^", "a & [b]", "ben$_$c")
    people = [Person(name, seconds=10.0**at, slowing=2000.0) for at, name in enumerate(names)]
    study(tmp_path, people, np.random.default_rng(0), queries=1, shared=1)
    sittings = table(tmp_path, "sittings")
    assert list(sittings.index) == [*sorted(names), "everybody"]
    assert sittings["latency_change"].isna().all()
    for form in ("terminal", "markdown", "latex", "csv"):
        assert rrmctl("report", "human", "--results", tmp_path, "--format", form).exit_code == 0
    _, drawn = drawn_of(tmp_path, human_sitting)
    assert len(legend(drawn)) == 5
    assert misplaced(drawn) == []


@pytest.mark.parametrize("width", ["column", "page"])
@pytest.mark.parametrize("figure", [human_returns, human_sitting])
def test_nothing_is_cut_off_or_covered(results, figure, width):
    """Titles, names of axes, legend and notes lie on the page and not on one another, in both widths."""
    (section,) = read_sections(results, "human-study")
    assert misplaced(figure.draw(section, dataclasses.replace(QUICK, width=width))) == []


def test_notebooks_hand_labels_over(results):
    """The same figures of frames and labels, without a store beside them."""
    rows, jobs = sweep().frames()
    layout = Layout(results)
    labels = {"window-open": [each for run in layout.run_ids() for each in read_labels(layout.run(run).labels)]}
    for function in (human_returns.preferred_returns, human_sitting.along_a_sitting):
        assert len(legend(function(rows, labels, jobs))) in (2, 6)
    with pytest.raises(UserError, match="to draw"):
        human_sitting.along_a_sitting(rows, {}, jobs)


@pytest.mark.slow
def test_the_page_has_a_chapter_where_there_are_answers(results):
    """Figures and tables of people stand in it and nowhere else."""
    text = build(results, settings=QUICK)
    chapter = text.split('<section id="human-study-laptop-people">')[1].split("<details>")[0]
    for told in ("human-study-laptop-figure-human-returns", "human-study-laptop-human-3", "Agreement between people"):
        assert told in chapter
        assert text.count(f'id="{told}"') <= 1


@pytest.mark.parametrize("form", ["terminal", "markdown", "latex", "csv", "json"])
def test_every_form_has_it(results, form):
    """Three tables, each with its rows, in every form that the others have."""
    shown = rrmctl("report", "human", "human-study", "--results", results, "--format", form, "--replicates", 200)
    assert shown.exit_code == 0, shown.stderr
    assert all(person.name in shown.stdout for person in FIVE)
    if form == "json":
        abouts = [report["about"] for report in json.loads(shown.stdout)["reports"]]
        assert abouts == ["What people answered", "Along a sitting", "Agreement between people"]


@pytest.mark.slow
def test_what_cannot_be_estimated_says_so(tmp_path):
    """Without shared and repeated queries, with one person, with returns always shown: what to ask with."""
    study(tmp_path / "two", FIVE[:2], np.random.default_rng(0), queries=10, shared=0)
    shown = rrmctl("report", "human", "--results", tmp_path / "two").stdout
    assert "Not estimable, no shared queries: ask with --shared 20." in shown
    assert "ask with --repeat 5." in shown
    assert "Itself" not in shown
    assert "With returns shown" not in shown
    study(tmp_path / "one", FIVE[:1], np.random.default_rng(0), queries=10, shared=0)
    assert "One person alone answered" in rrmctl("report", "human", "--results", tmp_path / "one").stdout


@pytest.mark.slow
def test_before_the_first_evaluation_there_is_a_report(tmp_path):
    """Runs that wait for their first answers have no curve; what people said is shown all the same, and plotted."""
    made = sweep()
    keys = [("window-open", method, seed) for method in made.curves for seed in range(5)]
    waiting = {"states": dict.fromkeys(keys, "waiting"), "lengths": dict.fromkeys(keys, 0)}
    study(tmp_path, FIVE, np.random.default_rng(0), queries=10, **waiting)
    assert "anna" in rrmctl("report", "human", "--results", tmp_path).stdout
    drawn = rrmctl("plot", "human-study", "--results", tmp_path, "--format", "png", "--figure", "human-sitting")
    assert drawn.exit_code == 0, drawn.stderr
    assert "human-sitting.png" in drawn.stdout
    page = rrmctl("report", "html", "--results", tmp_path, "-o", tmp_path / "page.html")
    assert page.exit_code == 0, page.stderr
    assert "What people answered" in (tmp_path / "page.html").read_text()


def test_runs_that_wait_are_under_way(tmp_path):
    """They are reported as far as all have come, like those that run."""
    states = {("button-press", "pebble", seed): "waiting" for seed in range(5)}
    Sweep(states=states).write(tmp_path)
    assert list(report_table("final", tmp_path, settings=QUICK).set_index("method")["n"]) == [5, 5, 5]


def refusal(ran):
    assert (ran.exit_code, ran.stdout) == (2, "")
    assert "Traceback" not in ran.stderr
    return ran.stderr


@pytest.mark.slow
def test_a_store_without_answers_is_refused_in_a_line(tmp_path):
    """Runs without answers; no runs at all; a damaged file."""
    Sweep().write(tmp_path / "runs")
    assert "nobody answered a query yet" in refusal(rrmctl("report", "human", "--results", tmp_path / "runs"))
    (tmp_path / "empty").mkdir()
    assert "holds no experiment yet" in refusal(rrmctl("report", "human", "--results", tmp_path / "empty"))
    study(tmp_path / "torn", FIVE[:2], np.random.default_rng(0), queries=5)
    run = next(iter(Layout(tmp_path / "torn").run_ids()))
    Layout(tmp_path / "torn").run(run).labels.write_bytes(b"PAR1 torn")
    assert "cannot be read as labels" in refusal(rrmctl("report", "human", "--results", tmp_path / "torn"))


def test_people_of_another_study_stay_out(tmp_path):
    """Shared answers are of no run: they count with whoever answered a query of the section's runs."""
    study(tmp_path, FIVE[:2], np.random.default_rng(0), queries=10)
    extra = Layout(tmp_path).extra_labels
    write_labels(extra, [*read_labels(extra), label(purpose="shared", annotator="zoe")])
    assert "zoe" not in set(report_table("human", tmp_path, settings=QUICK)["annotator"])


def test_a_table_of_people_is_a_frame(results):
    """Counted columns may be missing beside other tables; shares are fractions."""
    whole = report_table("human", results, settings=QUICK)
    assert str(whole["answers"].dtype) == "Int64"
    assert whole["agreement"].dropna().between(0, 1).all()
    assert not re.search("nan", " ".join(map(str, whole["annotator"])))
    assert pd.api.types.is_float_dtype(whole["latency"])
