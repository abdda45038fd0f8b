"""TensorBoard event files, one folder a run; needs `pip install 'rrmctl[tensorboard]'`.

Below the folder: VARIANT/TASK/METHOD[ TEACHER FEEDBACK]/seed-N-RUN. Every measured column is a scalar over environment
steps, missing values left out; the configuration is there as text and as hyperparameters. An event's wall-clock time is
the start of the run's first attempt plus its training time so far: pauses between attempts are left out (it counts from
1970 where no start was recorded). Exporting again replaces the files.
"""

from __future__ import annotations

import io
import json
import math
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rrmctl.export.bundle import Bundle
from rrmctl.export.formats import require
from rrmctl.store.files import write_bytes
from rrmctl.store.records import settings
from rrmctl.store.snapshot import Run

#: Always the same, so that a second export takes the place of the first.
_FILE = "events.out.tfevents.rrmctl"

#: Part of the dashboard in which a column stands; those of no other part describe the reward the agent learned from.
_PARTS = {
    "eval": ("true_return", "success", "episodes"),
    "feedback": ("queries", "labels"),
    "agent": ("critic_loss", "actor_loss", "entropy", "alpha"),
    "time": ("wall_s", "steps_per_s"),
}


def tag(column: str) -> str:
    """The scalar's name in TensorBoard, such as `eval/success`."""
    part = next((part for part, columns in _PARTS.items() if column in columns), "reward")
    return f"{part}/{column}"


def write(bundle: Bundle, folder: Path) -> list[Path]:
    """Write an event file for every run with an evaluation."""
    require("tensorboard")
    from tensorboard.summary.writer.record_writer import RecordWriter

    paths = [folder / run_folder(run) / _FILE for run in bundle.begun]
    for run, path in zip(bundle.begun, paths, strict=True):
        buffer = io.BytesIO()
        records = RecordWriter(buffer)
        for event in _events(run):
            records.write(event.SerializeToString())
        write_bytes(path, buffer.getvalue())
    return paths


def run_folder(run: Run) -> Path:
    """Where a run's events are, below the folder of the export."""
    plan = run.plan
    names = (plan["variant"], plan["task"], " ".join(run.row.words[1:]), f"seed-{plan['seed']}-{run.id[:8]}")
    return Path(*(re.sub(r"^\.|[^\w.@+ -]", "-", name) for name in names))


def _events(run: Run) -> Iterator[Any]:
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import Summary
    from tensorboard.plugins.hparams.summary_v2 import hparams_pb
    from tensorboard.plugins.text.summary_v2 import text_pb

    start = run.started or 0.0
    yield Event(wall_time=start, file_version="brain.Event:2")
    about = {"plan": run.plan, "config": run.config, "provenance": run.provenance}
    for name, content in about.items():
        block = textwrap.indent(json.dumps(content, indent=2, default=str), "    ")  # which Markdown leaves as it is
        yield Event(wall_time=start, step=0, summary=text_pb(name, block))
    hyper = {
        name: value if isinstance(value, str | bool | int | float) else str(value)
        for name, value in settings(run.config or {}).items()
        if value is not None
    }
    yield Event(wall_time=start, step=0, summary=hparams_pb(hyper, run.id, start))
    for row in run.curve.to_dict("records"):
        values = [
            Summary.Value(tag=tag(str(column)), simple_value=row[column])
            for column in row
            if column != "step" and math.isfinite(row[column])
        ]
        yield Event(wall_time=start + row["wall_s"], step=row["step"], summary=Summary(value=values))
