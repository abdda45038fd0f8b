"""Results folders that others put together: whatever lies in a file's place, commands end, with a message."""

import json
import os
import shutil

import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.store.layout import Layout
from rrmctl.store.snapshot import Snapshot
from rrmctl.store.status import ErrorKind, RunError, RunState, Status, write_status
from tests.rrmctl.reports.frames import Sweep


def bytes_of(text):
    return lambda path: path.write_bytes(text if isinstance(text, bytes) else text.encode())


def changed(**fields):
    """The object of a file with other values, without its checksum, as somebody's hand leaves it."""

    def change(path):
        content = json.loads(path.read_text()) if path.exists() and path.suffix == ".json" else {}
        content.pop("checksum", None)
        path.write_text(json.dumps(content | fields))

    return change


ODD = {
    "pipe": os.mkfifo,
    "folder": os.mkdir,
    "circle": lambda path: path.symlink_to(path),
    "device": lambda path: path.symlink_to("/dev/zero"),
    "depth": bytes_of('{"a":' + "[" * 100_000),
    "less depth": bytes_of('{"a":' + "[" * 500 + "]" * 500 + "}"),
    "no number": changed(step=float("nan"), heartbeat=float("inf"), seed=float("nan"), count=float("inf")),
    "digits": bytes_of('{"step": ' + "9" * 5000 + "}"),
    "large": changed(step=10**400, steps=10**400, count=10**400, seed=10**30, threads=10**30),
    "half a character": changed(host="\ud800", task="\ud800", argv=["\ud800"], owner="\ud800", error="\ud800"),
    "other words": changed(started=7, argv=[1], versions=[], resumed=[1], pairs=[1], jobs=[1], overrides=[]),
    "other bytes": bytes_of(b'{"a": "\xff\xfe"}'),
    "nothing": bytes_of(b""),
}
FILES = ("status.json", "config.json", "provenance.json", "curve.parquet", "log.txt", "lease.json", "lock", "sweep")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Two runs, of which one says that it is under way."""
    root = tmp_path_factory.mktemp("whole")
    Sweep(curves={"pebble": [[0.0, 0.5]] * 2}).write(root)
    write_status(Layout(root).run(Snapshot(root).runs()[0].id), Status(state=RunState.RUNNING, step=100, steps=200))
    return root


@pytest.fixture
def root(whole, tmp_path):
    """A copy to be broken."""
    return shutil.copytree(whole, tmp_path / "results")


def call(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.mark.slow
@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize("file", FILES)
def test_nothing_is_waited_for_and_nothing_breaks(root, file, odd):
    """Pipes, folders, circles of links, devices, odd nesting, numbers and characters: exit code 0 or 2."""
    run = Snapshot(root).runs()[0].id
    path = Layout(root).sweep_files("main-results")[0] if file == "sweep" else Layout(root).run(run).path / file
    if odd in ("pipe", "folder", "circle", "device"):
        path.unlink(missing_ok=True)
    ODD[odd](path)
    commands = [
        ("status",),
        ("status", "--failed", "--json"),
        ("show", run),
        ("report", "iqm", "main-results", "--replicates", "100"),
    ]
    if odd == "other words":  # what a page reads beyond the others
        commands.append(("report", "html", "-o", root / "page.html", "--replicates", "100"))
    for command in commands:
        result = call(*command, "--results", root)
        assert result.exit_code in (0, 2), (command, result.output, result.exception)
        assert isinstance(result.exception, SystemExit | None), (command, result.exception)


@pytest.mark.slow
def test_a_label_that_is_no_schedule_is_a_label(tmp_path):
    """A record may call its feedback anything: reports and pages take it for a name."""
    Sweep(feedback="now and then").write(tmp_path)
    assert (
        call("report", "html", "-o", tmp_path / "page.html", "--replicates", "100", "--results", tmp_path).exit_code
        == 0
    )
    assert "now and then" in (tmp_path / "page.html").read_text()
    assert call("report", "claims", "--results", tmp_path).exit_code == 0
    assert call("plot", "main-results", "--results", tmp_path, "-o", tmp_path / "figures").exit_code == 0


EVIL = "\x1b[2J\x1b]0;owned\x07\x9b31m\u202e"


@pytest.mark.slow
@pytest.mark.parametrize("terminal", [False, True])
def test_what_a_store_says_is_text_to_the_terminal(root, terminal):
    """Escape sequences in names, errors and logs are spelled out by every command; colours are the program's own."""
    sweep, run = Layout(root).sweep_files("main-results")[0], Snapshot(root).runs()[0].id
    record = json.loads(sweep.read_text())
    for job in record["jobs"]:
        job.update(dict.fromkeys(("task", "method", "teacher", "feedback"), EVIL))
    sweep.write_text(json.dumps(record))
    error = RunError(kind=ErrorKind.CRASHED, type="ValueError", message=EVIL)
    write_status(Layout(root).run(run), Status(state=RunState.FAILED, error=error))
    Layout(root).run(run).log.write_text(f"{EVIL}\n")
    environment = {"FORCE_COLOR": "1", "TERM": "xterm"} if terminal else {}
    for command in (
        ("status",), ("status", "main-results"), ("status", "--failed"), ("status", "--json"), ("show", run),
        ("report", "iqm", "main-results"), ("report", "iqm", "main-results", "--format", "markdown"),
        ("report", "iqm", "main-results", "--format", "csv"), ("resume", "--workers", "1"),
    ):  # fmt: skip
        result = CliRunner(env=environment).invoke(app, [*command, "--results", str(root)])
        assert isinstance(result.exception, SystemExit | None), (command, result.exception)
        for sign in ("\x1b[2J", "\x1b]0", "\x07", "\x9b", "\u202e"):
            assert sign not in result.output, (command, sign)
    assert "\\x1b[2J" in call("show", run, "--results", root).output
