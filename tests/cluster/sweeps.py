"""What became of sweeps on the cluster."""

from __future__ import annotations

import json
from pathlib import Path

from rrmctl.store.layout import Layout
from tests.rrmctl.cli.test_run import call, numbers


def same(mine: Path, twin: Path) -> None:
    """Every run of mine has the networks of the twin's, bit for bit; and the same curves, if they are all there."""
    runs = Layout(mine).run_ids()
    assert runs
    for run in runs:
        for name in ("model.safetensors", "demos.safetensors"):
            files = [Layout(root).run(run).path / name for root in (mine, twin)]
            assert files[0].exists() == files[1].exists()
            assert not files[0].exists() or files[0].read_bytes() == files[1].read_bytes()
    if runs == Layout(twin).run_ids():
        assert numbers(mine) == numbers(twin)


def told(root: Path) -> dict[str, object]:
    """What `status` tells programs."""
    return json.loads(call("status", "toy-car", "--json", "--results", root).stdout)
