"""The tables of docs/laptop.md, as markdown: `python experiments/laptop/tables.py results/reference`.

AUC is the mean success over all evaluations of a run. Changes are differences at the same seed and task, averaged over
tasks, with Student's 95 % intervals of seeds within tasks, where each task has two or more.
"""

# ruff: noqa: T201

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats

from rrmctl.store import load

TASKS = ("button-press", "door-unlock", "window-open")
TRIALS = ("laptop-one-by-one", "laptop-further", "laptop-readings")


def summaries(results: str, experiment: str) -> pd.DataFrame:
    """Of each complete run: AUC and mean of the last five in %, swing over the last ten, return of the last five."""
    frame = load(results, experiment)
    frame = frame[(frame["state"] == "done") & (frame["step"] > 0)].sort_values("step")
    runs = frame.groupby(["task", "method", "seed"])
    return pd.DataFrame({
        "auc": 100 * runs["success"].mean(),
        "last": 100 * runs["success"].apply(lambda values: values.tail(5).mean()),
        "swing": runs["success"].apply(lambda values: values.tail(10).std()),
        "return": runs["true_return"].apply(lambda values: values.tail(5).mean()),
    })  # fmt: skip


def change(new: pd.Series, old: pd.Series) -> str:
    """Mean over tasks of the differences by seed, with its interval; of what both have."""
    tasks = (new - old).dropna().groupby("task")
    mean, freedom = tasks.mean().mean(), (tasks.size() - 1).sum()
    if tasks.size().min() < 2:
        return f"{mean:+.0f}"
    error = np.sqrt((tasks.var() / tasks.size()).sum()) / len(tasks)
    low, high = stats.t.interval(0.95, freedom, mean, error)
    return f"{mean:+.0f} [{low:+.0f}, {high:+.0f}]"


def of_method(runs: pd.DataFrame, method: str, column: str = "auc") -> pd.Series:
    """One column of a method's runs, by task and seed."""
    return runs[column].xs(method, level="method")


def seeds(values: pd.Series, task: str) -> str:
    """The values of a task's seeds. Halves are frequent, and go up on every processor."""
    return ", ".join(f"{value + 1e-6:.0f}" for value in values.get(task, pd.Series(dtype=float)))


def comparison(results: str) -> None:
    """The profile as it is beside what it was."""
    now, before = (summaries(results, name) for name in ("laptop", "laptop-before"))
    print("| task | method | AUC now | before | last five now | before | swing now | before | return now | before |")
    print("|" + "---|" * 10)
    for task in (*TASKS, "mean"):
        for method in ("oracle", "pebble", "rrm-proxy"):
            cells = [task if method == "oracle" else "", method]
            for column, places in (("auc", 1), ("last", 0), ("swing", 2), ("return", 0)):
                for runs, name in ((now, method), (before, f"{method} before")):
                    by_task = of_method(runs, name, column).groupby("task").mean()
                    mean = by_task.mean() if task == "mean" else by_task[task]
                    each = f" ({seeds(of_method(runs, name), task)})" if column == "auc" and task != "mean" else ""
                    cells.append(f"{mean:.{places}f}{each}")
            print(f"| {' | '.join(cells)} |".replace("|  |", "| |"))
    for method in ("oracle", "pebble", "rrm-proxy"):
        print(f"{method}: {change(of_method(now, method), of_method(before, f'{method} before'))}")


def trials(results: str) -> None:
    """What else was tried, beside the profile."""
    profile = summaries(results, "laptop")
    for experiment in (name for name in TRIALS if (Path(results) / "sweeps" / name).exists()):
        runs = summaries(results, experiment)
        print(f"\n| `{experiment}` | AUC, button-press | door-unlock | last five | change of AUC |\n|" + "---|" * 5)
        for method in runs.index.unique("method"):
            base, auc = method.split()[0], of_method(runs, method)
            known = base in profile.index.unique("method")
            last = " / ".join(f"{value:.0f}" for value in of_method(runs, method, "last").groupby("task").mean())
            against = change(auc, of_method(profile, base)) if known else "–"
            print(f"| {method} | {seeds(auc, TASKS[0])} | {seeds(auc, TASKS[1])} | {last} | {against} |")


if __name__ == "__main__":
    comparison(sys.argv[1])
    trials(sys.argv[1])
