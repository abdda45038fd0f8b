import json
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.reports.tables import kinds
from rrmctl.store.layout import Layout
from tests.rrmctl.reports import scenes
from tests.rrmctl.reports.frames import Sweep


@pytest.fixture
def results(tmp_path):
    root = tmp_path / "results"
    Sweep(states={("button-press", "pebble", 1): "failed"}).write(root)
    return root


def rrmctl(*arguments):
    return CliRunner().invoke(app, [str(each) for each in arguments])


def test_the_table_is_printed(results):
    """`report iqm NAME` prints the table and exits with 0."""
    ran = rrmctl("report", "iqm", "main-results", "--results", results, "--replicates", 200)
    assert ran.exit_code == 0
    assert "main-results · profile laptop" in ran.stdout
    assert "14 of 15 planned runs" in ran.stdout


@pytest.mark.slow
def test_explain_says_once_what_every_table_means(results):
    """`report explain` tells of every table and of one, needs no results, and refuses a table that is not there."""
    whole, one = rrmctl("report", "explain"), rrmctl("report", "explain", "power")
    assert (whole.exit_code, one.exit_code) == (0, 0)
    assert all(text in whole.stdout for text in ("claims\n", "power\n", "all tables\n", "bootstrap over seeds"))
    assert "permutation test" in one.stdout
    assert "claims\n" not in one.stdout
    table = rrmctl("report", "iqm", "main-results", "--results", results, "--replicates", 200).stdout
    assert "bootstrap over seeds" not in table
    wrong = rrmctl("report", "explain", "powr")
    assert wrong.exit_code == 2
    assert 'did you mean "power"?' in wrong.stderr


def test_without_a_name_every_experiment_is_reported(results):
    """`report iqm` alone reports all that the store holds."""
    Sweep(experiment="toy-car", tasks=("toy-car",), variant="t").write(results)
    ran = rrmctl("report", "iqm", "--results", results, "--format", "json", "--replicates", 100)
    assert [report["experiment"] for report in json.loads(ran.stdout)["reports"]] == ["main-results", "toy-car"]


def test_a_profile_can_be_singled_out(results):
    """`--profile` leaves the other profiles out of the table."""
    Sweep(profile="smoke", variant="smoke").write(results)
    options = ("--results", results, "--format", "json", "--replicates", 100)
    ran = rrmctl("report", "iqm", "main-results", "--profile", "smoke", *options)
    assert [report["profile"] for report in json.loads(ran.stdout)["reports"]] == ["smoke"]


@pytest.mark.slow
def test_a_file_takes_the_place_of_the_terminal(results, tmp_path):
    """`-o` writes the whole file, makes its folder and prints nothing."""
    target = tmp_path / "new" / "table.md"
    options = ("--results", results, "--format", "markdown", "-o", target, "--replicates", 100)
    ran = rrmctl("report", "iqm", "main-results", *options)
    assert (ran.exit_code, ran.stdout) == (0, "")
    assert target.read_text().startswith("### main-results · profile laptop")
    assert [path.name for path in target.parent.iterdir()] == ["table.md"]


def test_no_colour_where_nobody_looks(results):
    """Piped output has no escape sequences and is not cut off."""
    ran = rrmctl("report", "iqm", "main-results", "--results", results, "--replicates", 100)
    assert "\x1b" not in ran.stdout
    assert "…" not in ran.stdout


def test_an_unknown_experiment_is_answered_with_the_nearest(results):
    """A misspelt name is one message, exit code 2 and no traceback."""
    for command in (("report", "iqm"), ("plot",)):
        ran = rrmctl(*command, "main-result", "--results", results)
        assert ran.exit_code == 2
        assert 'did you mean "main-results"' in ran.stderr
        assert "Traceback" not in ran.stderr


def test_an_empty_store_says_what_to_run(tmp_path):
    """Reporting before running exits with 2 and names the command that comes first."""
    ran = rrmctl("report", "iqm", "--results", tmp_path)
    assert ran.exit_code == 2
    assert "rrmctl run quickstart" in ran.stderr


