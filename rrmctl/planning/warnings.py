"""What a plan can do but will hardly be meant to: said beside it, never refused."""

from __future__ import annotations

from collections import defaultdict

from rrmctl.planning.plan import Plan


def notes(plan: Plan, cores: int) -> list[str]:
    """One line for each thing to know before the plan is run; mostly none.

    Args:
        cores: cores that this machine has for runs.
    """
    return [*_unasked(plan), *_threads(plan, cores)]


def _unasked(plan: Plan) -> list[str]:
    """Budgets of feedback that a run is too short to spend, those that fall short alike in one line."""
    short: dict[str, dict[str, None]] = defaultdict(dict)
    cells = {job.row: job for job in plan.jobs}  # every seed asks the same
    for job in cells.values():
        config = plan.configs[job.id]
        if config.kind != "train" or config.feedback is None:
            continue
        budget, queries = config.feedback.budget, config.queries()
        if queries < budget:
            said = f"{queries:,} of {budget:,} questions fit into {config.steps:,} steps"
            short[said][f"{job.task} {job.method}"] = None
    return [f"{said}: {', '.join(names)}" for said, names in short.items()]


def _threads(plan: Plan, cores: int) -> list[str]:
    most = max((plan.configs[job.id].threads for job in plan.jobs), default=1)
    return [f"threads: {most} for each run, on {cores} core{'s' if cores > 1 else ''}"] if most > cores else []
