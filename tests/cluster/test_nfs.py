"""Shared folders on NFS itself, v3 without locks and v4.2: in one kernel, and between two machines and their server."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cluster import uml
from tests.cluster.test_shared_folder import OWNER, RACER, RUN, SUCCESSOR

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.slow,
    pytest.mark.long,
    pytest.mark.skipif(bool(uml.missing()), reason=str(uml.missing())),
]

ROUNDS = 20
WRITES = """write(); print("owns", flush=True)
    while True: write(); time.sleep(0.05)
"""
SERVER, *MACHINES = ("10.7.0.1", "10.7.0.2", "10.7.0.3")


def test_a_run_has_one_owner_on_nfs(tmp_path: Path) -> None:
    """Races, frozen owners and living ones, on both: everything that is tested of a shared folder."""
    with uml.kernel(tmp_path, "both", "both", str(Path(__file__).parents[2]), sys.executable) as kernel:
        kernel.wait()
        said = kernel.log()
    assert "local_lock=all" in said
    assert {"v3 passed", "v4 passed"} <= set(said.splitlines()), said


@pytest.fixture(scope="module")
def machines(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[uml.Kernel]]:
    """Two that have mounted a third's folder, and nothing else in common."""
    folder = tmp_path_factory.mktemp("nfs")
    for name, script in (("racer", RACER), ("owner", OWNER.format(WRITES)), ("successor", SUCCESSOR)):
        (folder / f"{name}.py").write_text(script)
    with contextlib.ExitStack() as stack:
        network = stack.enter_context(uml.switch(folder))
        server = stack.enter_context(uml.kernel(folder, "server", "server", SERVER, network=network))
        assert server.said() == "ready"
        clients = [
            stack.enter_context(uml.kernel(folder, at, "client", at, SERVER, network=network)) for at in MACHINES
        ]
        for client in clients:
            assert client.said() == "ready"
            client.tell(f"cd {folder}")
            assert client.said() == "exit 0"
        yield clients


def run(machine: uml.Kernel, script: str, *arguments: str) -> None:
    machine.tell(f"{sys.executable} {script}.py {' '.join(arguments)}")


@pytest.mark.parametrize("version", ["v3", "v4"])
def test_of_two_machines_one_takes_the_run(machines: list[uml.Kernel], version: str) -> None:
    """Every time, exactly one; and either, where it is alone."""
    folder = f"/mnt/{version}"
    machines[0].tell(f"mkdir -p {folder}/runs/{RUN}")
    assert machines[0].said() == "exit 0"
    for machine, name in zip(machines, MACHINES, strict=True):
        run(machine, "racer", folder, name)
    for racing in [machines] * ROUNDS + [[machine] for machine in machines]:
        at = time.time() + 0.2
        for machine in racing:
            machine.tell(f"{RUN} free {at}")
        assert [machine.said() for machine in racing].count("1") == 1
        for machine in racing:
            machine.tell("")
        assert [machine.said() for machine in racing] == ["free"] * len(racing)
    for machine in machines:
        machine.tell("end")
        assert machine.said() == "exit 0"


@pytest.mark.parametrize("version", ["v3", "v4"])
def test_a_frozen_machine_wakes_and_writes_nothing(machines: list[uml.Kernel], version: str) -> None:
    """Its run is left alone as long as it lives, and taken over after a lease of silence; what it wakes to is lost."""
    folder, (one, two) = f"/mnt/{version}", machines
    run(one, "owner", folder)
    assert one.said() == "owns"
    run(two, "successor", folder)
    assert two.silent(6.0)  # for longer than its lease of two seconds
    one.freeze()
    try:
        assert two.said() == "taken"
    finally:
        one.thaw()
    assert one.said() == "exit 3"
    two.tell("")
    assert [two.said(), two.said()] == ["mine", "exit 0"]
