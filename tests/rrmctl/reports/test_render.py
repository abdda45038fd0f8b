import csv
import io
import json
from pathlib import Path

import pandas as pd
import pytest

from rrmctl.reports.render import FORMATS, print_terminal, to_text
from rrmctl.reports.report import EXPLAINED
from rrmctl.reports.select import sections
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables import kinds
from rrmctl.reports.tables.iqm import make
from rrmctl.terminal import console
from tests.rrmctl.reports.frames import RISING, Sweep

GOLDEN = Path(__file__).with_name("golden")


def made(*sweeps: Sweep, **settings):
    """Reports of all these sweeps as of one store."""
    rows, jobs = (pd.concat(pair, ignore_index=True) for pair in zip(*(s.frames() for s in sweeps), strict=True))
    evaluation = {cell: told for sweep in sweeps for cell, told in sweep.evaluation().items()}
    return make(sections(rows, jobs, evaluation=evaluation), Statistics(replicates=1000, **settings))


RAGGED = Sweep(
    tasks=("button-press", "door-open", "walker-walk"),
    overrides={"agent.batch": 64},
    states={("door-open", "pebble", 1): "failed", ("walker-walk", "oracle", 4): "queued"},
    lengths={("walker-walk", "oracle", 4): 0},
)
SMOKE = Sweep(
    curves={m: [[0.0, 0.1]] for m in RISING}, tasks=("button-press",), experiment="toy", profile="smoke", variant="b"
)


@pytest.mark.parametrize(("form", "suffix"), [("markdown", "md"), ("latex", "tex"), ("terminal", "txt")])
def test_text_is_as_recorded(form, suffix):
    """Two variants, ragged and failed runs, one seed: the text is that of the golden file, to the byte."""
    assert to_text(made(RAGGED, SMOKE), form) == (GOLDEN / f"iqm.{suffix}").read_text(encoding="utf-8")


def test_csv_is_as_recorded():
    """Columns and values of the CSV are those of the golden file, but for the last digits of a processor's sums."""
    found = pd.read_csv(io.StringIO(to_text(made(RAGGED, SMOKE), "csv")))
    pd.testing.assert_frame_equal(found, pd.read_csv(GOLDEN / "iqm.csv"), rtol=1e-9)


def test_json_is_as_recorded():
    """Keys and values of the JSON are those of the golden file, but for the last digits of a processor's sums."""

    def rounded(text):
        return json.loads(text, parse_float=lambda digits: round(float(digits), 9))

    assert rounded(to_text(made(RAGGED, SMOKE), "json")) == rounded((GOLDEN / "iqm.json").read_text(encoding="utf-8"))


def test_people_read_percent_and_programs_fractions():
    """Markdown prints 100.0 %, CSV and JSON hold 1.0."""
    found = made(Sweep())
    assert "| rrm-proxy | 300 | **100.0 %** |" in to_text(found, "markdown")
    rows = list(csv.DictReader(io.StringIO(to_text(found, "csv"))))
    assert float(rows[2]["iqm"]) == 1.0
    assert json.loads(to_text(found, "json"))["reports"][0]["rows"][2]["iqm"] == 1.0


def test_every_format_says_what_it_holds():
    """Profile, absent runs and an unusual IQM or number of replicates are in every format; all else in csv and json."""
    for form in FORMATS:
        text = to_text(made(RAGGED, kind="exact"), form)
        machine = ("1000", "stratified", "10 episodes") if form in ("csv", "json") else ("1,000 replicates",)
        for word in ("laptop", "exact", "failed", *machine):
            assert word in text, (form, word)


def test_notes_are_what_is_particular_to_a_table():
    """Where all runs are there, seeds are enough and nothing is unusual, a table has one note; else what is unusual."""
    enough = {method: seeds * 2 for method, seeds in RISING.items()}
    rows, jobs = Sweep(curves=enough).frames()
    usual = {cell: {"success": "any", "deterministic": True} for cell in jobs["cell"]}
    (report,) = make(sections(rows, jobs, evaluation=usual), Statistics())
    assert report.notes == ("button-press is read where 80 % of the seeds of rrm-proxy are at 100 % first.",)
    odd = {cell: {"success": "last", "deterministic": False} for cell in jobs["cell"]}
    (report,) = make(sections(rows[rows["seed"] < 3], jobs, evaluation=odd), Statistics(kind="exact", replicates=100))
    told = "\n".join(report.notes)
    for word in ("9 of 30 planned runs.", "exact", "100 replicates", "71-76 % with 3", "sampled actions"):
        assert word in told, word


