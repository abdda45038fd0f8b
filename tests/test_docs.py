"""What the documents show is what the program does."""

import inspect
import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from rrmctl.cli.app import app
from rrmctl.export.formats import formats
from rrmctl.planning.manifest import load
from rrmctl.reports.figures import figures
from rrmctl.reports.tables import kinds

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text()
PAGE = (ROOT / "docs" / "extending.md").read_text()
SMOKE = ["--profile", "smoke", "--seeds", "1", "--workers", "1", "--set", "steps=450"]


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def workshop(tmp_path):
    """A folder with the page's two files and a manifest with its two tables."""
    for code in blocks("python"):
        name = re.match(r"# (\w+\.py)\n", code).group(1)
        (tmp_path / name).write_text(code)
        assert len(code.splitlines()) < 40
    (tmp_path / "mine.toml").write_text(
        'title = "Mine"\nreproduces = ["nothing"]\nrule = "none"\nseeds = 1\n\n'
        '[grid]\ntasks = ["toy-car"]\nmethods = ["rrm-closer", "smooth"]\n\n' + "\n".join(blocks("toml"))
    )
    return tmp_path


def rrmctl(folder, *arguments):
    environment = os.environ | {"COLUMNS": "200"}
    command = [sys.executable, "-c", "from rrmctl.cli.app import main; main()", *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment, check=False)


@pytest.mark.slow
def test_ones_own_prior_and_learner_run_in_a_sweep(workshop):
    """The documented prior and learner, in files of the user's, run without touching the project's."""
    done = rrmctl(workshop, "run", "mine.toml", *SMOKE)
    assert done.returncode == 0, done.stderr
    table = rrmctl(workshop, "report", "iqm", "mine", "--format", "csv").stdout
    assert "rrm-closer" in table
    assert "smooth" in table