@pytest.mark.slow
def test_a_place_that_takes_no_write_is_named(results, tmp_path):
    """An impossible `-o` is one message with exit code 2."""
    blocker = tmp_path / "file"
    blocker.write_text("")
    for command in (("report", "iqm", "main-results", "--replicates", 100), ("plot", "main-results")):
        ran = rrmctl(*command, "--results", results, "-o", blocker / "table")
        assert ran.exit_code == 2
        assert str(blocker) in ran.stderr


def everything(folder):
    """Every file and folder below this one, with content and time of its last change."""
    return {path: (path.read_bytes() if path.is_file() else b"", path.stat().st_mtime_ns) for path in folder.rglob("*")}


@pytest.mark.slow
def test_reading_commands_change_nothing(results, tmp_path):
    """Not a byte and not a time of change below the results folder, whatever reads it."""
    run = Layout(results).run_ids()[0]
    before = everything(results)
    for words in (
        ("report", "iqm", "main-results", "--iqm", "exact"), ("report", "all"), ("report", "power", "main-results"),
        ("report", "html", "-o", tmp_path / "page.html"), ("plot", "main-results", "-o", tmp_path / "figures"),
        ("export", "main-results", "--to", "csv", "-o", tmp_path / "csv"), ("status",), ("status", "--failed"),
        ("show", run), ("plan", "main-results", "--profile", "laptop"),
    ):  # fmt: skip
        quick = ("--replicates", 100) if words[0] in ("report", "plot") else ()
        ran = rrmctl(*words, "--results", results, *quick)
        assert ran.exit_code == 0, (words, ran.stderr)
        assert everything(results) == before, words


@pytest.mark.slow
def test_what_is_written_again_with_the_same_content_is_left_alone(results, tmp_path):
    """Figures, tables, pages and exports of equal results: the files keep their bytes and their times of change."""
    commands = (
        ("report", "all", "--format", "latex", "-o", tmp_path / "out/all.tex", "--replicates", 100),
        ("report", "html", "-o", tmp_path / "out/page.html", "--replicates", 100),
        ("plot", "main-results", "--figure", "curves", "-o", tmp_path / "out/figures"),
        ("export", "main-results", "--to", "csv", "-o", tmp_path / "out/csv"),
        ("export", "main-results", "--to", "tensorboard", "-o", tmp_path / "out/board"),
    )

    def written():
        for words in commands:
            ran = rrmctl(*words, "--results", results)
            assert ran.exit_code == 0, ran.stderr
        return everything(tmp_path / "out")

    assert written() == written()


@pytest.mark.slow
def test_the_last_evaluations_take_the_place_of_one(results, tmp_path):
    """`--final mean-K` reaches every form of every table, the page, which names it, and figures of other names;
    `--final last` changes nothing.
    """
    quick, words = ("--results", results, "--replicates", 100), "mean of the last 2 evaluations"
    for form in ("terminal", "markdown", "latex", "csv", "json"):
        usual, last, mean = (
            rrmctl("report", "final", "main-results", *quick, "--format", form, *final).stdout
            for final in ((), ("--final", "last"), ("--final", "mean-2"))
        )
        assert usual == last != mean
        assert words in mean
        assert "score_at_step" not in usual
        assert words not in usual
    rows = {row["method"]: row for row in json.loads(mean)["reports"][0]["rows"]}
    assert rows["pebble"]["iqm"] == pytest.approx(0.6)  # seed 1 failed; of 0.7, 0.85, 0.5, 0.25
    for kind in kinds():  # none of them refuses it
        ran = rrmctl("report", kind, "main-results", *quick, "--final", "mean-2")
        assert "--final" not in ran.stderr, kind
    page = tmp_path / "page.html"
    assert rrmctl("report", "html", *quick, "-o", page, "--final", "mean-2").exit_code == 0
    assert f"{words} up to it" in page.read_text()
    assert "--final mean-2" in page.read_text()
    names = []
    for final in ((), ("--final", "mean-2")):
        names += rrmctl("plot", "main-results", *quick, "--format", "svg", "-o", tmp_path, *final).stdout.split()
    assert len({*names}) == len(names) == 6
    assert f"{tmp_path}/main-results-laptop-mean-2.svg" in names


