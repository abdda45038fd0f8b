"""What other programs get of the store: read back with their own readers."""

import dataclasses
import json
import os
import socket
import struct
import subprocess
import sys
from importlib import metadata

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from rrmctl.cli.app import app
from rrmctl.export.bundle import COLUMNS, OTHER_RUN_COLUMNS, RUN_COLUMNS, read
from rrmctl.export.formats import formats
from rrmctl.export.formats.tensorboard import run_folder, tag
from rrmctl.store import load
from rrmctl.store.layout import Layout
from rrmctl.store.records import write_json
from rrmctl.store.schema import MEASURED
from rrmctl.store.snapshot import Snapshot, table
from tests.rrmctl.reports.frames import FIGURES, Sweep

TASK = "button-press"
#: One of three runs is done, one failed on its way, one was never begun.
PARTIAL = Sweep(
    curves={"pebble": [[0, 0.5, 1.0]] * 3},
    states={(TASK, "pebble", 1): "failed", (TASK, "pebble", 2): "queued"},
    lengths={(TASK, "pebble", 1): 2, (TASK, "pebble", 2): 0},
)
STARTED = "2026-01-02T03:04:05+00:00"
STARTED_S = 1767323045.0


@pytest.fixture
def results(tmp_path):
    root = tmp_path / "results"
    PARTIAL.write(root)
    for run in Layout(root).run_ids():
        facts = {
            "schema_version": 1,
            "started": STARTED,
            "host": "here",
            "versions": {"torch": "1"},
            "code": "c0de",
            "resumed": [],
        }
        write_json(Layout(root).run(run).provenance, facts)
    return root


def export(results, form, output, *more):
    words = ["export", "main-results", "--to", form, "--results", results, "-o", output, *more]
    return CliRunner().invoke(app, [str(word) for word in words])


def content(folder):
    """Every file below a folder with its bytes."""
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_csv_reads_back_exactly(results, tmp_path):
    """`evaluations.csv` holds what `load` tells, every number to its last digit, under every label."""
    assert export(results, "csv", tmp_path / "out").exit_code == 0
    texts = dict.fromkeys((name for name, column in COLUMNS.items() if column.kind == "string"), str)
    back = pd.read_csv(tmp_path / "out" / "evaluations.csv", dtype=texts)
    wanted = load(results, "main-results").astype({"seed": "int64"})
    assert list(back.columns) == [*COLUMNS, *FIGURES]
    pd.testing.assert_frame_equal(wanted[list(back.columns)], back, check_dtype=False)


def test_csv_tells_of_every_planned_run(results, tmp_path):
    """Runs without an evaluation stand in runs.csv and, with the reason, in the data dictionary."""
    export(results, "csv", tmp_path)
    runs = pd.read_csv(tmp_path / "runs.csv")
    assert list(runs["state"]) == ["done", "failed", "queued"]
    assert list(runs["evaluations"]) == [3, 2, 0]
    package = json.loads((tmp_path / "datapackage.json").read_text())
    assert [run["state"] for run in package["runs_without_rows"]] == ["queued"]
    assert package["planned_runs"] == 3


def test_the_data_dictionary_is_complete(results, tmp_path):
    """Every column of both files is described, in order; measured ones as the store has them."""
    export(results, "csv", tmp_path)
    for resource in json.loads((tmp_path / "datapackage.json").read_text())["resources"]:
        header = (tmp_path / resource["path"]).read_text().splitlines()[0].split(",")
        assert header == [column["name"] for column in resource["schema"]["fields"]]
        assert all(column["description"] for column in resource["schema"]["fields"])
    assert list(COLUMNS)[len(RUN_COLUMNS) :] == list(MEASURED)
    assert set(table(Snapshot(results).runs())) <= {*COLUMNS, *OTHER_RUN_COLUMNS}


