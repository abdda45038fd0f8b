"""Commands that see runs to their end are known while they live, to those of their machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from rrmctl.store.drivers import Driver, drivers, driving
from rrmctl.store.layout import Layout
from rrmctl.store.owner import HERE, Machine


def known(layout: Layout, experiment: str = "toy-car") -> list[tuple[int, bool]]:
    return [(driver.pid, driver.here) for driver in drivers(layout, experiment)]


def test_known_while_it_lasts(tmp_path: Path) -> None:
    """For its experiments, with what goes on in its way."""
    layout = Layout(tmp_path)
    with driving(layout, ["toy-car", "quickstart"], ["--executor", "ray"]):
        expected = [Driver(HERE.host, os.getpid(), True, ("--executor", "ray"))]
        assert drivers(layout, "toy-car") == drivers(layout, "quickstart") == expected
        assert drivers(layout, "main-results") == []
    assert drivers(layout, "toy-car") == []
    assert list(layout.drivers.iterdir()) == []


def test_one_that_was_killed_is_not_known(tmp_path: Path) -> None:
    """Nor is its file, once there is another; the numbers of processes come again."""
    code = (
        "import sys, time; from pathlib import Path\n"
        "from rrmctl.store.drivers import driving; from rrmctl.store.layout import Layout\n"
        "with driving(Layout(Path(sys.argv[1])), ['toy-car']): print(flush=True); time.sleep(100)"
    )
    layout = Layout(tmp_path)
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stdout=subprocess.PIPE) as other:
        assert other.stdout is not None
        other.stdout.readline()
        assert known(layout) == [(other.pid, True)]
        other.send_signal(signal.SIGKILL)
    (left,) = layout.drivers.iterdir()
    assert known(layout) == []
    with driving(layout, ["toy-car"]):
        assert known(layout) == [(os.getpid(), True)]
        assert not left.exists()


def test_on_another_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is known as that: its number is nobody's here. Nor are those of a container of this machine's name."""
    layout = Layout(tmp_path)
    for here in (Machine("n1.lab", "b"), Machine(HERE.host, "b")):
        with monkeypatch.context() as elsewhere:
            elsewhere.setattr("rrmctl.store.drivers.HERE", here)
            own = driving(layout, ["toy-car"])
            own.__enter__()
        assert known(layout) == [(os.getpid(), False)]
        with monkeypatch.context() as elsewhere:
            elsewhere.setattr("rrmctl.store.drivers.HERE", Machine("n1", "c"))
            with driving(layout, ["toy-car"]):
                assert len(known(layout)) == 2
        own.__exit__(None, None, None)
        assert known(layout) == []


def test_what_is_no_driver_is_ignored(tmp_path: Path) -> None:
    layout = Layout(tmp_path)
    with driving(layout, ["toy-car"]):
        for name, content in (
            ("notes.txt", b"{}"),
            (f"{HERE.host}.1", b"\xff"),
            (f"{HERE.host}.2", b"[]"),
            ("n.3", b"{}"),
        ):
            (layout.drivers / name).write_bytes(content)
        assert known(layout) == [(os.getpid(), True)]
