"""What stands on the page, without a browser."""

import html
import re
import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from markupsafe import escape
from matplotlib.figure import Figure
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.errors import UserError
from rrmctl.reports import run_facts
from rrmctl.reports.columns import TextGrid
from rrmctl.reports.figures import figures
from rrmctl.reports.page.assembly import build, render
from rrmctl.reports.page.chapter import MOST_BYTES, SEVERAL, gather, picture
from rrmctl.reports.page.listings import clock
from rrmctl.reports.page.parts import PageColumn, Part, Picture, Table, identifier
from rrmctl.reports.report import Report
from rrmctl.reports.select import read_sections
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables import kinds
from rrmctl.store.layout import Layout
from rrmctl.store.records import write_json
from rrmctl.store.snapshot import Snapshot
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, write_status
from tests.rrmctl.reports.frames import Sweep

REFERENCE = Path(__file__).parents[4] / "results" / "reference"
TASK = "button-press"
QUICK = Statistics(replicates=100)
NASTY = "<script>window.hit = 1</script>\"'&<img src=x onerror=window.hit=1>"


@pytest.fixture
def results(tmp_path):
    """Two methods in one variant; one run failed, one was never begun."""
    states = {(TASK, "pebble", 1): "failed", (TASK, "pebble", 4): "queued"}
    sweep = Sweep(states=states, lengths={(TASK, "pebble", 1): 2, (TASK, "pebble", 4): 0})
    root = tmp_path / "results"
    sweep.write(root)
    (failed,) = (run for run in Snapshot(root).runs() if run.plan["state"] == "failed")
    error = RunError(kind=ErrorKind.CRASHED, type="ValueError", message=NASTY)
    write_status(Layout(root).run(failed.id), Status(state=RunState.FAILED, step=200, steps=400, error=error))
    return root


def page(*arguments):
    return CliRunner().invoke(app, ["report", "html", *map(str, arguments)])


@pytest.mark.slow
def test_everything_of_the_reference_results_is_there():
    """Every experiment, table and figure that the data supports, every run; all of it below ten megabytes."""
    text = build(REFERENCE, settings=QUICK)
    assert len(text) < 10_000_000
    runs = Snapshot(REFERENCE).runs()
    assert all(run.id in text for run in runs)
    for section in read_sections(REFERENCE):
        name = identifier(section.experiment, section.variant)
        assert f'id="{name}"' in text
        drawn = [figure for figure, entry in figures().items() if entry.load().suits(section)]
        assert all(f'id="{name}-figure-{identifier(figure)}"' in text for figure in drawn)
        for kind, entry in kinds().items():
            try:
                made = entry.load().make([section], QUICK)
            except UserError:
                continue
            for report in made:
                table = identifier(report.facts.get("table", kind))
                assert f'id="{name}-{table}"' in text or f'id="common-{table}"' in text
            own = [report for report in made if report.facts["experiment"] == section.experiment]
            assert all(f"<li>{escape(note)}</li>" in text for report in own for note in report.notes)


@pytest.mark.slow
def test_every_link_leads_somewhere(results):
    """Ids are unique, and each link of the page names one."""
    text = build(results, settings=QUICK)
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    links = re.findall(r'href="([^"]*)"', text)
    assert {link.removeprefix("#") for link in links} <= set(ids)
    assert all(link.startswith("#") for link in links)


def test_nothing_is_loaded_from_elsewhere(results):
    """The page names no other file: pictures are inside, and its policy admits nothing else."""
    text = build(results, settings=QUICK)
    assert all(source.startswith("data:") for source in re.findall(r'\bsrc="([^"]*)"', text))
    assert "default-src 'none'" in html.unescape(text)
    assert "<link" not in text


@pytest.mark.slow
def test_equal_stores_give_equal_pages(results):
    """The page is a function of the store: nothing in it depends on the moment or on chance."""
    assert build(results, settings=QUICK) == build(results, settings=QUICK)


@pytest.mark.slow
def test_runs_that_are_not_done_are_told(results):
    """A failed run stands there with its reason, one that was never begun as such."""
    text = build(results, settings=QUICK)
    assert "15 planned runs: 13 done, 1 failed, 1 queued." in text
    assert "Not contained, failed: button-press, pebble (oracle, 50@5000/5000): seed 1." in text
    assert f"<pre>ValueError: {escape(NASTY)}</pre>" in text
    assert "<script>window" not in text


def test_a_plan_without_any_run_is_a_page(tmp_path):
    """Before the first evaluation the page tells the plan, and how to start it."""
    Sweep(curves={"pebble": [[]]}, states={(TASK, "pebble", 0): "queued"}).write(tmp_path)
    text = build(tmp_path, settings=QUICK)
    assert "1 planned runs: 1 queued." in text
    assert "No run can be shown yet." in text
    assert "rrmctl run main-results --profile laptop --tasks button-press --methods pebble --seeds 0," in text