@pytest.mark.slow
def test_ones_own_prior_joins_an_experiment(workshop):
    """`--prior file.py:function` adds the method rrm-function to a manifest of ours."""
    done = rrmctl(
        workshop, "run", "toy-car", "--experiments", str(ROOT / "experiments"), "--prior", "my_priors.py:closer",
        "--methods", "oracle", *SMOKE,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "rrm-closer" in rrmctl(workshop, "report", "iqm", "toy-car", "--format", "csv").stdout


def documented_commands():
    """Every rrmctl command in the shell blocks of README and docs, as words."""
    pages = [README, *(path.read_text() for path in sorted((ROOT / "docs").glob("*.md")))]
    shell = "".join(block for page in pages for block in re.findall(r"```sh\n(.*?)```", page, re.DOTALL))
    lines = [line.partition("#")[0].split() for line in shell.splitlines()]
    return [words[1:] for words in lines if words[:1] == ["rrmctl"]]


def reference_tables():
    """Of every shell block on the stored results that a table follows: its reports, as words, and the table's lines."""
    pages = [README, *(path.read_text() for path in sorted((ROOT / "docs").glob("*.md")))]
    found = (re.findall(r"```sh\n([^`]*)```\n\n```\n([^`]*)```", page) for page in pages)
    for shell, table in (each for page in found for each in page):
        commands = [line.partition("#")[0].split()[1:] for line in shell.splitlines() if "results/reference" in line]
        if reports := [words for words in commands if words[0] == "report"]:
            yield pytest.param(reports, [line.rstrip() for line in table.splitlines()], id=" ".join(reports[0]))


@pytest.mark.parametrize(("reports", "table"), list(reference_tables()))
def test_the_tables_of_the_pages_come_out_of_the_stored_runs(reports, table):
    """Every line of a table is one that the command above it prints, from the runs in the repository."""
    told = [line.rstrip() for words in reports for line in rrmctl(ROOT, *words).stdout.splitlines()]
    assert len(table) > 4
    assert [line for line in table if line and line not in told] == []


@pytest.mark.parametrize("words", documented_commands(), ids=" ".join)
def test_documented_commands_exist(words):
    """Commands and options in the pages are the program's."""
    command = typer.main.get_command(app)
    while words and (known := getattr(command, "commands", {})):
        name = "RUN" if "RUN" in known and words[0] not in known else words[0]  # a run's id
        if name not in known:
            break
        command, words = known[name], words[1:]
    assert not getattr(command, "commands", None), f"unknown command {words[:1]}"
    options = {option for parameter in command.params for option in parameter.opts}
    assert {word.partition("=")[0] for word in words if word.startswith("-")} <= options


def test_the_readme_lists_the_experiments():
    """The table of experiments names every manifest and its methods, and nothing else."""
    rows = dict(re.findall(r"^\| `([a-z-]+)` \|.*\| (.*) \|$", README.split("| experiment |")[1], re.MULTILINE))
    assert set(rows) == {path.stem for path in (ROOT / "experiments").glob("*.toml")}
    for name, methods in rows.items():
        planned = {method for grid in load(ROOT / "experiments" / f"{name}.toml").grids for method in grid.methods}
        told = re.sub(r"rrm-\{the same\}", lambda _: "rrm-{proxy, o2g, h2o, sparse, language}", methods)
        told = re.sub(r"([\w-]+-)\{(.*?)\}", lambda m: ", ".join(m[1] + n for n in m[2].split(", ")), told)
        assert set(told.split(", ")) == planned, name


def test_the_tables_of_the_laptop_profile_are_those_of_its_runs(monkeypatch, capsys):
    """Every row that the stored runs give stands on the page; a verdict may follow it."""
    monkeypatch.setattr(sys, "argv", ["tables.py", str(ROOT / "results" / "reference")])
    runpy.run_path(str(ROOT / "experiments" / "laptop" / "tables.py"), run_name="__main__")
    rows = [line.removesuffix(" |") for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    page = (ROOT / "docs" / "laptop.md").read_text().splitlines()
    assert len(rows) > 10
    for row in rows:
        assert any(line.startswith(row) for line in page), row


REPORTS = (ROOT / "docs" / "reports.md").read_text()


def test_the_figures_are_listed():
    """docs/reports.md has a row for every figure, in the table of figures and nowhere else."""
    table = REPORTS.split("| figure | shows")[1].split("\n\n")[0]
    assert set(re.findall(r"^\| `([a-z-]+)` \|", table, re.MULTILINE)) == set(figures())


def test_the_notebook_example_draws(monkeypatch):
    """The example of figures in a notebook runs on the published results."""
    monkeypatch.chdir(ROOT)
    (code,) = re.findall(r"```python\n(.*?)```", REPORTS.split("### In a notebook")[1].split("\n## ")[0], re.DOTALL)
    exec(code, {})


def test_the_page_of_reports_lists_the_tables():
    """Every table has a row, and the columns it names are the table's."""
    page = REPORTS.split("### What never shares")[0]
    rows = dict(re.findall(r"^\| `([a-z-]+)` \|.*\| `(.*)` \|$", page, re.MULTILINE))
    assert set(rows) == set(kinds())
    everywhere = set(re.search(r"Most have `(.*?)`", page).group(1).split(", "))
    for name, entry in kinds().items():
        columns = {column.name for column in getattr(entry.load(), "COLUMNS", ())} or {"table"}
        assert columns - everywhere == set(rows[name].split(", ")) - everywhere, name


@pytest.mark.slow
def test_the_notebook_example_runs():
    """The page's example runs where the project's own results are, and gives DataFrames and a matplotlib figure."""
    (code,) = re.findall(r"```python\n(.*?)```", REPORTS.split("\n## Tables, runs and cost")[1], re.DOTALL)
    check = (
        "import pandas as pd; from matplotlib.figure import Figure;"
        "assert isinstance(figure, Figure) and len(figure.findobj(match=lambda a: a.__class__.__name__ == 'Line2D'));"
        "assert all(isinstance(each, pd.DataFrame) and len(each) for each in (final, curves, everything, cost));"
        "assert set(cost.method) == set(final.method) == set(rows.method)"
    )
    command = [sys.executable, "-W", "error", "-c", f"{code}\n{check}"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_every_export_format_is_documented():
    """The table of formats names every module of the folder, and nothing else."""
    told = re.findall(r"^\| `([a-z]+)` \|", REPORTS.split("| format | is |")[1], re.MULTILINE)
    assert told == list(formats())


def test_every_figure_takes_a_dataframe():
    """Each module of a figure offers a function from the store's rows to a matplotlib figure."""
    for name, entry in figures().items():
        offered = [each for key, each in vars(entry.load()).items() if not key.startswith("_") and callable(each)]
        drawing = [each for each in offered if inspect.isfunction(each)]
        first = [next(iter(inspect.signature(each).parameters), None) for each in drawing]
        assert "rows" in first, name


def promises():
    """Each guarantee, paragraph and row of docs/reliability.md that promises something."""
    page = (ROOT / "docs" / "reliability.md").read_text().split("## Guarantees")[1].split("## Not guaranteed")[0]
    listed, owner, rest = re.split(r"\n## .*\n", page)
    table, safe = rest.strip().split("\n\n")
    return [*listed.split("\n- ")[1:], owner, *table.splitlines()[2:], safe]


def test_every_promise_of_reliability_names_a_test_that_exists():
    """What no test shows is not promised."""
    known = {
        name for path in (ROOT / "tests").rglob("test_*.py") for name in re.findall(r"def (test_\w+)", path.read_text())
    }
    assert len(promises()) > 25
    for promise in promises():
        named = re.findall(r"`(test_\w+)`", promise)
        assert named, promise
        assert set(named) <= known, set(named) - known
