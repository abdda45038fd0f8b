"""The page in a real browser, opened from disk."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.reports.dataframes import report_table
from rrmctl.reports.page.assembly import build
from rrmctl.reports.statistics import Statistics
from rrmctl.store.layout import Layout
from rrmctl.store.snapshot import Snapshot
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, write_status
from tests.browser import browser
from tests.rrmctl.reports.frames import RISING, Sweep

pytestmark = pytest.mark.slow

REFERENCE = Path(__file__).parents[4] / "results" / "reference"
TASK = "button-press"
NASTY = "<script>window.hit=1</script><img src=x onerror=window.hit=1>\"'>"
METHOD = "m<script>window.hit=1</script>"
#: The planned runs, by their heading.
RUNS = "#main-results-laptop-runs table"


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A page with a failed run, one that was never begun, a task without success, and names that are code."""
    folder = tmp_path_factory.mktemp("page")
    states = {(TASK, "pebble", 1): "failed", (TASK, "pebble", 4): "queued"}
    curves = RISING | {METHOD: [[0.0, 0.25]]}
    Sweep(
        curves=curves, tasks=(TASK, "walker-walk"), states=states,
        lengths={(TASK, "pebble", 1): 2, (TASK, "pebble", 4): 0}, overrides={"note": NASTY},
    ).write(folder)  # fmt: skip
    for run in Snapshot(folder).runs():
        if run.plan["state"] == "failed":
            error = RunError(kind=ErrorKind.CRASHED, type="ValueError", message=NASTY)
            write_status(Layout(folder).run(run.id), Status(state=RunState.FAILED, step=200, steps=400, error=error))
    target = folder / "report.html"
    ran = CliRunner().invoke(
        app, ["report", "html", "--results", str(folder), "-o", str(target), "--replicates", "100"]
    )
    assert ran.exit_code == 0, ran.output
    return target


@pytest.fixture(scope="module")
def running():
    with browser() as found:
        yield found


@pytest.fixture
def page(running, path):
    """The page, opened; afterwards nothing may have gone wrong, been asked for, or run that is not its own."""
    opened = running.new_page(viewport={"width": 1280, "height": 900})
    opened.set_default_timeout(120_000)
    wrong, asked = [], []
    opened.on("console", lambda message: wrong.append(message.text))
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.on("request", lambda request: asked.append(request.url))
    opened.goto(path.as_uri())
    unfold(opened)
    yield opened
    assert wrong == []
    assert {url for url in asked if not url.startswith("data:")} == {path.as_uri()}
    assert opened.evaluate("window.hit") is None
    opened.close()


def unfold(page):
    page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true })")


def column(page, name, table=RUNS):
    """The texts of a column of a table's body."""
    heads = page.locator(f"{table} thead th").all_inner_texts()
    at = [head.strip() for head in heads].index(name) + 1
    return [text.strip() for text in page.locator(f"{table} tbody tr > :nth-child({at})").all_inner_texts()]


def press(page, name, table=RUNS):
    page.locator(f"{table} thead button", has_text=name).first.click()


def test_it_opens_and_is_what_it_says(page):
    """Title, language, one main heading, every picture drawn, every table captioned, nothing wider than the window."""
    assert page.title() == "Report: main-results"
    assert page.locator("html").get_attribute("lang") == "en"
    assert page.locator("h1").count() == 1
    assert page.locator("table").count() == page.locator("table > caption").count() > 4
    assert page.locator("thead th:not([scope=col])").count() == 0
    assert page.locator("tbody tr > :first-child:not(th[scope=row])").count() == 0
    assert page.locator("img").count() > 0
    assert page.evaluate("[...document.images].every((image) => image.naturalWidth > 0 && image.alt)")
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_names_and_messages_are_text(page):
    """What looks like code in a method's name, a setting or an error is shown, and does not run."""
    assert METHOD in column(page, "Method")
    assert NASTY in page.locator("#main-results-laptop-failures").inner_text()
    assert NASTY in page.locator("h2", has_text="main-results").inner_text()