@pytest.mark.slow
def test_runs_that_do_not_belong_together_are_listed(tmp_path):
    """Where nothing may be averaged the reason stands there instead; other experiments have tables."""
    Sweep(cells={(TASK, "pebble", 0): "0" * 16}).write(tmp_path)
    Sweep(experiment="toy-car", tasks=("toy-car",), variant="t").write(tmp_path)
    text = build(tmp_path, settings=QUICK)
    assert "different configurations and cannot be averaged" in text
    assert 'id="main-results-laptop-runs"' in text
    assert 'id="main-results-laptop-tables"' not in text
    assert 'id="toy-car-t-tables"' in text


@pytest.mark.slow
def test_the_command_writes_the_page(results, tmp_path):
    """`report html NAME -o FILE` writes one file, and says where and how large it is."""
    target = tmp_path / "new" / "page.html"
    ran = page("main-results", "--results", results, "-o", target, "--replicates", 100)
    assert ran.exit_code == 0, ran.output
    assert ran.stdout.strip() == f"{target}: {target.stat().st_size / 1e6:.1f} MB"
    assert target.read_text().startswith('<!doctype html>\n<html lang="en">')


@pytest.mark.slow
def test_a_store_without_experiments_says_what_to_run(tmp_path):
    """An empty folder, a name and a profile that are not there: one message, exit code 2."""
    ran = page("--results", tmp_path, "-o", tmp_path / "page.html")
    assert ran.exit_code == 2
    assert "rrmctl run quickstart" in ran.stderr
    Sweep().write(tmp_path)
    assert 'did you mean "main-results"' in page("main-result", "--results", tmp_path, "-o", tmp_path / "p").stderr
    assert "no runs of profile" in page("--profile", "paper", "--results", tmp_path, "-o", tmp_path / "p").stderr
    assert not (tmp_path / "p").exists()


@pytest.mark.slow
def test_a_place_that_takes_no_write_is_named(results, tmp_path):
    """An impossible `-o` is one message with exit code 2."""
    (tmp_path / "file").write_text("")
    ran = page("--results", results, "-o", tmp_path / "file" / "page.html", "--replicates", 100)
    assert ran.exit_code == 2
    assert "name another place with -o" in ran.stderr


def test_a_damaged_run_is_named(results):
    """A curve that cannot be read stops the page with the file's name."""
    (run, *_) = (run for run in Snapshot(results).runs() if run.plan["state"] == "done")
    Layout(results).run(run.id).curve.write_bytes(b"torn")
    with pytest.raises(UserError, match=run.id):
        build(results, settings=QUICK)


def test_what_was_spent_adds_up(results):
    """Steps, labels and time are those of the last evaluations; a run under two labels is counted once in the total."""
    runs = Snapshot(results).runs()
    table = run_facts.spending(runs)
    assert list(table["method"]) == ["oracle", "pebble", "rrm-proxy"]
    assert list(table["runs"]) == [5, 5, 5]
    assert list(table["steps"]) == [2000, 1400, 2000]
    assert run_facts.total([*runs, *runs])["steps"] == table["steps"].sum()


def test_settings_are_common_or_differ(results):
    """A setting that all share stands once; one that differs stands with each group of runs."""
    runs = Snapshot(results).runs()
    for run in runs:
        folder = Layout(results).run(run.id)
        write_json(folder.config, run.config | {"agent": {"batch": 64 if run.plan["method"] == "oracle" else 128}})
    runs = Snapshot(results).runs()
    common = dict(run_facts.common_settings(runs).itertuples(index=False))
    assert common["evaluation.success"] == '"any"'
    assert "agent.batch" not in common
    differing = run_facts.differing_settings(runs).set_index("method")
    assert dict(differing["agent.batch"]) == {"oracle": "64", "pebble": "128", "rrm-proxy": "128"}
    assert run_facts.differing_settings(runs[:1]).empty


def test_what_was_configured_before_there_was_a_choice(results):
    """A run without a device is on the processor; where no run has one, nothing is said of it."""
    runs = Snapshot(results).runs()
    assert "device" not in dict(run_facts.common_settings(runs).itertuples(index=False))
    on = {"oracle": {"device": "cpu"}, "pebble": {"device": "cuda"}, "rrm-proxy": {}}
    for run in runs:
        write_json(Layout(results).run(run.id).config, run.config | on[run.plan["method"]])
    differing = run_facts.differing_settings(Snapshot(results).runs()).set_index("method")
    assert dict(differing["device"]) == {"oracle": '"cpu"', "pebble": '"cuda"', "rrm-proxy": '"cpu"'}


