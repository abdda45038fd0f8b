"""The pipe between a worker and its parent."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rrmctl.running.executor import Event, Note, WorkOrder
from rrmctl.running.local import Child
from rrmctl.running.parent_link import Pipe, StopRequest, _line
from rrmctl.store.layout import Layout
from rrmctl.store.status import ErrorKind, RunError


@pytest.fixture
def ends() -> Iterator[tuple[int, Pipe]]:
    reading, writing = os.pipe()
    yield reading, Pipe(writing)
    for descriptor in (reading, writing):
        try:
            os.close(descriptor)
        except OSError:
            continue  # the test closed it


def received(reading: int) -> list[dict[str, object]]:
    return [json.loads(line) for line in os.read(reading, 1 << 20).splitlines()]


def test_messages_are_lines_of_json(ends: tuple[int, Pipe]) -> None:
    """Beats are few however often they are given."""
    reading, pipe = ends
    for step in range(1000):
        pipe.beat(step=step, steps_per_s=None)
    pipe.send(event="error", **asdict(RunError(kind=ErrorKind.REFUSED, type="PriorError", message="NaN")))
    first, *_, last = received(reading)
    assert first == {"event": "beat", "step": 0, "steps_per_s": None}
    assert last == {"event": "error", "kind": "refused", "type": "PriorError", "message": "NaN"}


@given(st.text(max_size=20_000), st.text(max_size=20_000))
def test_any_message_arrives_as_one_whole_line(kind: str, text: str) -> None:
    """However long and whatever the characters, a line is short enough to be written at once, and begins as given."""
    line = _line({"event": "error", "type": kind, "message": text})
    told = json.loads(line)
    assert len(line) <= 4096
    assert line.count(b"\n") == 1
    assert text.startswith(told["message"])
    assert kind.startswith(told["type"])


def test_a_reader_that_sleeps_does_not_stop_the_worker(ends: tuple[int, Pipe]) -> None:
    """When the pipe is full messages are dropped, whole ones; the rest can still be read."""
    reading, pipe = ends
    for step in range(5000):
        pipe.send(event="row", step=step, text="x" * 100)
    assert [message["step"] for message in received(reading)[:3]] == [0, 1, 2]
    assert not pipe.broken


def test_a_reader_that_is_gone_means_stop(ends: tuple[int, Pipe]) -> None:
    """A worker whose parent closed the pipe notices at its next message."""
    reading, pipe = ends
    with StopRequest(None, pipe) as stop:
        os.close(reading)
        assert not stop.requested
        pipe.send(event="beat")
        assert stop.requested


def test_sigterm_means_stop_and_the_handler_goes_with_the_context() -> None:
    """Only while it is in use does a stop request take the signals."""
    before = signal.getsignal(signal.SIGTERM)
    with StopRequest(os.getppid(), Pipe(None)) as stop:
        os.kill(os.getpid(), signal.SIGTERM)
        assert stop.requested
    assert signal.getsignal(signal.SIGTERM) is before


def test_another_parent_than_expected_means_stop() -> None:
    """A worker that was orphaned before it looked for the first time notices as well."""
    with StopRequest(os.getpid(), Pipe(None)) as stop:
        assert stop._requested.wait(10.0)


def test_a_worker_that_cannot_leave_ends_itself_and_what_it_started() -> None:
    """Its parent is gone and it does nothing about that: after its time (here short) nothing of its group is left."""
    script = (
        "import os, subprocess, sys, time; from rrmctl.running import parent_link as l; l._GRACE_S = 0.2;"
        "other = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(600)'], stdout=subprocess.DEVNULL);"
        "print(other.pid, flush=True); l.StopRequest(os.getpid(), l.Pipe(None)).__enter__(); time.sleep(600)"
    )
    worker = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, start_new_session=True)
    assert worker.stdout is not None
    other = Path(f"/proc/{int(worker.stdout.readline())}/stat")
    assert worker.wait(60) == -signal.SIGKILL
    while other.exists() and other.read_text().rpartition(")")[2].split()[0] != "Z":
        time.sleep(0.02)
    worker.stdout.close()


def test_rubbish_in_the_pipe_is_shown_not_obeyed(tmp_path: Path) -> None:
    """A line that is no message, or one of another program's, reaches a person as a note."""
    layout = Layout(tmp_path)
    layout.run("r").path.mkdir(parents=True)
    script = "import os, sys; pipe = int(sys.argv[sys.argv.index('--pipe') + 1]); os.write(pipe, sys.argv[1].encode())"
    strange = [
        '{"event": "start", "attempt": 1, "colour": 2}',
        '{"event": "error", "kind": "odd", "type": "x", "message": "y"}',
    ]
    lines = "\n".join(["rubbish", "[1]", '{"event": "x"}', *strange, ""])
    child = Child(layout, WorkOrder(run="r", threads=1), command=[sys.executable, "-c", script, lines])
    events: list[Event] = []
    while child.open:
        events += child.events()
    child.wait()
    assert events == [Note("r", repr(line.encode())) for line in ("rubbish", "[1]", *strange)]


def test_a_group_is_ended_while_its_number_is_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its leader has ended and is not reaped yet when the signal is sent; afterwards none is sent any more."""
    layout = Layout(tmp_path)
    layout.run("r").path.mkdir(parents=True)
    child = Child(layout, WorkOrder(run="r", threads=1), command=[sys.executable, "-c", "pass"])
    leader = Path(f"/proc/{child._process.pid}/stat")
    states = []

    def observed(group: int, number: int) -> None:
        assert group == child._process.pid
        states.append(leader.read_text().rpartition(")")[2].split()[0])
        send(group, number)

    send = os.killpg
    monkeypatch.setattr(os, "killpg", observed)
    while not child.ended():
        time.sleep(0.02)
    assert child.ended()
    child.kill()
    assert states == ["Z"]
    assert not leader.exists()
    child.close()
