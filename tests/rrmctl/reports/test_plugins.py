"""The seam between tables and the program: a file is a command, and a report is written in every form."""

import io
import math
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

import rrmctl
from rrmctl.errors import UserError
from rrmctl.reports.columns import Column, TextGrid, highest
from rrmctl.reports.dataframes import report_table
from rrmctl.reports.render import FORMATS, print_terminal, to_text
from rrmctl.reports.report import Report, tabled
from rrmctl.reports.select import read_sections
from rrmctl.reports.statistics import Statistics
from rrmctl.reports.tables import kinds
from rrmctl.reports.tables.iqm import make
from tests.rrmctl.reports.frames import Sweep

NEW_KIND = '''"""Counts runs.

For a test.
"""

import pandas as pd

from rrmctl.reports.columns import TextGrid
from rrmctl.reports.report import Report, facts, title

EXPERIMENTS = ()
{options}


def make(sections, settings):
    return [
        Report(
            title(section),
            pd.DataFrame({{"runs": [section.contained]}}),
            TextGrid(
                ("What", "Runs"),
                (("all", str(section.contained)), ("sign", str(settings.plus_minus))),
                best=frozenset({{(0, 1)}}),
            ),
            (),
            facts(section, settings),
        )
        for section in sections
    ]
'''


@pytest.fixture
def copied(tmp_path):
    """A copy of the program in a folder of its own, and a function that runs it."""
    shutil.copytree(Path(rrmctl.__file__).parent, tmp_path / "rrmctl", ignore=shutil.ignore_patterns("__pycache__"))

    def run(*words):
        code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); from rrmctl.cli.app import main; main()"
        return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=False)

    return tmp_path / "rrmctl", run


@pytest.mark.slow
def test_a_file_is_a_command(copied, tmp_path):
    """A module put beside the others is listed with its first line, and makes its table in every form."""
    package, run = copied
    (package / "reports" / "tables" / "how_many.py").write_text(NEW_KIND.format(options=""))
    Sweep().write(tmp_path / "results")
    assert "how-many" in run("report", "--help").stdout
    assert "Counts runs." in run("report", "how-many", "--help").stdout
    shown = {
        form: run("report", "how-many", "--results", str(tmp_path / "results"), "--format", form) for form in FORMATS
    }
    assert {ran.returncode for ran in shown.values()} == {0}
    assert "**15**" in shown["markdown"].stdout
    assert r"\textbf{15}" in shown["latex"].stdout
    assert '"runs": 15' in shown["json"].stdout


@pytest.mark.slow
def test_options_of_its_own_are_options_of_that_table_alone(copied, tmp_path):
    """`OPTIONS` gives a table --plus-minus; one that does not name it has no such option."""
    package, run = copied
    for name, options in (("with_it", 'OPTIONS = ("plus_minus",)'), ("without", "")):
        (package / "reports" / "tables" / f"{name}.py").write_text(NEW_KIND.format(options=options))
    Sweep().write(tmp_path / "results")
    asked = ("--results", str(tmp_path / "results"), "--plus-minus", "--format", "markdown")
    assert "| sign | True |" in run("report", "with-it", *asked).stdout
    refused = run("report", "without", *asked)
    assert refused.returncode == 2
    assert "--plus-minus" in refused.stderr


def test_a_name_with_an_underscore_in_front_is_no_command(copied):
    """Helpers may lie beside the tables."""
    package, run = copied
    (package / "reports" / "tables" / "_helper.py").write_text('"""Nothing."""')
    assert "helper" not in run("report", "--help").stdout


@pytest.mark.parametrize("name", sorted(kinds()))
def test_every_kind_is_whole(name):
    """Each table has words for its help, experiments that there are, and a function that makes it."""
    entry = kinds()[name]
    module = entry.load()
    assert entry.help
    assert set(module.EXPERIMENTS) <= {path.stem for path in (Path(__file__).parents[3] / "experiments").glob("*.toml")}
    assert callable(module.make)
    assert tuple(getattr(module, "OPTIONS", ())) == entry.options


def bold(cell="97.5 %"):
    grid = TextGrid(("Method", "IQM"), (("a", "3.0 %"), ("b", cell)), best=frozenset({(1, 1)}))
    return Report("t", pd.DataFrame({"x": [1]}), grid, (), {"experiment": "e", "profile": "p", "variant": "v"})


def test_the_best_is_bold_in_every_text():
    """Markdown and LaTeX mark the best cell, the terminal prints it bold; no other cell is marked."""
    assert to_text([bold()], "markdown").count("**") == 2
    assert "| b | **97.5 %** |" in to_text([bold()], "markdown")
    assert to_text([bold()], "latex").count(r"\textbf") == 1
    assert r"b & \textbf{97.5 \%} \\" in to_text([bold()], "latex")
    file = io.StringIO()
    print_terminal([bold()], Console(file=file, force_terminal=True, width=80, color_system="standard"))
    assert "\x1b[1m97.5 %\x1b[0m" in file.getvalue()
    assert "\x1b[1m3.0 %" not in file.getvalue()