def test_machines_and_versions_are_told_apart():
    """Runs that were started with the same are one column, and every run is counted."""
    runs = [run for run in Snapshot(REFERENCE).runs() if run.plan["experiment"] == "precision"]
    facts = run_facts.makings(runs).set_index("fact")
    assert sum(map(int, facts.loc["runs"])) == len({run.id for run in runs})
    assert set(facts.loc["precision"]) == {"float32", "bfloat16"}
    assert set(facts.loc["products"]) == {"torch"}
    assert run_facts.makings([]).empty


def test_a_figure_is_never_large():
    """A cloud of points becomes a small PNG; a drawing stays one of lines."""
    figure = Figure(figsize=(4, 3))
    figure.subplots().plot([0, 1], [0, 1])
    assert "data:image/svg+xml" in picture(figure, "a", "caption", "words").source
    figure = Figure(figsize=(4, 3))
    figure.subplots().scatter(*np.random.default_rng(0).normal(size=(2, 20_000)), s=1)
    made = picture(figure, "a", "caption", "words").source
    assert "data:image/png" in made
    assert len(made) < 1.4 * MOST_BYTES


def test_a_long_table_is_cut_and_says_so():
    """Beyond a number of rows the caption tells how many there are."""
    table = Table("Numbers", [PageColumn("A", "a", number=True)], [{"a": at} for at in range(2007)])
    made = render(Part(tables=[table]), "")
    assert made.count("<tr>") == 2001
    assert "the first 2,000 of 2,007 rows" in made


def test_a_cell_is_what_it_says():
    """Numbers stand with their exact value, what is missing without one; long words may break; the first cell heads."""
    shown = [PageColumn("A", "a"), PageColumn("B", "b", number=True, show="{:.1f}".format)]
    rows = [{"a": "short", "b": 0.25}, {"a": "long " * 9, "b": None, "link": "there"}, {"a": None, "b": float("nan")}]
    made = render(Part(tables=[Table("Cells", shown, rows, total={"a": "all", "b": np.float64(2)})]), "")
    cells = re.findall("<t[hd][^>]*>.*?</t[hd]>", made)[2:]
    number, missing = '<td class="number" data-value="{}">{}</td>'.format, '<td class="number">–</td>'
    assert cells[:2] == ['<th scope="row">short</th>', number(0.25, "0.2")]
    assert cells[2:4] == [f'<th scope="row" class="long"><a href="#there">{"long " * 9}</a></th>', missing]
    assert cells[4:] == ['<th scope="row">–</th>', missing, '<th scope="row">all</th>', number(2.0, "2.0")]


def test_whatever_the_page_shows_is_text():
    """What looks like code is shown as it is written, wherever it stands, in content and in attributes."""
    table = Table(NASTY, [PageColumn(NASTY, 0)], [[NASTY], {0: NASTY, "link": NASTY}], [NASTY], frozenset({(0, 0)}))
    inner = {"title": NASTY, "tables": [table], "notes": [NASTY], "rules": [NASTY], "commands": NASTY}
    figure = Picture(NASTY, NASTY, NASTY, 1, NASTY)
    texts = {"paragraphs": [NASTY], "warnings": [NASTY], "failures": [(NASTY, NASTY)], "figures": [NASTY, figure]}
    parts = [Part(**inner, id=id_, folded=folded) for id_ in ("", NASTY) for folded in (False, True)]
    made = render(Part(title=NASTY, parts=[*parts, Part(id=NASTY, **texts)], **texts), NASTY)
    everything = len(re.findall("window.hit = 1", made))
    assert everything > 70
    assert made.count(str(escape(NASTY))) == everything
    assert "safe" not in (resources.files("rrmctl.reports.page") / "page.html").read_text().replace("unsafe-inline", "")


def test_what_shows_nothing_is_left_out():
    """Neither on the page nor in its contents; the contents name what has a title and can be led to."""
    empty = Part(id="empty", title="Empty", parts=[Part(id="inner", title="Inner", tables=[Table("None", [], [])])])
    full = Part(
        id="full", title="Full", parts=[empty, Part(title="Within", notes=["told"]), Part(id="own", notes=["x"])]
    )
    made = render(Part(title="All", parts=[empty, full]), "")
    assert re.findall('href="#([^"]*)"', made) == ["overview", "full"]
    assert "Empty" not in made
    assert "<h3>Within</h3>" in made


def test_an_identifier_can_stand_in_a_link():
    """Letters, digits and dashes; other signs as their code."""
    assert identifier("a b", "c<d") == "a-b-c-3c-d"


