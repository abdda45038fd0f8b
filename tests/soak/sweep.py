"""One sweep of the real program, from outside: start it, look at its processes and at what it leaves."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rrmctl.store.curve import read_curve
from rrmctl.store.layout import Layout
from rrmctl.store.schema import TIMINGS

PROGRAM = (sys.executable, "-c", "from rrmctl.cli.app import main; main()")

#: Evaluations of a run as text, in order of their steps; without what the clock says.
Curve = tuple[str, ...]


@dataclass(frozen=True)
class Sweep:
    """What is run, and into which folder."""

    arguments: tuple[str, ...]  #: of `rrmctl run`
    results: Path

    def start(self) -> subprocess.Popen[bytes]:
        """The program, in a session of its own, its output in a file of the results folder."""
        self.results.mkdir(parents=True, exist_ok=True)
        command = [*PROGRAM, "run", *self.arguments, "--yes", "--results", str(self.results)]
        with (self.results / "output.txt").open("ab") as output:
            return subprocess.Popen(
                command, start_new_session=True, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT
            )

    def finish(self) -> None:
        """Run to the end, undisturbed.

        Raises:
            RuntimeError: it does not end well.
        """
        code = self.start().wait()
        if code:
            raise RuntimeError(f"{' '.join(self.arguments)} left with {code}:\n{self.output()}")

    def output(self) -> str:
        """The last lines of what the program said."""
        return "\n".join((self.results / "output.txt").read_text(errors="replace").splitlines()[-30:])

    def workers(self) -> list[int]:
        """The living workers of this results folder, whoever started them."""
        return [
            pid for pid, command in processes() if "rrmctl.running.worker" in command and str(self.results) in command
        ]

    def runs(self) -> list[str]:
        """Ids of all runs."""
        return Layout(self.results).run_ids()

    def curves(self) -> dict[str, Curve]:
        """What the store holds now of every run."""
        found = {}
        for run in self.runs():
            table = read_curve(Layout(self.results).run(run))
            rows = [] if table is None else table.drop_columns(list(TIMINGS)).to_pylist()
            found[run] = tuple(repr(sorted(row.items())) for row in rows)
        return found

    def finished_twice(self) -> list[str]:
        """Runs whose log says more than once that they are done."""
        ends = Counter[str]()
        for log in (self.results / "runs").glob("*/log.txt"):
            ends[log.parent.name] = len(re.findall(r"^--- done at step", log.read_text(errors="replace"), re.MULTILINE))
        return [run for run, count in ends.items() if count > 1]


def processes() -> list[tuple[int, Sequence[str]]]:
    """All processes with their command lines; those that end meanwhile are left out."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            command = (folder / "cmdline").read_bytes().decode(errors="replace").split("\0")
            state = (folder / "stat").read_text().rpartition(")")[2].split()[0]
        except OSError:
            continue
        if state != "Z" and int(folder.name) != os.getpid():
            found.append((int(folder.name), command))
    return found