def test_what_is_said_once_is_said_by_explain():
    """No note of any table is among what `report explain` says of all or of this one; each kind says something."""
    for name, entry in kinds().items():
        assert name == "all" or entry.load().EXPLAINED, name
    always = {*EXPLAINED, *(sentence for entry in kinds().values() for sentence in entry.load().EXPLAINED)}
    assert not always & {note for report in made(RAGGED, SMOKE) for note in report.notes}
    assert to_text(made(RAGGED, SMOKE), "terminal").count("rrmctl report explain") == 1


def test_smoke_is_never_shown_as_results():
    """The title of a smoke report says what its numbers are worth."""
    (report,) = made(SMOKE)
    assert report.title == "toy · profile smoke (machinery only, not results)"


def test_variants_have_tables_of_their_own():
    """Two variants are two titled tables; no row holds runs of both."""
    first, second = made(Sweep(), Sweep(variant="b", overrides={"agent.batch": 64}))
    assert first.title != second.title
    assert "agent.batch=64" in second.title
    assert (first.table["planned"] == 5).all()


def test_teachers_and_schedules_are_named_where_they_differ():
    """The feedback column appears where a task was run under two schedules, and not otherwise."""
    both = Sweep(curves={"pebble": RISING["pebble"]}), Sweep(curves={"pebble": RISING["pebble"]}, feedback="5@5000/500")
    rows, jobs = (pd.concat(pair, ignore_index=True) for pair in zip(*(s.frames() for s in both), strict=True))
    halves = [table["feedback"] == "5@5000/500" for table in (rows, jobs)]
    rows, jobs = (
        table.assign(run=table["run"] + half.astype(str)) for table, half in zip((rows, jobs), halves, strict=True)
    )
    header = to_text(make(sections(rows, jobs), Statistics(replicates=100)), "markdown").splitlines()[2]
    assert "Feedback" in header
    assert "Feedback" not in to_text(made(Sweep()), "markdown").splitlines()[2]


def test_a_section_without_runs_is_only_words():
    """A variant that has not started prints no table and says what is missing."""
    keys = [("button-press", method, 0) for method in RISING]
    waiting = Sweep(curves=SMOKE.curves, states=dict.fromkeys(keys, "queued"), lengths=dict.fromkeys(keys, 0))
    text = to_text(made(Sweep(variant="b"), waiting), "terminal")
    assert "0 of 3 planned runs" in text
    assert "Not contained, queued: button-press, oracle: seed 0" in text


@pytest.mark.parametrize("width", [80, 120, 200])
def test_a_narrow_terminal_loses_nothing(width):
    """Cells are folded at the width of the terminal, never cut off, and no line is longer."""
    file = io.StringIO()
    print_terminal(made(Sweep()), console(file, width=width))
    text = file.getvalue()
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    assert text.count("[93.3, 100.0]") == 1


def test_latex_has_no_bare_signs():
    """Signs that mean something to TeX are escaped in cells, captions and notes."""
    text = to_text(made(Sweep(overrides={"a_b": "50%&#"})), "latex")
    lines = [line for line in text.splitlines() if not line.startswith("% ")]
    assert r"a\_b=50\%\&\#" in text
    assert not [line for line in lines if "%" in line.removesuffix("{%").replace(r"\%", "")]


def test_json_has_null_for_what_is_missing():
    """NaN is no JSON; a missing interval is null."""
    document = json.loads(to_text(made(SMOKE), "json"), parse_constant=pytest.fail)
    (report,) = document["reports"]
    assert document["schema_version"] == 3
    assert {row["low"] for row in report["rows"]} == {None}