TIMES = [(0, "0 s"), (59.6, "1 min 00 s"), (185, "3 min 05 s"), (7620, "2 h 07 min"), (1_047_600, "12 d 03 h")]


@pytest.mark.parametrize(("seconds", "told"), TIMES)
def test_times_are_told_for_people(seconds, told):
    """Two units, the larger one first."""
    assert told == clock(seconds)


@pytest.mark.slow
def test_a_page_of_reference_results_can_be_made_anywhere(tmp_path):
    """The store is only read: a copy without permission to write gives the page."""
    shutil.copytree(REFERENCE, tmp_path / "reference")
    before = sorted(path.stat().st_mtime_ns for path in (tmp_path / "reference").rglob("*"))
    build(tmp_path / "reference", ["toy-car"], settings=QUICK)
    assert before == sorted(path.stat().st_mtime_ns for path in (tmp_path / "reference").rglob("*"))


class Kind:
    """A stand-in for a kind of table: `make` with a name."""

    help = "A table."

    def __init__(self, make):
        self.make = make

    def load(self):
        return self


def report(section, name=""):
    facts = {"experiment": name or section.experiment, "variant": section.variant}
    return Report(section.experiment, pd.DataFrame(), TextGrid(("A",), (("1",),)), ("note",), facts)


def refuse(sections, settings):
    if any(section.experiment == "toy-car" for section in sections):
        raise UserError("no toys")
    return [report(section) for section in sections]


def nothing(sections, settings):
    raise UserError("nothing at all")


def test_tables_stand_where_they_belong(tmp_path, monkeypatch):
    """A chapter's own stand in it, one of several experiments before all, a refused one not, and `all` is none."""
    Sweep().write(tmp_path)
    Sweep(experiment="toy-car", tasks=("toy-car",), variant="t").write(tmp_path)
    known = {
        "all": Kind(lambda sections, settings: pytest.fail("every table is made twice")),
        "own": Kind(lambda sections, settings: [report(each) for each in sections]),
        "both": Kind(lambda sections, settings: [report(sections[0], "claims")]),
        "choosy": Kind(refuse),
        "none": Kind(nothing),
    }
    monkeypatch.setattr("rrmctl.reports.page.chapter.kinds", lambda: known)
    found = gather(read_sections(tmp_path), QUICK)
    kinds_at = {place: [kind for kind, _ in made] for place, made in found.made.items()}
    first, second = ("main-results", "laptop"), ("toy-car", "t")
    assert kinds_at == {first: ["own", "choosy"], second: ["own"], SEVERAL: ["both"]}
    assert found.refused == {second: {"choosy": "no toys"}, SEVERAL: {"none": "nothing at all"}}


@pytest.mark.slow
def test_the_command_of_the_page_makes_it_again(tmp_path):
    """What it was made with stands on it, as far as that is not the default."""
    Sweep().write(tmp_path)
    options = ("--results", str(tmp_path), "--profile", "laptop", "--iqm", "exact", "--replicates", "100")
    assert page(*options, "--allow-mixed", "-o", tmp_path / "page.html").exit_code == 0
    told = " ".join(("rrmctl report html", *options, "--allow-mixed"))
    assert f"<code>{told}</code>" in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_each_variant_has_its_own_reason(tmp_path):
    """Mixed runs of one profile are listed with the reason in their chapter; the other's tables are there."""
    Sweep(versions={(TASK, "pebble", seed): 1 for seed in range(5)}).write(tmp_path)
    Sweep(profile="paper", variant="paper").write(tmp_path)
    assert page("--results", tmp_path, "-o", tmp_path / "page.html", "--replicates", 100).exit_code == 0
    text = (tmp_path / "page.html").read_text()
    assert text.count("Its runs cannot be shown together") == 1
    assert 'id="main-results-paper-iqm"' in text
    assert 'id="main-results-laptop-iqm"' not in text


@pytest.mark.slow
def test_mixed_versions_are_shown_when_asked_for(tmp_path):
    """Runs of two configuration versions are listed with the reason; `--allow-mixed` shows them together, marked."""
    Sweep(versions={(TASK, "pebble", seed): 1 for seed in range(5)}).write(tmp_path)
    options = ("--results", tmp_path, "-o", tmp_path / "page.html", "--replicates", 100)
    assert page(*options).exit_code == 0
    text = (tmp_path / "page.html").read_text()
    assert "configuration version is 1 in 5 runs" in text
    assert 'id="main-results-laptop-iqm"' not in text
    assert page(*options, "--allow-mixed").exit_code == 0
    text = (tmp_path / "page.html").read_text()
    assert "MIXED: " in text
    assert 'id="main-results-laptop-iqm"' in text
