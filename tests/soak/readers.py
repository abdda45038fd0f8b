"""Somebody who looks at a sweep all the while it is attacked."""

from __future__ import annotations

import sys
import threading
import time
import traceback
from collections import Counter
from types import TracebackType
from typing import Self

import pandas as pd

from rrmctl.store import load, planned
from tests.soak.sweep import Curve, Sweep

_PAUSE_S = 0.5


class Readers:
    """Reads over and over in a thread, as a context: through the store, and the parquet files with plain pandas.

    Args:
        found: counts errors that were met (`readers`) and evaluations that were seen once and later were not (`lost`).
    """

    def __init__(self, sweep: Sweep, found: Counter[str]) -> None:
        self._sweep = sweep
        self._found = found
        self._known: dict[str, Curve] = {}
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._repeat)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop.set()
        self._thread.join()

    def _repeat(self) -> None:
        while not self._stop.wait(_PAUSE_S):
            try:
                self._read()
            except Exception:
                self._found["readers"] += 1
                sys.stderr.write(f"{time.strftime('%H:%M:%S')} a reader met:\n{traceback.format_exc()}")

    def _read(self) -> None:
        results = self._sweep.results
        if not (results / "sweeps").exists():
            return
        load(results)
        planned(results)
        for path in results.glob("runs/*/curve.parquet"):
            pd.read_parquet(path)
        now = self._sweep.curves()
        for run, curve in self._known.items():
            self._found["lost"] += len(set(curve) - set(now.get(run, ())))
        self._known = now