def test_tensorboard_reads_its_files(results, tmp_path):
    """Each run is a folder that TensorBoard's own reader opens: values, steps, times, configuration."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    assert export(results, "tensorboard", tmp_path / "tb").exit_code == 0
    runs = read(results, "main-results").begun
    assert len(content(tmp_path / "tb")) == len(runs) == 2
    for run in runs:
        events = EventAccumulator(str(tmp_path / "tb" / run_folder(run))).Reload()
        assert {tag(column) for column in (*MEASURED, *FIGURES) if column != "step"} == set(events.Tags()["scalars"])
        success = events.Scalars("eval/success")
        assert [event.step for event in success] == list(run.curve["step"])
        np.testing.assert_allclose([event.value for event in success], run.curve["success"], rtol=1e-6)
        assert [event.wall_time for event in success] == [STARTED_S + s for s in run.curve["wall_s"]]
        assert run.id in events.Tensors("config")[0].tensor_proto.string_val[0].decode()
        assert "_hparams_/session_start_info" in events.Tags()["tensors"]


def test_no_name_leads_out_of_the_folder(results):
    """Whatever a record says a task or a method is called, the run's files stay below."""
    (run, *_) = read(results, "main-results").begun
    for name in ("..", "../../x", "/etc", "."):
        plan = run.plan | {"task": name, "method": name}
        assert not {"..", ".", "/"} & {*run_folder(dataclasses.replace(run, plan=plan)).parts}


def test_missing_values_are_no_scalars(tmp_path):
    """A task without success has no curve of it, rather than one of zeros."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    Sweep(curves={"oracle": [[0.5, 1]]}, tasks=("walker-walk",)).write(tmp_path / "results")
    export(tmp_path / "results", "tensorboard", tmp_path / "tb")
    (run,) = read(tmp_path / "results", "main-results").begun
    scalars = EventAccumulator(str(tmp_path / "tb" / run_folder(run))).Reload().Tags()["scalars"]
    assert "eval/success" not in scalars
    assert "eval/true_return" in scalars


def wandb_records(path):
    """The records of a .wandb file: LevelDB's log format, after a header of seven bytes, in blocks of 32 KiB."""
    from wandb.proto.wandb_internal_pb2 import Record

    data, at, whole = path.read_bytes(), 7, b""
    while at + 7 <= len(data):
        room = 32768 - at % 32768
        _, size, kind = struct.unpack_from("<IHB", data, at) if room >= 7 else (0, 0, 0)
        if kind == 0:  # padding
            at += room
            continue
        whole += data[at + 7 : at + 7 + size]
        at += 7 + size
        if kind in (1, 4):  # whole, or the last piece
            record = Record()
            record.ParseFromString(whole)
            whole = b""
            yield record


@pytest.mark.slow
def test_wandb_reads_its_runs(results, tmp_path):
    """Each run is an offline run with its identity, configuration, rows, times and exit code."""
    ran = export(results, "wandb", tmp_path / "out")
    assert ran.exit_code == 0, ran.output
    for run in read(results, "main-results").begun:
        (path,) = (tmp_path / "out" / "wandb").glob(f"offline-run-20260102_030405-{run.id}/run-{run.id}.wandb")
        records = {}
        for record in wandb_records(path):
            records.setdefault(record.WhichOneof("record_type"), []).append(record)
        told = records["run"][0].run
        assert (told.run_id, told.project) == (run.id, "main-results")
        config = {update.key: json.loads(update.value_json) for update in told.config.update}
        assert config["cell"] == run.plan["cell"]
        rows = [{i.nested_key[0]: json.loads(i.value_json) for i in each.history.item} for each in records["history"]]
        assert [row["step"] for row in rows] == list(run.curve["step"])
        assert [row["success"] for row in rows] == list(run.curve["success"])
        assert [row["_timestamp"] for row in rows] == [STARTED_S + s for s in run.curve["wall_s"]]
        assert records["exit"][0].exit.exit_code == int(run.plan["state"] == "failed")


