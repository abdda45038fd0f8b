"""A Slurm and a Ray for all tests of this folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cluster import ray as rays
from tests.cluster.slurm import Slurm, missing, slurm, until


@pytest.fixture(scope="session")
def running_slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Slurm]:
    """Without one tests are skipped, or fail where somebody said that it must be there."""
    if (reason := missing()) is not None:
        (pytest.fail if "cluster" in os.environ.get("RRMCTL_TESTS_NEED", "") else pytest.skip)(reason)
    with slurm(tmp_path_factory.mktemp("slurm") / "cluster") as running:
        yield running


@pytest.fixture
def cluster(running_slurm: Slurm, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Slurm]:
    """It alone, for one test, after which nothing of it is left: neither in the queue nor on a node."""
    monkeypatch.setenv("SLURM_CONF", running_slurm.environment["SLURM_CONF"])
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    yield running_slurm
    running_slurm.clear()
    until(lambda: not processes_of(tmp_path), 30.0)


@pytest.fixture(scope="session")
def running_ray() -> Iterator[rays.Ray]:
    """On this machine alone."""
    with rays.ray() as running:
        yield running


@pytest.fixture
def ray(running_ray: rays.Ray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[rays.Ray]:
    """It alone, for one test, after which no worker of the test's is left."""
    for name in ("RAY_ADDRESS", "RAY_AUTH_MODE", "RAY_AUTH_TOKEN"):
        monkeypatch.setenv(name, running_ray.environment[name])
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    yield running_ray
    until(lambda: not processes_of(tmp_path), 30.0)


def processes_of(folder: Path) -> list[str]:
    """Commands of processes that work in this folder."""
    commands = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = entry.read_text(errors="replace").replace("\0", " ")
        except OSError:
            continue
        if "rrmctl.running" in command and str(folder) in command:
            commands.append(command)
    return commands
