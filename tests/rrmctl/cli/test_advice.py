"""Every command that the program tells people to type is one that works when it is typed."""

from __future__ import annotations

import ast
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from rrmctl.cli.app import app
from rrmctl.store import planned
from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, read_status, write_status
from tests.rrmctl.cli.test_run import ERROR, EXPERIMENTS, finished, settle
from tests.test_architecture import MODULES

RESULTS = "it's my results"
#: What stands for something else in a command, and something that it can stand for.
PLACEHOLDERS = {"NAME": "toy-car", "RUN": "0", "ID": "0", "DIR": "out", "N": "10"}


def advised() -> Iterator[tuple[str, str]]:
    """Module and text of every command in backticks in the source, docstrings aside."""
    for module, path in MODULES.items():
        tree = ast.parse(path.read_text())
        parts = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
        told = {id(node.body[0].value) for node in ast.walk(tree) if isinstance(node, parts) and node.body
                and isinstance(node.body[0], ast.Expr)}  # fmt: skip
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in told:
                yield from ((module, command) for command in re.findall(r"`(rrmctl [^`{]+)`", node.value))


@pytest.mark.parametrize(("module", "command"), sorted(set(advised())))
def test_a_command_in_a_message_is_whole(module: str, command: str) -> None:
    """No argument is missing, no option unknown; what stands for something else is in capitals."""
    _, *words = [PLACEHOLDERS.get(word, word) for word in shlex.split(command)]
    here = typer.main.get_command(app)
    while hasattr(here, "commands"):
        here = here.commands[words.pop(0)]
    if "--help" not in words:
        here.make_context("rrmctl", words)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the experiments, in which a shell finds the program; nothing is in it that needs no quotes."""
    folder = tmp_path / "a 'folder'"
    (folder / "bin").mkdir(parents=True)
    program = folder / "bin" / "rrmctl"
    program.write_text(f"#!{sys.executable}\nfrom rrmctl.cli.app import main; main()\n")
    program.chmod(0o755)
    shutil.copytree(EXPERIMENTS, folder / "experiments")
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(EXPERIMENTS.parent))
    monkeypatch.delenv("RRMCTL_RESULTS", raising=False)
    monkeypatch.chdir(folder)
    return folder


def typed(command: str) -> tuple[int, str]:
    """The exit code of a command in a shell, and all that it prints."""
    done = subprocess.run(command, shell=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False)
    return done.returncode, done.stdout


def commands(text: str) -> list[str]:
    """The commands in what was printed: in backticks, or to the end of a line."""
    found = re.findall(r"`((?:rm -r .*?&& )?rrmctl [^`]*)`|((?:rm -r .*?&& )?rrmctl [^`;]*?)(?:;|$)", text, re.M)
    return list(dict.fromkeys(one or other for one, other in found))


def follow(text: str, *, train: bool = False) -> list[str]:
    """Type every command that is printed; `run` only plans, unless it is to train."""
    found = commands(text)
    assert found, text
    for command in found:
        planning = re.sub(r"^(rm -r .*&& )?rrmctl run ", "rrmctl plan ", command)
        looking = planning.removesuffix(" --force").removesuffix(" --retry-failed")
        code, told = typed(command if train else looking)
        assert code == 0, f"{command}\n{told}"
    return found


QUOTED = shlex.quote(RESULTS)
RUN = f"rrmctl run toy-car --profile smoke --methods oracle --seeds 2 --results {QUOTED}"


@pytest.mark.slow
def test_after_all_is_done(folder: Path) -> None:
    """The table and the figure, of this results folder."""
    finished(folder / RESULTS)
    code, told = typed(RUN)
    assert code == 0
    assert follow(told[told.index("Next:") :]) == [
        f"rrmctl report iqm toy-car --results {QUOTED}",
        f"rrmctl plot toy-car --results {QUOTED}",
    ]


@pytest.mark.slow
def test_where_something_failed(folder: Path) -> None:
    """The reasons; the log of one; and what tries again, which is not run here."""
    _, ids = finished(folder / RESULTS)
    settle(folder / RESULTS, RunState.FAILED, seeds="0,", error=ERROR)
    code, told = typed(RUN)
    assert code == 1
    asked, again = commands(told)
    assert again == f"rrmctl resume toy-car --retry-failed --results {QUOTED}"
    follow(typed(asked)[1])
    shown = typed(f"rrmctl show {ids[0]} --results {QUOTED}")[1]
    assert follow(shown.split("again, from nothing")[1])[0].endswith("--force")


@pytest.mark.slow
def test_of_a_folder_without_runs(folder: Path) -> None:
    """What begins a sweep is a whole command."""
    for command in ("status", "resume", "report iqm"):
        follow(typed(f"rrmctl {command} --results {QUOTED}")[1])
    (folder / RESULTS).mkdir()
    for command in ("status", "resume", "report iqm", "status toy-car"):
        follow(typed(f"rrmctl {command} --results {QUOTED}")[1])


@pytest.mark.slow
def test_damage_and_its_way_out(folder: Path) -> None:
    """A curve, a status and a sweep that are no use any more."""
    layout, ids = finished(folder / RESULTS)
    layout.run(ids[0]).curve.write_text("x")
    for command in ("resume", "report iqm toy-car"):
        code, told = typed(f"rrmctl {command} --results {QUOTED}")
        assert code != 0
        follow(told)
    write_status(layout.run(ids[1]), read_status(layout.run(ids[0])))
    layout.run(ids[1]).status.write_text("{}")
    follow(typed(f"rrmctl report power --results {QUOTED}")[1])


@pytest.mark.slow
@pytest.mark.parametrize("asked", ["status", "resume"])
@pytest.mark.long
def test_runs_whose_folder_was_removed(folder: Path, asked: str) -> None:
    """One command makes their configurations and trains them; methods of --prior and a manifest elsewhere included."""
    shutil.move(folder / "experiments" / "toy-car.toml", folder / "my car.toml".replace(" ", "-"))
    (folder / "my own.py").write_text("def mine(step):\n    return 0.0\n")
    first = "rrmctl run my-car.toml --profile smoke --methods oracle --prior proxy --prior 'my own.py:mine' --seeds 1"
    code, told = typed(f"{first} --results {QUOTED}")
    assert code == 0, told
    gone, *_ = Layout(folder / RESULTS).run_ids()
    shutil.rmtree(folder / RESULTS / "runs" / gone)
    code, told = typed(f"rrmctl {asked} --results {QUOTED}")
    assert code == (0 if asked == "status" else 1)
    assert "cannot write" not in told
    (command,) = commands(told)
    follow(command, train=True)
    assert set(planned(folder / RESULTS)["state"]) == {"done"}
    assert typed(f"rrmctl resume --results {QUOTED}")[0] == 0


@pytest.mark.slow
def test_one_of_several_teachers_is_trained_again_and_no_other(folder: Path) -> None:
    """No option names a teacher: what is gone is what runs."""
    (folder / "experiments" / "two.toml").write_text(
        'title = "Two teachers"\nreproduces = ["nothing"]\nrule = "none"\nseeds = 1\n'
        '[grid]\ntasks = ["toy-car"]\nmethods = ["pebble"]\nteachers = ["oracle", "mistaken-10"]\n'
    )
    code, told = typed(f"rrmctl run two --profile smoke --workers 2 --results {QUOTED}")
    assert code == 0, told
    layout = Layout(folder / RESULTS)
    asked, other = layout.run_ids()
    again = typed(f"rrmctl show {asked} --results {QUOTED}")[1].split("again, from nothing")[1]
    for run in (asked, other):
        (layout.run(run).path / "mark").touch()
    follow(again, train=True)
    assert [(layout.run(run).path / "mark").exists() for run in (asked, other)] == [False, True]
    assert read_status(layout.run(other)).attempt == 1
    assert set(planned(folder / RESULTS)["state"]) == {"done"}