@pytest.mark.slow
def test_wandb_asks_nobody(results, tmp_path):
    """No connection is tried, no prompt waits, and nothing is left outside of the folder or in the environment."""
    home = tmp_path / "home"
    home.mkdir()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(0.01)
        proxy = f"http://127.0.0.1:{listener.getsockname()[1]}"
        environment = os.environ | {
            "HOME": str(home),
            "HTTPS_PROXY": proxy,
            "HTTP_PROXY": proxy,
            "WANDB_MODE": "online",
        }
        command = ["export", "main-results", "--to", "wandb", "--results", str(results), "-o", str(tmp_path / "out")]
        ran = subprocess.run(
            [sys.executable, "-c", "from rrmctl.cli.app import main; main()", *command],
            env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, cwd=home,
        )  # fmt: skip
        assert ran.returncode == 0, ran.stderr
        with pytest.raises(TimeoutError):
            listener.accept()
    assert list(home.rglob("*")) == []
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["wandb"]


@pytest.mark.slow
@pytest.mark.parametrize("form", sorted(formats()))
def test_exporting_twice_does_not_double(results, tmp_path, form):
    """A second export leaves every byte as it was."""
    export(results, form, tmp_path / "out")
    first = content(tmp_path / "out")
    assert export(results, form, tmp_path / "out").exit_code == 0
    assert content(tmp_path / "out") == first


@pytest.mark.slow
@pytest.mark.parametrize("form", sorted(formats()))
def test_what_has_grown_takes_the_place_of_what_was(tmp_path, form):
    """A run that has gone on since the last export is there once, as it is now."""
    Sweep(lengths={(TASK, "pebble", 0): 2}).write(tmp_path / "results")
    export(tmp_path / "results", form, tmp_path / "out")
    names = set(content(tmp_path / "out"))
    before = content(tmp_path / "out")
    Sweep().write(tmp_path / "results")
    export(tmp_path / "results", form, tmp_path / "out")
    after = content(tmp_path / "out")
    assert set(after) == names
    data = [name for name in names if name.suffix in (".csv", ".wandb", ".rrmctl")]
    assert len([name for name in data if before[name] != after[name]]) == {"csv": 2}.get(form, 1)


@pytest.mark.parametrize("form", ["tensorboard", "wandb"])
def test_a_missing_package_is_one_message(results, tmp_path, form, monkeypatch):
    """Without the extra: exit code 2 and the command that installs it."""
    version = metadata.version

    def without(package):
        if package == form:
            raise metadata.PackageNotFoundError(package)
        return version(package)

    monkeypatch.setattr(metadata, "version", without)
    ran = export(results, form, tmp_path / "out")
    assert ran.exit_code == 2
    assert f"pip install 'rrmctl[{form}]'" in ran.stderr
    assert "Traceback" not in ran.stderr


def test_an_unknown_format_is_answered_with_the_nearest(results, tmp_path):
    """A misspelt format is one message with what there is."""
    ran = export(results, "tensorbord", tmp_path / "out")
    assert ran.exit_code == 2
    assert 'did you mean "tensorboard"' in ran.stderr


def test_a_format_is_a_file():
    """The command's help names every module of the folder, without loading any."""
    code = (
        "import sys; from typer.testing import CliRunner; from rrmctl.cli.app import app;"
        "print(CliRunner().invoke(app, ['export', '--help'], env={'COLUMNS': '200'}).stdout);"
        "print({'pandas', 'tensorboard', 'wandb', 'numpy'} & set(sys.modules))"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert {"csv", "tensorboard", "wandb"} == set(formats())
    assert all(f"{name}: " in told for name in formats())
    assert "rrmctl[wandb]" in told
    assert told.endswith("set()\n")


def test_nothing_to_export_is_said(tmp_path):
    """A plan without any evaluation is exported as such, with a note."""
    Sweep(curves={"pebble": [[]]}, states={(TASK, "pebble", 0): "queued"}).write(tmp_path / "results")
    ran = export(tmp_path / "results", "csv", tmp_path / "out")
    assert ran.exit_code == 0
    assert "none of the 1 planned runs" in ran.stderr
    assert (tmp_path / "out" / "evaluations.csv").read_text().startswith("experiment,variant")


@pytest.mark.slow
def test_a_place_that_takes_no_write_is_named(results, tmp_path):
    """An impossible folder is one message with exit code 2, in every format."""
    blocker = tmp_path / "file"
    blocker.write_text("")
    for form in formats():
        ran = export(results, form, blocker / "out")
        assert ran.exit_code == 2
        assert str(blocker) in ran.stderr
