"""A sweep whose output cannot be written, and requests to stop before its first worker runs."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rrmctl.store import planned

PROGRAM = [sys.executable, "-c", "from rrmctl.cli.app import main; main()"]
EXPERIMENTS = Path(__file__).parents[3] / "experiments"
SWEEP = [
    "run",
    "toy-car",
    "--experiments",
    str(EXPERIMENTS),
    "--profile",
    "smoke",
    "--seeds",
    "1",
    "--methods",
    "oracle",
]


def full_disk() -> int:
    return os.open("/dev/full", os.O_WRONLY)


def abandoned_pipe() -> int:
    reading, writing = os.pipe()
    os.close(reading)
    return writing


@pytest.mark.slow
@pytest.mark.parametrize("behind", [full_disk, abandoned_pipe])
def test_output_that_cannot_be_written_costs_the_output_alone(tmp_path: Path, behind: Callable[[], int]) -> None:
    """Standard output and error go where nothing can be written: the sweep is run to its end."""
    output = behind()
    done = subprocess.run([*PROGRAM, *SWEEP, "--results", str(tmp_path)], stdout=output, stderr=output, check=False)
    os.close(output)
    assert done.returncode == 0
    assert planned(tmp_path, "toy-car")["state"].tolist() == ["done"]


@pytest.mark.slow
def test_a_terminal_that_is_stopped_does_not_keep_the_sweep_from_obeying(tmp_path: Path) -> None:
    """Nobody reads the terminal, its buffer is full, and SIGTERM still ends the sweep in good order."""
    master, terminal = pty.openpty()
    os.set_blocking(terminal, False)
    try:
        while True:
            os.write(terminal, b"x" * 1000)
    except BlockingIOError:
        os.set_blocking(terminal, True)
    program = subprocess.Popen(
        [*PROGRAM, *SWEEP, "--results", str(tmp_path)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=terminal,
    )
    try:
        while not list(tmp_path.glob("runs/*/status.json")):
            time.sleep(0.05)
            assert program.poll() is None
        program.send_signal(signal.SIGTERM)
        assert program.wait(60) == 75
    finally:
        program.kill()
        program.communicate()
        os.close(master)
        os.close(terminal)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_before_the_first_worker_a_request_to_stop_means_incomplete(tmp_path: Path, number: signal.Signals) -> None:
    """While thousands of runs are recorded: exit code 75, no traceback, and what is written is whole."""
    sweep = ["run", "main-results", "--experiments", str(EXPERIMENTS), "--seeds", "100", "--yes"]
    program = subprocess.Popen(
        [*PROGRAM, *sweep, "--results", str(tmp_path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    while not list(tmp_path.glob("runs/*/config.json")):
        time.sleep(0.01)
        assert program.poll() is None
    program.send_signal(number)
    out, error = program.communicate(timeout=60)
    assert program.returncode == 75, error
    assert "Not complete" in out
    assert "Traceback" not in error
    assert not list(tmp_path.glob("sweeps/*/*.json"))
    assert not any(lease.stat().st_size for lease in tmp_path.glob("runs/*/lease-*.json"))
