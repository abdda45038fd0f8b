"""Where a job at work reports to: rows go into the curve, progress into the status file and up the pipe."""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from rrmctl.running.parent_link import Pipe, StopRequest, say
from rrmctl.store.curve import CurveWriter
from rrmctl.store.lease import Lease
from rrmctl.store.status import RunState, Status, write_status

if TYPE_CHECKING:
    from rrm.types import EvalRow

#: How often `status.json` is renewed between evaluations, seconds. Each time costs a flush to disk.
HEARTBEAT_S = 5.0


@dataclass(eq=False)
class RunMonitor:
    """An `rrm.training.jobs.Monitor`."""

    _lease: Lease
    status: Status  #: as last known, not always as last written
    _curve: CurveWriter
    _pipe: Pipe
    _stop: StopRequest
    _written: float = field(default_factory=time.monotonic, init=False)

    def restored(self, rows: Sequence[EvalRow]) -> None:
        lost = [row for row in rows if row.step not in self._curve]
        if lost:
            self.note(f"{len(lost)} evaluations that {self._lease.folder.curve.name} lacks come from the checkpoint")
            with self.writing():
                self._curve.add(*(row.columns() for row in lost))

    def row(self, row: EvalRow) -> None:
        values = row.columns()
        with self.writing():
            self._curve.add(values)
        shown = {name: _finite(values[name]) for name in ("success", "true_return", "wall_s", "steps_per_s")}
        self._write(rows=len(self._curve), step=row.step, **shown)
        self._pipe.send(event="row", step=row.step, success=shown["success"], true_return=shown["true_return"])

    def beat(self, step: int, steps_per_s: float) -> None:
        speed = _finite(steps_per_s)
        self._pipe.beat(step=step, steps_per_s=speed)
        self.status = dataclasses.replace(self.status, step=step, steps_per_s=speed)
        if time.monotonic() - self._written >= HEARTBEAT_S:
            self._write()

    def note(self, message: str) -> None:
        self._pipe.note(message)

    def should_stop(self) -> bool:
        return self._stop.requested

    def writing(self) -> AbstractContextManager[None]:
        return self._lease.writing()

    def close(self, state: RunState) -> None:
        """Record how the attempt ended."""
        self._write(state=state)
        say(f"--- {state} at step {self.status.step}")

    def _write(self, **changes: Any) -> None:
        self.status = dataclasses.replace(self.status, **changes, heartbeat=time.time())
        with self.writing():
            write_status(self._lease.folder, self.status)
        self._written = time.monotonic()


def _finite(value: float) -> float | None:
    """JSON has no NaN: a value that does not exist is null."""
    return value if math.isfinite(value) else None
