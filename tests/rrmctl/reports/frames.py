"""Stores with known content: as the DataFrames a report starts from, and as files below a results root."""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from rrmctl.store.curve import SETTINGS, table_of
from rrmctl.store.files import write_table
from rrmctl.store.layout import Layout
from rrmctl.store.records import write_json
from rrmctl.store.schema import IDENTITY, MEASURED
from rrmctl.store.snapshot import PLANNED
from rrmctl.store.status import RunState, Status, write_status
from rrmctl.store.sweeps import Job, SweepRecord, record_sweep

#: Success of each seed at steps 100, 200, 300, 400; the true return is a thousand times that.
RISING = {
    "oracle": [[0.5, 1, 1, 1], [0.4, 1, 1, 1], [0.7, 1, 1, 1], [0, 0.9, 1, 1], [0.6, 1, 1, 1]],
    "pebble": [[0, 0, 0.5, 0.9], [0, 0, 0, 0.2], [0, 0.1, 0.7, 1], [0, 0, 0.4, 0.6], [0, 0, 0.1, 0.4]],
    "rrm-proxy": [[0, 0.6, 1, 1], [0.1, 0.8, 1, 0.9], [0, 0.3, 1, 1], [0, 0.5, 0.9, 1], [0.2, 0.9, 1, 1]],
}
SATURATED = {method: [[1.0] * 4] * 5 for method in RISING}
FEEDBACK = "50@5000/5000"
#: What a run's provenance says, as far as it is compared.
RECORDED = {
    "versions": {"rrmctl": "0.1.0", "torch": "2.6.0"},
    "fingerprint": {"metaworld": "3.1.1", "mujoco": "3.3.0", "true_reward": "aaaa"},
    "code": "c0de",
}
NAMES = list(PLANNED)
RETURN_TASKS = ("walker-walk", "quadruped-walk")


#: What agents and sources of rewards say of themselves.
FIGURES = ("label_accuracy", "true_accuracy", "critic_loss", "actor_loss", "entropy", "alpha")