@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["mean-0", "mean--1", "mean-", "mean-2.5", "5", "first", "", "mean-٣", "mean-5\n"])
def test_no_number_of_evaluations_is_refused(results, wrong):
    """One message that says what is expected, exit code 2; tables, page and figures alike."""
    for command in (("report", "iqm", "main-results"), ("report", "html"), ("plot", "main-results")):
        ran = rrmctl(*command, "--results", results, "--final", wrong)
        assert ran.exit_code == 2
        assert ran.stderr.startswith(f"error: --final {wrong!r}: expected last or mean-K")
        assert "Traceback" not in ran.stderr
    assert not (results / "figures").exists()


@pytest.mark.slow
def test_figures_are_written_and_named(results):
    """`plot` writes every figure that suits as PNG, PDF and SVG below the results and prints their paths."""
    ran = rrmctl("plot", "main-results", "--results", results, "--replicates", 100)
    stems = ("main-results-laptop-box", "main-results-laptop", "main-results-laptop-profile")
    paths = [results / "figures" / f"{stem}.{suffix}" for stem in stems for suffix in ("png", "pdf", "svg")]
    assert ran.stdout.split() == [str(path) for path in paths]
    assert [path.read_bytes()[:4] for path in paths] == [b"\x89PNG", b"%PDF", b"<?xm"] * 3


def test_figure_form_and_width_can_be_chosen(results):
    """`--figure`, `--format` and `--width` leave one file, which is named after a width that is not a page's."""
    options = ("--figure", "box", "--format", "svg", "--width", "column")
    ran = rrmctl("plot", "main-results", "--results", results, *options)
    (path,) = (results / "figures").iterdir()
    assert ran.stdout.split() == [str(path)]
    assert path.name == "main-results-laptop-box-column.svg"
    assert f'width="{3.3 * 72:g}pt"' in path.read_text()


def test_a_figure_that_does_not_suit_is_named(results):
    """A figure that is asked for by name and has nothing to show is a note, one that does not exist an error."""
    ran = rrmctl("plot", "main-results", "--results", results, "--figure", "diagnostics")
    assert (ran.exit_code, ran.stdout) == (0, "")
    assert "nothing to draw in the figure diagnostics" in ran.stderr
    unknown = rrmctl("plot", "main-results", "--results", results, "--figure", "boxes")
    assert unknown.exit_code == 2
    assert 'did you mean "box"' in unknown.stderr


@pytest.mark.slow
def test_a_figure_that_cannot_be_drawn_keeps_no_other_back(tmp_path):
    """A damaged file costs its own figure, which is said; asked for by name it is an error."""
    sweep = scenes.finetune()
    sweep.write(tmp_path)
    folder = Layout(tmp_path).run(sweep.jobs()["run"].iloc[0])
    folder.gradients.write_bytes(b"no parquet")
    options = ("finetune", "--results", tmp_path, "--format", "svg", "--replicates", 100)
    drawn = rrmctl("plot", *options)
    assert drawn.exit_code == 0
    assert "note: finetune, profile laptop: the figure gradient-norm was not drawn: " in drawn.stderr
    assert "profile.svg" in drawn.stdout.replace("\n", "")
    assert rrmctl("plot", *options, "--figure", "gradient-norm").exit_code == 2


@pytest.mark.slow
def test_figures_of_variants_do_not_overwrite_one_another(results, tmp_path):
    """Overrides put the variant's digits into the name; the paper's profile needs no mention."""
    Sweep(profile="paper", variant="paper-feed", overrides={"agent.batch": 64}).write(results)
    Sweep(profile="paper", variant="paper").write(results)
    options = ("--figure", "curves", "--format", "png")
    rrmctl("plot", "main-results", "--results", results, "-o", tmp_path / "out", *options)
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["main-results-laptop.png", "main-results-paper-feed.png", "main-results.png"]


def test_the_commands_load_nothing_heavy():
    """Importing the commands leaves numpy, pandas and matplotlib alone, so that help answers at once."""
    code = (
        "import sys, rrmctl.cli.report; print(*{'numpy', 'pandas', 'matplotlib', 'torch', 'rich'} & set(sys.modules))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert set(ran.stdout.split()) <= {"rich"}
