"""A worker, or the program, killed at every moment at which it touches a file: claims, rows and checkpoints as well."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
@pytest.mark.long
@pytest.mark.parametrize(("what", "least"), [("worker", 200), ("command", 10)])
def test_killed_at_each_file_operation(what: str, least: int, tmp_path: Path) -> None:
    """Whichever it is, and however often: the next one ends with the same rows, networks and records."""
    command = [sys.executable, "-m", "tests.rrmctl.running.moments", what, str(tmp_path), "1"]
    done = subprocess.run(command, cwd=Path(__file__).parents[3], check=True, capture_output=True, text=True)
    found = json.loads(done.stdout)
    assert found.pop("kills") >= least
    assert found == {"unfinished": [], "different": [], "twice": []}