def test_numbers_sort_both_ways_and_the_missing_stay_last(page):
    """A press sorts numbers as numbers, a second one turns them round; what is missing is last in both."""
    press(page, "Success")
    rising = column(page, "Success")
    present = [int(text.removesuffix("%")) for text in rising if text != "–"]
    assert present == sorted(present)
    assert present != sorted(present, key=str)
    missing = len(rising) - len(present)
    assert rising[-missing:] == ["–"] * missing
    press(page, "Success")
    falling = column(page, "Success")
    assert [int(text.removesuffix("%")) for text in falling if text != "–"] == present[::-1]
    assert falling[-missing:] == ["–"] * missing
    assert page.locator(f"{RUNS} th[aria-sort]").count() == 1
    assert page.locator(f"{RUNS} th[aria-sort=descending]").inner_text().startswith("Success")


def test_words_sort_and_rows_stay_whole(page):
    """Sorting moves rows, not cells: every run keeps its method."""
    before = dict(zip(column(page, "Run"), column(page, "Method"), strict=True))
    press(page, "Method")
    assert column(page, "Method") == sorted(column(page, "Method"))
    assert dict(zip(column(page, "Run"), column(page, "Method"), strict=True)) == before


def test_numbers_with_signs_sort_as_numbers(page):
    """In a report's table thousands, percents, intervals and `n < 3` are read as what they mean."""
    table = "#main-results-laptop-iqm table"
    press(page, "IQM", table)
    values = [float(text.removesuffix(" %").replace(",", "")) for text in column(page, "IQM", table)]
    assert values == sorted(values)
    press(page, "95 % interval", table)
    intervals = column(page, "95 % interval", table)
    lows = [float(text[1:].split(", ")[0]) for text in intervals if text.startswith("[")]
    assert lows == sorted(lows)
    assert intervals[len(lows) :] == ["n < 3"] * (len(intervals) - len(lows))
    assert "n < 3" in intervals


def test_words_among_the_numbers_sort_as_words(page):
    """A column that is set like numbers and holds words alone is sorted by them."""
    cells = f"{RUNS} tbody tr > :nth-child(6)"
    change = "cells => cells.forEach((cell, at) => { cell.textContent = 'cab'[at % 3]; delete cell.dataset.value })"
    page.eval_on_selector_all(cells, change)
    press(page, "Seed")
    words = column(page, "Seed")
    assert words == sorted(words)
    assert set(words) == {"a", "b", "c"}


def test_tables_sort_from_the_keyboard(page):
    """A heading is a button: Enter on it sorts."""
    page.locator(f"{RUNS} thead button", has_text="Seed").focus()
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")
    seeds = [int(text) for text in column(page, "Seed")]
    assert seeds == sorted(seeds, reverse=True)


def test_a_figure_enlarges_and_escape_closes_it(page):
    """A press fills the window with the figure, another one goes closer, Escape leaves and gives the focus back."""
    button = page.locator(".zoom").first
    before = button.bounding_box()["width"]
    button.focus()
    page.keyboard.press("Enter")
    image = page.locator("dialog[open] img")
    first = image.bounding_box()["width"]
    assert first > 1.5 * before
    image.click()
    assert page.locator("dialog[open] img").bounding_box()["width"] > 1.5 * first
    page.keyboard.press("Escape")
    page.locator("dialog img").wait_for(state="detached")
    assert page.locator("dialog[open]").count() == 0
    assert page.evaluate("document.activeElement === document.querySelector('.zoom')")
    button.click()
    page.locator("dialog button").click()
    assert page.locator("dialog[open]").count() == 0


def test_it_prints(page):
    """On paper there are pages, with the contents open, and no table is wider than its sheet."""
    data = page.pdf(prefer_css_page_size=True)
    assert data.startswith(b"%PDF")
    assert data.count(b"/Type /Page\n") > 2
    page.emulate_media(media="print")
    for selector, millimetres in ((".wide table", 273), (".scroll:not(.wide) table", 186)):
        page.set_viewport_size({"width": round(millimetres / 25.4 * 96), "height": 900})
        widths = page.eval_on_selector_all(selector, "tables => tables.map((table) => table.offsetWidth)")
        assert widths
        assert max(widths) <= page.viewport_size["width"]


@pytest.fixture(scope="module")
def of_reference(tmp_path_factory):
    target = tmp_path_factory.mktemp("reference") / "report.html"
    target.write_text(build(REFERENCE, settings=Statistics(replicates=100)))
    return target


@pytest.fixture
def reference(running, of_reference):
    """The page of the reference results, as it opens."""
    opened = running.new_page(viewport={"width": 1280, "height": 900}, reduced_motion="reduce")
    opened.goto(of_reference.as_uri())
    yield opened
    opened.close()