@dataclass
class Sweep:
    """One variant of an experiment, from which runs can be taken out or changed."""

    curves: dict[str, list[list[float]]] = field(default_factory=lambda: RISING)
    tasks: tuple[str, ...] = ("button-press",)
    experiment: str = "main-results"
    profile: str = "laptop"
    variant: str = "laptop"
    overrides: dict[str, object] = field(default_factory=dict)
    feedback: str = FEEDBACK
    teacher: str = "oracle"
    every: int = 100  #: steps between evaluations
    measured: dict[str, dict[str, list[float]]] = field(default_factory=dict)  #: method -> column -> at each evaluation
    states: dict[tuple[str, str, int], str] = field(default_factory=dict)  #: (task, method, seed); done otherwise
    lengths: dict[tuple[str, str, int], int] = field(default_factory=dict)  #: evaluations; all otherwise
    cells: dict[tuple[str, str, int], str] = field(default_factory=dict)
    versions: dict[tuple[str, str, int], int] = field(default_factory=dict)  #: of the configuration; 2 otherwise
    precisions: dict[tuple[str, str, int], str] = field(default_factory=dict)  #: float32 otherwise
    devices: dict[tuple[str, str, int], str] = field(default_factory=dict)  #: none is recorded otherwise, as once
    recorded: dict[tuple[str, str, int], dict[str, object]] = field(default_factory=dict)  #: instead of `RECORDED`

    def jobs(self) -> pd.DataFrame:
        rows = []
        for seed in range(max(map(len, self.curves.values()))):
            for task in self.tasks:
                for method in (name for name, seeds in self.curves.items() if seed < len(seeds)):
                    key = (task, method, seed)
                    asked = not method.startswith(("oracle", "sac-"))
                    labels = (task, method, *((self.teacher, self.feedback) if asked else ("-", "-")), seed)
                    own = () if labels[2:4] in (("oracle", FEEDBACK), ("-", "-")) else labels[2:4]
                    own = (*own, *self._version(key))
                    run = digits(self.variant, *key, *own)
                    cell = self.cells.get(key, digits(self.variant, task, method, *own))
                    who = (self.experiment, self.variant, self.profile, json.dumps(self.overrides))
                    rows.append((*who, *labels, run, cell, self.states.get(key, "done"), 1, 400, 400, ""))
        return pd.DataFrame(rows, columns=NAMES)

    def _version(self, key: tuple[str, str, int]) -> tuple[int, ...]:
        """Part of a run's identity, where it is not the usual one."""
        return (self.versions[key],) if key in self.versions else ()

    def rows(self) -> pd.DataFrame:
        rows = []
        for job in self.jobs().to_dict("records"):
            key = (job["task"], job["method"], job["seed"])
            curve = self.curves[job["method"]][job["seed"]]
            for number, success in enumerate(curve[: self.lengths.get(key, len(curve))], start=1):
                measured = dict.fromkeys((*MEASURED, *FIGURES), 0.0) | {"step": self.every * number, "episodes": 10}
                measured |= {"success": success, "true_return": 1000.0 * success}
                measured |= {name: at[number - 1] for name, at in self.measured.get(job["method"], {}).items()}
                if job["task"] in RETURN_TASKS:
                    measured["success"] = float("nan")
                labels = {name: job[name] for name in (*NAMES[:3], *NAMES[4:12])}
                rows.append(labels | measured)
        return pd.DataFrame(rows, columns=[*NAMES[:3], *NAMES[4:12], *MEASURED, *FIGURES])

    def frames(self) -> tuple[pd.DataFrame, pd.DataFrame]:
        return self.rows(), self.jobs()

    def evaluation(self) -> dict[str, dict[str, object]]:
        return {cell: {"success": "any", "deterministic": True} for cell in self.jobs()["cell"]}

    def write(self, root: Path) -> None:
        """The same as files, through the store's own writers."""
        layout, jobs, rows = Layout(root), self.jobs(), self.rows()
        names = ("cell", "task", "method", "teacher", "feedback", "seed", "steps")
        records = tuple(Job(id=job["run"], **{n: job[n] for n in names}) for job in jobs.to_dict("records"))
        sweep = SweepRecord(
            experiment=self.experiment,
            variant=self.variant,
            profile=self.profile,
            overrides=self.overrides,
            jobs=records,
        )
        record_sweep(layout, sweep)
        for job in jobs.to_dict("records"):
            folder = layout.run(job["run"])
            told = {name: job[name] for name in ("profile", "task", "method", "seed", "cell", "steps")}
            key = (job["task"], job["method"], job["seed"])
            told |= {"id": folder.id, "config_version": self.versions.get(key, 2), "threads": 1}
            told["precision"] = self.precisions.get(key, "float32")
            told |= {"device": self.devices[key]} if key in self.devices else {}
            if self.recorded.get(key, RECORDED):
                write_json(folder.provenance, {"schema_version": 1, "resumed": [], **self.recorded.get(key, RECORDED)})
            write_json(folder.config, told | {"evaluation": {"success": "any", "deterministic": True}})
            write_status(folder, Status(state=RunState(job["state"]), steps=400))
            curve = rows[rows["run"] == job["run"]][[*IDENTITY, *MEASURED, *FIGURES]]
            curve = curve.astype({"queries": int, "labels": int})
            if len(curve):
                write_table(folder.curve, table_of(curve.to_dict("records")), **SETTINGS)


def together(*sweeps: Sweep) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The frames of several sweeps of one variant as if it had been one; runs that they share appear once."""
    rows, jobs = (pd.concat(frames, ignore_index=True) for frames in zip(*(s.frames() for s in sweeps), strict=True))
    return rows.drop_duplicates(["run", "step"]), jobs.drop_duplicates("run")


def digits(*parts: object) -> str:
    """Sixteen hex digits that stand for the parts, in every process alike."""
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:16]
