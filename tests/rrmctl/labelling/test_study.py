"""Whole studies as typed: runs that train, a server, and a person in a browser who presses what is shown as better."""

import contextlib
import os
import random
import signal
import time

import pytest

from rrm.teachers.labels import live
from rrmctl.store.labels import stored_labels
from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, read_status, run_status
from tests.rrmctl.cli.test_labels_command import networks, numbers
from tests.rrmctl.cli.test_run import EXPERIMENTS, call, start
from tests.rrmctl.labelling.serving import serving
from tests.rrmctl.labelling.test_page import choose, chromium, open_page  # noqa: F401 (fixtures)
from tests.rrmctl.labelling.test_server import children
from tests.rrmctl.running.test_supervisor import until

_PATIENCE_S = 240


def sweep(name, *options):
    return ["run", name, "--experiments", EXPERIMENTS, "--profile", "smoke", "--seeds", "1", *options]


def is_running(folder):
    return run_status(folder).state is RunState.RUNNING


def labelled(page, *, most=1000, between=lambda: None):
    """Answer so often at the most; whether the page says then that the study is over."""
    given, deadline = 0, time.monotonic() + _PATIENCE_S
    while (state := page.evaluate("() => document.body.dataset.state")) != "over":
        assert time.monotonic() < deadline, page.locator("#status").inner_text()
        if state == "question":
            page.keyboard.press(choose(page))
            given += 1
            if given > most:
                return False
            between()
        elif state == "feedback":
            page.keyboard.press("Enter")
        page.wait_for_timeout(30)
    return True


@contextlib.contextmanager
def training(layout, asked, *options):
    """The program that trains, from when it has written down what it was asked; it ends well."""
    program = start(*asked, *options, "--results", layout.root)
    try:
        until(lambda: any(layout.root.glob("sweeps/*/*.json")) or program.poll() is not None)
        yield
        _, said = program.communicate(timeout=_PATIENCE_S)
        assert program.returncode == 0, said
    finally:
        if program.poll() is None:
            os.killpg(program.pid, signal.SIGKILL)
            program.communicate()


@pytest.mark.slow
@pytest.mark.long
def test_a_person_in_a_browser_teaches_like_the_scripted_teacher(tmp_path, open_page):  # noqa: F811
    """Curve and network are equal to the byte."""
    asked = sweep("toy-car", "--methods", "pebble")
    scripted, layout = tmp_path / "scripted", Layout(tmp_path / "people")
    assert call(*asked, "--results", scripted).exit_code == 0
    with (
        training(layout, asked, "--set", "teacher.kind=human"),
        serving(layout.root, "--grace", "0", name="toy-car") as server,
    ):
        assert labelled(open_page(server, server.link()))
        assert server.wait() == 0
    assert numbers(layout.root) == numbers(scripted)
    assert networks(layout.root) == networks(scripted)


@pytest.mark.slow
@pytest.mark.long
def test_whoever_is_killed(tmp_path, open_page):  # noqa: F811
    """Server, renderer and workers die at random moments, the page stays open: each answer once, equal numbers."""
    asked, rng = sweep("toy-car", "--methods", "pebble,rrm-sparse"), random.Random(1)
    scripted, layout = tmp_path / "scripted", Layout(tmp_path / "people")
    assert call(*asked, "--results", scripted).exit_code == 0

    def trouble(server):
        running = [read_status(layout.run(run)).pid for run in layout.run_ids() if is_running(layout.run(run))]
        for pid in [*children(server.process.pid), *running]:
            if rng.random() < 0.3:
                with contextlib.suppress(ProcessLookupError):  # it left by itself
                    os.kill(pid, signal.SIGKILL)

    page, port, over = None, 0, False
    with training(layout, asked, "--set", "teacher.kind=human"):
        for most in [*(rng.randrange(2, 7) for _ in range(8)), 1000]:  # the last server is let live
            with serving(layout.root, "--grace", "0", "--no-practice", port=port, name="toy-car") as server:
                if page is None:
                    page = open_page(server, server.link())
                    port = server.port
                if over := labelled(page, most=most, between=lambda: trouble(server)):
                    assert server.wait() == 0
                    break
                server.end(signal.SIGKILL)
    assert over
    for run in layout.run_ids():
        rows = stored_labels(layout, [run])
        counting = [row for row in rows if row.run == run and not row.undone]
        assert len(counting) == len(live(rows)) > 0
    assert numbers(layout.root) == numbers(scripted)
    assert networks(layout.root) == networks(scripted)


@pytest.mark.slow
@pytest.mark.sim
@pytest.mark.long
def test_window_open(tmp_path, open_page, opengl):  # noqa: F811
    """The paper's study at its smallest scale, of both methods."""
    scripted, layout = tmp_path / "scripted", Layout(tmp_path / "people")
    asked = sweep("human-study")
    assert call(*asked, "--set", "teacher.kind=scripted", "--results", scripted).exit_code == 0
    with training(layout, asked), serving(layout.root, "--grace", "0", name="human-study") as server:
        assert labelled(open_page(server, server.link()))
        assert server.wait() == 0
    assert numbers(layout.root, "human-study") == numbers(scripted, "human-study")
    assert networks(layout.root, "human-study") == networks(scripted, "human-study")