def test_it_begins_with_what_there_is(reference):
    """How complete the study is, figures and the main table; then claims that are decided, the others folded."""
    shown = "[...document.querySelectorAll('main > section')].map((each) => each.id)"
    ids = reference.evaluate(shown)
    assert ids[0] == "overview"
    assert ids[-1] == "common-tables"
    store = Snapshot(REFERENCE)
    planned = {run.id: run.plan["state"] for run in (*store.runs(), *store.runs(needed=True))}
    done = sum(state == "done" for state in planned.values())
    assert f"{done} of {len(planned)} planned runs are done." in reference.locator("#overview").inner_text()
    assert reference.locator("#overview ~ section .zoom img").first.bounding_box()["y"] < 900
    chapter = "#main-results-laptop"
    parts = reference.evaluate(f"[...document.querySelectorAll('{chapter} > section')].map((each) => each.id)")
    assert parts == [f"main-results-laptop-{name}" for name in ("figures", "tables")]
    assert reference.locator(f"{chapter}-tables table").first.evaluate("(table) => table.closest('[id]').id") == (
        "main-results-laptop-iqm"
    )
    told = reference.locator("#common-tables")
    undecided = told.locator("details", has_text="claims: not enough data")
    assert not undecided.locator("table").is_visible()
    verdicts = report_table("claims", REFERENCE).drop_duplicates("claim")["verdict"]
    count = int((~verdicts.str.startswith("not enough data")).sum())
    assert f"{count} of {len(verdicts)} claims are decided by these runs." in told.inner_text()
    decided = told.locator(":scope > div > .scroll tbody")
    assert (decided.locator("tr").count(), "not enough data" in " ".join(decided.all_inner_texts())) == (count, False)
    undecided.locator("summary").click()
    assert undecided.locator("table").is_visible()
    assert reference.locator("main details[open]").count() == 1


def test_a_link_unfolds_what_it_leads_to(reference):
    """The runs of a chapter are folded; their line of the contents shows them."""
    runs = reference.locator("#main-results-laptop-runs table").first
    assert not runs.is_visible()
    reference.locator("nav a[href='#main-results-laptop-runs']").click()
    runs.wait_for(state="visible")


@pytest.mark.parametrize("width", [1280, 390])
def test_nothing_is_cut_off(reference, width):
    """At a desk and on a telephone the page is as wide as the window; what is wider scrolls within itself."""
    reference.set_viewport_size({"width": width, "height": 900})
    unfold(reference)
    assert reference.evaluate("document.documentElement.scrollWidth") == width
    beyond = """[...document.querySelectorAll('main *')].filter((each) => !each.closest('.scroll')
        && each.getBoundingClientRect().right > window.innerWidth).map((each) => each.outerHTML.slice(0, 80))"""
    assert reference.evaluate(beyond) == []
    hidden = """[...document.querySelectorAll('main .scroll')]
        .filter((each) => each.scrollWidth > each.clientWidth && getComputedStyle(each).overflowX !== 'auto').length"""
    assert reference.evaluate(hidden) == 0


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_is_read_on_a_telephone(page, scheme):
    """On a narrow window the page itself does not scroll sideways, contents are folded, ink stands out."""
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": 390, "height": 844})
    page.reload()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.locator("nav details[open]").count() == 0
    ink, paper = (page.evaluate(f"getComputedStyle(document.body).{name}") for name in ("color", "backgroundColor"))
    light, dark = (sum(map(int, text[4:-1].split(", "))) for text in (ink, paper))
    assert (light > dark + 400) == (scheme == "dark")
    assert abs(light - dark) > 400


def test_a_script_that_slipped_in_does_not_run(running, path, tmp_path):
    """Even one that stands in the file is refused by the page's policy, which admits its own script alone."""
    text = path.read_text().replace("</main>", "<p id=slipped>in</p><script>window.hit = 1</script></main>")
    (tmp_path / "page.html").write_text(text)
    opened = running.new_page()
    opened.goto((tmp_path / "page.html").as_uri())
    unfold(opened)
    assert opened.locator("#slipped").inner_text() == "in"
    assert opened.evaluate("window.hit") is None
    opened.locator(f"{RUNS} thead button").first.click()
    assert opened.locator(f"{RUNS} th[aria-sort]").count() == 1
    opened.close()
