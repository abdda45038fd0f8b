"""A system that gives the program little: what is done stays done, and what could not be done is said in a line."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
from pathlib import Path

import pytest

from rrmctl.cli.summary import _afterwards
from rrmctl.errors import RoomError, room_error
from tests.rrmctl.cli.test_app import raising
from tests.rrmctl.cli.test_run import PROGRAM, call, finished
from tests.rrmctl.reports.frames import Sweep

#: Enough for what follows training, and for nothing that libraries set aside in advance; bytes.
LITTLE = 700 * 2**20


def confined(*arguments: str | Path, kind: int = resource.RLIMIT_AS, limit: int = LITTLE) -> tuple[int, str, str]:
    """The program within a limit of the system: exit code, standard output and error."""
    done = subprocess.run(
        [*PROGRAM, *map(str, arguments)],
        preexec_fn=lambda: resource.setrlimit(kind, (limit, limit)),
        capture_output=True,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "limit"), [(resource.RLIMIT_AS, LITTLE), (resource.RLIMIT_NOFILE, 16)])
def test_a_sweep_ends_where_there_is_little_room(tmp_path: Path, kind: int, limit: int) -> None:
    """The curves are summed up, and the exit code is that of the runs."""
    Sweep().write(tmp_path)
    code, out, error = confined("resume", "--results", tmp_path, kind=kind, limit=limit)
    assert code == 0, error
    assert "All done" in out
    assert (tmp_path / "aggregates" / "main-results.parquet").exists()


def test_a_report_that_does_not_fit_is_one_message(tmp_path: Path) -> None:
    """No traceback, exit code 2."""
    Sweep().write(tmp_path)
    code, _, error = confined("report", "iqm", "--replicates", "1000000000", "--results", tmp_path)
    assert code == 2
    assert error.startswith("error: there are no more pages of memory\nhint: ")


@pytest.mark.parametrize(
    ("error", "what"),
    [
        (MemoryError(), "memory"),
        (OSError(errno.ENOMEM, os.strerror(errno.ENOMEM)), "memory"),
        (ImportError("numpy: a.so: failed to map segment from shared object"), "memory"),
        (RuntimeError("can't start new thread"), "threads or processes"),
        (OSError(errno.EAGAIN, os.strerror(errno.EAGAIN)), "threads or processes"),
        (OSError(errno.EMFILE, os.strerror(errno.EMFILE), "x"), "open files"),
    ],
)
def test_what_there_is_too_little_of(error: Exception, what: str) -> None:
    """It is told from other errors, in any command, and ends with 2."""
    result = raising(error)
    assert (result.exit_code, result.exception) != (1, error)
    assert result.exit_code == 2
    assert what in result.stderr


@pytest.mark.parametrize("error", [ValueError("boom"), FileNotFoundError(errno.ENOENT, "no such file"), KeyError()])
def test_other_errors_are_not_called_so(error: Exception) -> None:
    """They keep their traceback."""
    assert room_error(error) is None


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (RoomError("threads"), "there are no more threads"),
        (RuntimeError("can't start new thread"), "there are no more threads"),
        (KeyError("x"), "KeyError: 'x'"),
    ],
)
def test_what_was_not_done_afterwards_is_a_line(
    error: Exception, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the command that does it later, whatever the reason; it raises nothing."""
    with _afterwards("x was not written", later="rrmctl report iqm x"):
        raise error
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"note: x was not written: {said}")
    assert line.endswith("; later: rrmctl report iqm x")


def test_aggregates_that_cannot_be_written_cost_no_exit_code(tmp_path: Path) -> None:
    """The command that is named writes them, once it can."""
    layout, _ = finished(tmp_path)
    (tmp_path / "aggregates").touch()
    result = call("resume", "--results", tmp_path)
    assert result.exit_code == 0
    assert f"later: rrmctl resume toy-car --results {tmp_path}" in result.stderr
    (tmp_path / "aggregates").unlink()
    assert call("resume", "--results", tmp_path).exit_code == 0
    assert layout.aggregate("toy-car").exists()
