"""Standard streams that are no healthy terminal: closed, full, read by nobody, of few signs, of few columns."""

from __future__ import annotations

import fcntl
import os
import pty
import struct
import subprocess
import termios
from pathlib import Path

import pytest

from rrmctl.store import planned
from tests.rrmctl.cli.test_run import EXPERIMENTS, PLAN, PROGRAM, finished

#: What is told on standard output and nowhere else.
READING = [
    ["--help"],
    ["--version"],
    ["run", "--help"],
    ["list", "--experiments", str(EXPERIMENTS)],
    ["plan", *PLAN],
    ["status"],
    ["status", "toy-car", "--json"],
    ["status", "--failed"],
    ["show", "ID"],
    ["report", "iqm", "toy-car"],
    ["report", "final", "toy-car", "--format", "markdown"],
    ["report", "power", "--format", "json"],
    ["prior", "language", "prompt", "toy-car"],
]
#: What leaves files.
WORKING = [
    ["run", *PLAN, "--methods", "oracle", "--seeds", "2"],
    ["resume"],
    ["plot", "toy-car", "--format", "svg"],
    ["export", "toy-car", "--to", "csv", "-o", "out"],
    ["report", "html"],
]
WRONG = [
    ["nonsense"],
    ["report", "nonsense"],
    ["plan", "no-such", "--experiments", str(EXPERIMENTS)],
    ["run", "--seeds"],
]
#: One of each kind, for the quick tests and for every stream.
FEW = [READING[9], WORKING[0], WRONG[0]]
STREAMS = {
    "closed": ("<&- >&- 2>&-", {}),
    "error closed": (">/dev/null 2>&-", {}),
    "error full": (">/dev/null 2>/dev/full", {}),
    "ascii": (">out.txt 2>&1", {"PYTHONIOENCODING": "ascii"}),
    "latin-1": (">out.txt 2>&1", {"PYTHONIOENCODING": "latin-1"}),
    "locale C": (">out.txt 2>&1", {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}),
    "nobody reads": ("2>&1 | true; exit ${PIPESTATUS[0]}", {}),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with results, of which two runs are done."""
    folder = tmp_path_factory.mktemp("streams")
    finished(folder / "results")
    return folder


def outcome(folder: Path, command: list[str], redirected: str, **variables: str) -> int:
    """The exit code of a command in this folder, in a shell that redirects its streams."""
    (run, *_) = (folder / "results" / "runs").iterdir()
    words = [*PROGRAM, *(run.name if word == "ID" else word for word in command)]
    shell = ["bash", "-c", f'"$@" {redirected}', "bash", *words]
    return subprocess.run(shell, cwd=folder, env=os.environ | variables, check=False).returncode


def whole(commands: list[list[str]]) -> list[object]:
    """All of these, those that are not among the few as slow ones."""
    return [
        pytest.param(each, id=" ".join(each[:3]), marks=() if each in FEW else pytest.mark.slow) for each in commands
    ]


@pytest.mark.parametrize(
    ("streams", "command"),
    [
        *((streams, command) for streams in STREAMS for command in FEW),
        *(
            pytest.param(streams, command, marks=pytest.mark.slow)
            for streams in ("closed", "ascii", "nobody reads")
            for command in (*READING, *WORKING, *WRONG)
            if command not in FEW
        ),
    ],
)
def test_the_exit_code_is_that_of_the_work(folder: Path, streams: str, command: list[str]) -> None:
    """Neither a stream nor what reads it changes how a command ends, and no traceback is written."""
    redirected, variables = STREAMS[streams]
    told = folder / "out.txt"
    told.unlink(missing_ok=True)
    assert outcome(folder, command, redirected, **variables) == (2 if command in WRONG else 0)
    assert not told.exists() or b"Traceback" not in told.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("command", whole(READING))
def test_an_answer_that_cannot_be_written_is_an_error(folder: Path, command: list[str]) -> None:
    """On a full disk a table is lost: one message, and exit code 2."""
    assert outcome(folder, command, ">/dev/full 2>out.txt") == 2
    assert (folder / "out.txt").read_text().startswith("error: standard output: No space left on device\nhint: ")


@pytest.mark.slow
@pytest.mark.parametrize("command", whole(WORKING))
def test_work_is_done_where_nothing_can_be_written_about_it(folder: Path, command: list[str]) -> None:
    """Its files are what was asked for."""
    assert outcome(folder, command, ">/dev/full 2>&1") == 0


@pytest.mark.slow
def test_signs_that_an_encoding_lacks_are_spelled(folder: Path) -> None:
    """A table stays one, with a dash for a dash."""
    assert outcome(folder, ["report", "iqm"], ">out.txt", PYTHONIOENCODING="ascii") == 0
    text = (folder / "out.txt").read_bytes().decode("ascii")
    assert text.startswith("toy-car - profile smoke")
    assert "\\x" not in text


def test_a_name_that_is_no_text_is_printed_as_it_is(folder: Path) -> None:
    """Names of files are bytes; they can be copied from what is printed."""
    name = os.fsdecode(b"no \xff text")
    (folder / name).mkdir(exist_ok=True)
    assert outcome(folder, ["status", "--results", name], ">out.txt", PYTHONIOENCODING="utf-8:strict") == 0
    assert (folder / "out.txt").read_bytes().startswith(b"no \xff text holds no sweep yet")


@pytest.mark.slow
def test_a_sweep_without_any_stream_is_trained(tmp_path: Path) -> None:
    """Its files, its lock and its log are no terminal, whatever numbers they get."""
    sweep = ["run", *PLAN, "--methods", "oracle", "--seeds", "1", "--results", str(tmp_path)]
    (tmp_path / "results/runs/0").mkdir(parents=True)
    assert outcome(tmp_path, sweep, "<&- >&- 2>&-") == 0
    assert planned(tmp_path, "toy-car")["state"].tolist() == ["done"]


@pytest.mark.slow
@pytest.mark.parametrize("command", whole([*READING, *WORKING, *WRONG]))
def test_a_terminal_of_few_columns(folder: Path, command: list[str]) -> None:
    """Everything is folded, nothing is said of the program's insides."""
    master, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 20, 0, 0))
    (run, *_) = (folder / "results" / "runs").iterdir()
    words = [*PROGRAM, *(run.name if word == "ID" else word for word in command)]
    program = subprocess.Popen(
        words, cwd=folder, env=os.environ | {"TERM": "dumb"}, stdin=terminal, stdout=terminal, stderr=terminal
    )
    os.close(terminal)
    told = b""
    try:
        while data := os.read(master, 65536):
            told += data
    except OSError:  # how the end of a terminal reads
        os.close(master)
    assert program.wait() == (2 if command in WRONG else 0)
    assert b"Traceback" not in told
