"""From a key to an answer on the disk: four people at once, a thousand answers to a real server over HTTP."""

from __future__ import annotations

import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from benchmarks.lines import Line
from tests.rrmctl.labelling.serving import Person, serving
from tests.rrmctl.labelling.studies import make_study

PEOPLE = ("a", "b", "c", "d")
RUNS, QUERIES = 10, 100
#: Between two keys of a person, seconds: people are slower.
THINK_S = 0.2


def lines() -> list[Line]:
    with tempfile.TemporaryDirectory(prefix="rrmctl-benchmark-") as folder:
        layout = make_study(Path(folder) / "results", runs=RUNS, queries=QUERIES)
        options = ("--no-practice", "--assign", "query", "--annotator", ",".join(PEOPLE))
        with serving(layout.root, *options) as server:
            links = [server.link(person) for person in PEOPLE]
            took: list[float] = []
            people = [Person(server.port, link) for link in links]
            threads = [threading.Thread(target=_label, args=(each, took)) for each in people]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
    middle, late = np.percentile(took, (50, 95))
    note = f"median {middle:.3g} ms"
    return [Line(item=f"key to disk, p95 of {len(took):,} answers", ours=late, unit="ms", bound=100.0, note=note)]


def _label(person: Person, took: list[float]) -> None:
    for _ in range(RUNS * QUERIES // len(PEOPLE)):
        told = person.question()
        time.sleep(THINK_S)
        begin = time.perf_counter()
        status, answer = person.answer(told)
        took.append(1e3 * (time.perf_counter() - begin))
        assert status == 200, answer
