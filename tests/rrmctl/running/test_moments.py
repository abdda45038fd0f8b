"""A worker killed at every moment at which it touches a file, a claim, a row and a checkpoint among them."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_killed_at_each_file_operation(tmp_path: Path) -> None:
    """Whichever it is, and however often: the next worker ends the run with the same rows and networks."""
    command = [sys.executable, "-m", "tests.rrmctl.running.moments", str(tmp_path), "1"]
    done = subprocess.run(command, cwd=Path(__file__).parents[3], check=True, capture_output=True, text=True)
    found = json.loads(done.stdout)
    assert found.pop("kills") > 100
    assert found == {"unfinished": [], "different": [], "twice": []}
