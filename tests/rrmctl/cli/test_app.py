"""The program as a whole: its commands, and how errors become one message and an exit code."""

from __future__ import annotations

import errno
import inspect
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import pytest
import typer
from typer.testing import CliRunner, Result

import rrm
from rrm.errors import ConfigError
from rrm.files import place
from rrmctl.cli.app import _Commands, app
from rrmctl.errors import UserError

ROOT = Path(__file__).parents[3]


def call(*arguments: str) -> Result:
    return CliRunner().invoke(app, arguments)


def raising(error: BaseException) -> Result:
    """What a command that raises `error` ends in."""
    program = typer.Typer(cls=_Commands)

    @program.callback()
    def group() -> None: ...

    @program.command()
    def go() -> None:
        raise error

    return CliRunner().invoke(program, ["go"])


def test_version() -> None:
    """--version prints the package's version."""
    assert call("--version").stdout == f"rrmctl {rrm.__version__}\n"


@pytest.mark.parametrize("command", ["list", "plan", "run", "status", "resume", "show", "report", "plot", "doctor"])
def test_every_command_explains_itself(command: str) -> None:
    """Each command is listed and has a help text of its own."""
    assert f" {command} " in call("--help").stdout
    result = call(command, "--help")
    assert result.exit_code == 0
    assert "Usage:" in result.stdout


def test_no_arguments_show_the_help() -> None:
    """Called alone, the program teaches where to begin."""
    assert "rrmctl doctor" in call().output


def test_a_folder_that_is_gone_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing can be named from a working directory that somebody removed."""
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    result = call("doctor")
    assert result.exit_code == 2
    assert "the folder this command runs in is gone" in result.stderr


def test_unknown_command() -> None:
    """A near miss among the commands is suggested; misuse ends with 2."""
    result = call("pln")
    assert result.exit_code == 2
    assert "Did you mean 'plan'" in result.stderr


def test_unknown_experiment() -> None:
    """A mistake of the user's is one message with a hint on standard error, and exit code 2."""
    result = call("plan", "main-result", "--experiments", str(ROOT / "experiments"))
    assert result.exit_code == 2
    assert result.stdout == ""
    first, second = result.stderr.splitlines()
    assert first.startswith('error: no experiment "main-result"')
    assert first.endswith('did you mean "main-results"?')
    assert second.startswith("hint: known: ")


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (UserError("this is wrong", "do that"), "error: this is wrong\nhint: do that\n"),
        (UserError("file [method.x]: [bold]"), "error: file [method.x]: [bold]\n"),
        (ConfigError("steps: too few"), "error: steps: too few\n"),
        (
            OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "/r/x"),
            "error: /r/x: No space left on device\nhint: free space or choose another --results DIR\n",
        ),
    ],
)
def test_errors_become_messages(error: Exception, said: str) -> None:
    """Errors the user can act on are told word for word, brackets included, and end with 2."""
    result = raising(error)
    assert (result.exit_code, result.stderr) == (2, said)


def test_bugs_keep_their_traceback() -> None:
    """What is nobody's mistake but the program's is not dressed up."""
    for bug in (KeyError("x"), FileNotFoundError(errno.ENOENT, "no such file", "x")):
        assert raising(bug).exception is bug


def test_interruption() -> None:
    """Ctrl-C outside a sweep ends with 130."""
    assert raising(KeyboardInterrupt()).exit_code == 130


def test_a_question_that_nobody_answers() -> None:
    """The end of standard input is no failed job: nothing was begun, and the same command goes on."""
    assert raising(typer.Abort()).exit_code == 75


def test_plain_where_nobody_looks(tmp_path: Path) -> None:
    """No colour codes in a pipe."""
    command = [
        sys.executable,
        "-c",
        "from rrmctl.cli.app import main; main()",
        "plan",
        "x",
        "--experiments",
        str(tmp_path),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "\x1b" not in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        ("rrmctl pl", "plan"),
        ("rrmctl plan quick", "quickstart"),
        ("rrmctl plan quickstart --profile sm", "smoke"),
        ("rrmctl plan quickstart --set agent.ba", "agent.batch="),
    ],
)
def test_shell_completion(typed: str, offered: str) -> None:
    """The shell is offered commands, experiments, profiles and settings."""
    asked = {"_RRMCTL_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(len(typed.split()) - 1)}
    code = "import sys; sys.argv[0] = 'rrmctl'; from rrmctl.cli.app import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **asked}, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert offered in done.stdout.split()


@pytest.mark.slow
def test_files_that_lie_around_are_no_modules(tmp_path: Path) -> None:
    """A folder may hold files named like libraries: no process of the program takes them for these."""
    for name in ("numpy", "json"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('not the library')")
    for code, said in {
        "from rrmctl.cli.app import main; main()": "none run yet",
        "from rrmctl import doctor; print(doctor._try('import numpy'))": "None",
    }.items():
        command = [sys.executable, "-P", "-c", code, "plan", "toy-car"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert said in done.stdout, done.stderr


def commands(program: typer.Typer) -> Iterator[Callable[..., Any]]:
    """The function of every command, those of groups included."""
    yield from (each.callback for each in program.registered_commands if each.callback is not None)
    for group in program.registered_groups:
        assert group.typer_instance is not None
        yield from commands(group.typer_instance)


def test_every_path_may_begin_with_the_home_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No shell replaces the ~ of `--results=~/there`, and none that of an environment variable in quotes."""
    paths = 0
    for command in commands(app):
        for name, parameter in inspect.signature(command, eval_str=True).parameters.items():
            kind, *how = get_args(parameter.annotation)
            if kind is Path or Path in get_args(kind):
                assert how[0].parser is place, (command, name)
                paths += 1
    assert paths > 20
    monkeypatch.setenv("HOME", str(tmp_path))
    assert place("~/there") == tmp_path / "there"
    assert place("~nobody-is-called-so/there") == Path("~nobody-is-called-so/there")


def test_a_home_folder_in_words(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """In `--prior`, `--set imitation.demos=` and the name of a manifest it is the home folder as well."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("RRMCTL_RESULTS", "~/results")
    (tmp_path / "mine.py").write_text("def p(step):\n    return 0.0\n")
    (tmp_path / "d.safetensors").write_bytes(b"demonstrations")
    (tmp_path / "mine.toml").write_bytes((ROOT / "experiments" / "toy-car.toml").read_bytes())
    words = ["plan", "~/mine.toml", "--prior", "~/mine.py:p", "--set", "imitation.demos=~/d.safetensors"]
    planned = CliRunner().invoke(app, [*words, "--prior", "imitation", "--methods", "rrm-p,rrm-imitation", "--json"])
    assert planned.exit_code == 0, planned.output
    assert {job["method"] for job in json.loads(planned.stdout)["jobs"]} == {"rrm-p", "rrm-imitation"}
    status = CliRunner().invoke(app, ["status"])
    assert f"there is no results folder {tmp_path}/results" in " ".join(status.stderr.split())
