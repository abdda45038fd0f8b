"""Many short jobs, twenty workers, one of them killed every second; with readers that never rest, and without."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.store import load, planned
from tests.soak.storm import Storm

pytestmark = pytest.mark.slow


@pytest.mark.long
def test_a_hundred_jobs_of_a_second(tmp_path: Path) -> None:
    """All are done, none twice. `make soak` begins with the same and prints what it cost."""
    Storm(tmp_path, jobs=100, steps=500).survive()


@pytest.mark.long
def test_readers_during_a_sweep_of_two_hundred_jobs(tmp_path: Path) -> None:
    """`status`, `report` and plain pandas, over and over: none ever sees an error."""

    def as_a_notebook_does() -> None:
        load(tmp_path, "stand-in")
        planned(tmp_path, "stand-in")
        for path in tmp_path.glob("runs/*/curve.parquet"):
            pd.read_parquet(path)

    def as_people_do() -> None:
        for command in (["status"], ["status", "--json"], ["report", "iqm", "--replicates", "100"]):
            result = CliRunner().invoke(app, [*command, "--results", str(tmp_path)])
            nothing_yet = result.exit_code == 2 and "no run can be reported yet" in result.stderr
            assert result.exit_code == 0 or nothing_yet, result.output

    Storm(tmp_path, jobs=200, steps=200).survive(as_a_notebook_does, as_people_do)
