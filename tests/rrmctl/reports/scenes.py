"""A small sweep for each figure that not every experiment has."""

import pandas as pd

from rrmctl.store.frame import typed
from tests.rrmctl.reports.frames import RISING, Sweep, together

LOW = [[0, 0.1, 0.2, 0.2]] * 5
NOTHING_YET = float("nan")
OPPOSITE = {
    "prior_mean": [0.6, 0.5, 0.4, 0.3],
    "residual_mean": [-0.1, -0.6, -0.8, -0.9],
    "reward_mean": [0.5, -0.1, -0.4, -0.6],
    "true_reward_mean": [1.0, 2.0, 4.0, 8.0],
    "label_accuracy": [NOTHING_YET, 0.8, 0.95, 0.98],
    "true_accuracy": [NOTHING_YET, 0.7, 0.9, 0.95],
}


def main_results():
    """Three success tasks and a return task, all methods at every task."""
    return together(Sweep(tasks=("button-press", "door-open", "door-unlock", "walker-walk")))


def ablation():
    """Two priors with and without the residual, one with it alone, and two methods without any."""
    curves = RISING | {"rrm-sparse": RISING["pebble"], "sac-proxy": LOW, "sac-sparse": LOW, "rrm-language": LOW}
    return together(Sweep(curves=curves, experiment="ablation-residual"))


def less_feedback(tasks=("button-press",)):
    """Batches of 50, 25 and 5 every 5,000 steps, and 50 every 20,000."""
    labels = ("50@5000/5000", "25@5000/2500", "5@5000/500", "50@20000/1250")
    learners = {name: RISING[name] for name in ("pebble", "rrm-proxy")}
    sweeps = [
        Sweep(curves=learners if label != "5@5000/500" else {"pebble": LOW, "rrm-proxy": RISING["pebble"]}, tasks=tasks,
              experiment="less-feedback", feedback=label)
        for label in labels
    ]  # fmt: skip
    return together(*sweeps)


def two_budgets():
    """The same methods with the usual budget, and with a fifth of it."""
    curves = {name: RISING[name] for name in ("pebble", "rrm-proxy")}
    schedules = ("50@5000/5000", "50@5000/1000")
    return together(*(Sweep(curves=curves, experiment="finetune", feedback=label) for label in schedules))


def opposite():
    """The residual model on the opposite prior, with what it measured."""
    curves = {"pebble": RISING["pebble"], "rrm-opposite": RISING["rrm-proxy"]}
    return together(Sweep(curves=curves, experiment="opposite-prior", measured={"rrm-opposite": OPPOSITE}))


def human():
    """Two methods taught by people."""
    curves = {"pebble": RISING["pebble"], "rrm-h2o": RISING["rrm-proxy"]}
    return together(Sweep(curves=curves, tasks=("window-open",), experiment="human-study", teacher="human"))


def finetune():
    """Fine-tuning beside the residual model."""
    curves = {"rrm-imitation": RISING["rrm-proxy"], "finetune": LOW, "finetune-tanh": LOW}
    return Sweep(curves=curves, experiment="finetune")


def gradients(jobs):
    """Norms of the runs that fine-tune: 1, 2, ... by seed before step 200, then a hundredth of that."""
    frames = []
    for job in jobs[jobs["method"].str.startswith("finetune")].to_dict("records"):
        norm = float(job["seed"] + 1)
        before = pd.DataFrame({"step": range(10, 201, 10), "loss": "airl", "gradient_norm": norm})
        after = pd.DataFrame({"step": range(210, 401, 10), "loss": "preferences", "gradient_norm": norm / 100})
        frames.append(pd.concat([before, after]).assign(run=job["run"]))
    return typed(pd.concat(frames, ignore_index=True))