def test_columns_are_the_frame_and_the_text():
    """Values have their types and what is missing is NaN; people see what has a heading and tells rows apart."""
    columns = (
        Column("task", heading="Task", apart=()),
        Column("method", heading="Method"),
        Column("score", "float64", "Score", lambda row: f"{row['score']:.0f}", best=("task",)),
        Column("n", "Int64"),
    )
    rows = [
        {"task": "a", "method": "oracle", "score": 9.0, "n": 2},
        {"task": "a", "method": "pebble", "score": 1.0, "n": 3},
        {"task": "a", "method": "mrn", "score": 2.0},
    ]
    table, whole = tabled(columns, rows)
    assert {name: str(kind) for name, kind in table.dtypes.items()} == {
        "task": "str", "method": "str", "score": "float64", "n": "Int64"
    }  # fmt: skip
    assert table["n"].isna().tolist() == [False, False, True]
    grid = TextGrid.of(columns, whole)
    assert (grid.header, grid.words, grid.best) == (("Method", "Score"), 1, {(2, 1)})
    assert grid.rows == (("oracle", "9"), ("pebble", "1"), ("mrn", "2"))
    assert TextGrid.of(columns, [*whole, whole[0] | {"task": "b"}]).header == ("Task", "Method", "Score")


cells = st.text(st.characters(codec="latin-1", categories=("L", "N", "P", "S")), min_size=1, max_size=6)
grids = st.integers(1, 4).flatmap(
    lambda width: st.tuples(
        st.lists(cells, min_size=width, max_size=width),
        st.lists(st.lists(cells, min_size=width, max_size=width), max_size=6),
    )
)


@given(grids)
def test_a_grid_keeps_its_cells_in_markdown(grid):
    """However odd the text, every row of the grid is one line of as many cells; without rows there is no table."""
    header, rows = grid
    made = Report("t", pd.DataFrame(), TextGrid(tuple(header), tuple(map(tuple, rows)), 1), (), {})
    lines = [line for line in to_text([made], "markdown").splitlines() if line.startswith("|")]
    assert len(lines) == (2 + len(rows) if rows else 0)
    for line in lines:
        assert line.replace("\\|", "").count("|") == len(header) + 1


@given(grids)
def test_groups_are_named_once(grid):
    """A name stands where its group begins and nowhere else; nothing but the first column changes."""
    header, rows = grid
    made = TextGrid(tuple(header), tuple(map(tuple, rows)), 1)
    name, ended = None, False
    for (row, last), whole in zip(made.grouped(), made.rows, strict=True):
        assert row[0] == ("" if whole[0] == name else whole[0])
        assert row[1:] == whole[1:]
        assert not ended or row[0] == whole[0]
        name, ended = whole[0], last
    assert ended is False


@given(st.lists(st.tuples(st.sampled_from("ab"), st.floats(-10, 10) | st.just(math.nan)), max_size=8))
def test_the_highest_of_each_group(entries):
    """In each group with a number some cell is the highest, no number of the group is above it, and NaN is none."""
    found = highest(((at, 0), group, value) for at, (group, value) in enumerate(entries))
    assert not any(math.isnan(entries[at][1]) for at, _ in found)
    for name in "ab":
        values = [value for group, value in entries if group == name and not math.isnan(value)]
        tops = [entries[at][1] for at, _ in found if entries[at][0] == name]
        assert bool(tops) == bool(values)
        assert all(top >= max(values) - 1e-9 * max(1, abs(top)) for top in tops)


@pytest.mark.slow
def test_a_table_is_a_frame_in_a_notebook(tmp_path):
    """The rows are those of the reports, with the section they belong to in front."""
    Sweep().write(tmp_path)
    Sweep(profile="smoke", variant="smoke").write(tmp_path)
    settings = Statistics(replicates=100)
    found = report_table("iqm", tmp_path, "main-results", settings=settings)
    assert list(found.columns[:4]) == ["experiment", "profile", "variant", "task"]
    assert list(found["profile"].unique()) == ["laptop", "smoke"]
    wanted = pd.concat([report.table for report in make(read_sections(tmp_path), settings)], ignore_index=True)
    pd.testing.assert_frame_equal(found[wanted.columns], wanted)
    assert set(report_table("iqm", tmp_path, profile="smoke", settings=settings)["profile"]) == {"smoke"}
    with pytest.raises(UserError, match='did you mean "less-feedback"'):
        report_table("less-feedbak", tmp_path)
