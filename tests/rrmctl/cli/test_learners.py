"""SURF and MRN, alone and under residual models, from their manifests to what the store holds."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.store import load, planned

EXPERIMENTS = Path(__file__).parents[3] / "experiments"


@pytest.mark.slow
@pytest.mark.sim
@pytest.mark.parametrize(
    ("name", "tasks", "figure"),
    [("surf", "button-press,sweep-into", "pseudo_labelled"), ("mrn", "door-open,button-press", "meta_gradient")],
)
@pytest.mark.long
def test_a_smoke_sweep(tmp_path: Path, name: str, tasks: str, figure: str) -> None:
    """Every run of the manifest ends, has learned from labels, and its curve has the learner's own figures."""
    arguments = ["run", name, "--experiments", str(EXPERIMENTS), "--profile", "smoke", "--seeds", "1"]
    result = CliRunner().invoke(app, [*arguments, "--tasks", tasks, "--results", str(tmp_path)])
    assert result.exit_code == 0, result.output
    runs = planned(tmp_path, name)
    assert set(runs["state"]) == {"done"}
    priors = ("proxy", "language", "imitation")
    assert set(runs["method"]) == {"oracle", name, *(f"rrm-{name}-{prior}" for prior in priors)}
    last = load(tmp_path, name).query("step == 600").set_index(["task", "method"])
    assert len(last) == 10
    for (_, method), row in last.iterrows():
        learns = method != "oracle"
        assert (row["labels"] > 0) == learns
        assert math.isfinite(row[figure]) == learns
