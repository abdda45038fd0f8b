"""Sections with known curves under any teacher and schedule, for tables that compare those."""

import json

import numpy as np
import pandas as pd

from rrmctl.reports import published
from rrmctl.reports.select import sections
from rrmctl.store.schema import MEASURED
from rrmctl.store.snapshot import PLANNED
from tests.rrmctl.reports.frames import FIGURES, digits

NAMES = list(PLANNED)
FULL = "50@5000/5000"


def curve(*levels, seeds=5, spread=0.0):
    """Curves [S, T] around these levels, the seeds evenly spread about them and kept between 0 and 1."""
    offsets = np.linspace(-spread, spread, seeds)
    return np.clip(np.array(levels)[None, :] + offsets[:, None], 0.0, 1.0)


def frames(experiment, series, *, steps, profile="paper", variant=None, overrides=None, states=None):
    """Rows and jobs as the store gives them.

    Args:
        series: (task, method, teacher, feedback) -> success [S, T], or a dict of measured columns, each [S, T]. The
            true return is a tenth of the success less ten, where it is not given.
        steps: the evaluation steps, [T], or those of each series; a series may be shorter.
        states: (method, seed) -> state; done otherwise.
    """
    rows, jobs = [], []
    for label, told in series.items():
        columns = told if isinstance(told, dict) else {"success": told}
        columns = {"true_return": np.asarray(columns["success"]) / 10 - 10} | columns
        own = steps[label] if isinstance(steps, dict) else steps
        for seed in range(len(columns["success"])):
            run, cell = digits(experiment, profile, overrides, *label, seed), digits(experiment, profile, *label)
            state = (states or {}).get((label[1], seed), "done")
            who = (experiment, variant or profile, profile, json.dumps(overrides or {}))
            jobs.append((*who, *label, seed, run, cell, state, 1, 0, own[-1], ""))
            for at, step in enumerate(own[: len(columns["success"][seed])]):
                measured = dict.fromkeys((*MEASURED, *FIGURES), 0.0) | {"step": step, "episodes": 10}
                measured |= {name: values[seed][at] for name, values in columns.items()}
                labels = dict(zip(NAMES[4:12], (*label, seed, run, cell, state), strict=True))
                rows.append(dict(zip(NAMES[:3], who[:3], strict=True)) | labels | measured)
    return pd.DataFrame(rows), pd.DataFrame(jobs, columns=NAMES)


def section(experiment, series, deployments=None, **settings):
    """Args: deployments: rows and jobs, as `frames` makes them."""
    (found,) = sections(*frames(experiment, series, **settings), deployments=deployments)
    return found


def at_the_rig(success, lost=0):
    return {"success": success, "deployed_lost": np.full(success.shape, lost), "deployed_breakdowns": 0 * success}


def deployed(profile="paper", length=10, played=(1, 2, 3), lost=0):
    """Evaluations in training, each tenth of it, and deployments of three checkpoints that are a tenth worse."""
    series, steps, after, checkpoints = {}, {}, {}, {}
    for task, method in (("panda-reach", "rrm-1d"), ("panda-push", "rrm-h2o"), ("panda-pick-and-reach", "rrm-h2o")):
        for rank, name in enumerate(("pebble", method)):
            label, rig = ((task, called, "oracle", FULL) for called in (name, f"{name} deployed"))
            series[label] = curve(*np.linspace(0.1, 0.6 + 0.4 * rank, length), spread=0.05)
            share = 1 if profile == "paper" else 5
            whole = (150_000 if task == "panda-reach" else 1_000_000) // share
            steps[label] = [whole * (at + 1) // 10 for at in range(10)]
            checkpoints[rig] = [at.step // share for at in published.checkpoints(task, name)[: len(played)]]
            success = np.clip(series[label][:, : len(played)] - 0.1, 0, 1)
            after[rig] = {
                "success": success,
                "deployed_lost": np.full(success.shape, lost),
                "deployed_breakdowns": 0 * success,
            }
    rows, jobs = frames("sim-to-real", after, steps=checkpoints, profile=profile)
    return section("sim-to-real", series, steps=steps, profile=profile, deployments=(rows.assign(episodes=20), jobs))
