"""How fast runs are, by what they recorded: environment steps per second, evaluation counted in where a run is done."""

from __future__ import annotations

import statistics
from collections import defaultdict
from collections.abc import Iterable, Mapping

from rrmctl.store.layout import Layout
from rrmctl.store.status import RunState, Status, statuses
from rrmctl.store.sweeps import Job, readable_sweeps


def speeds(jobs: Iterable[Job], states: Mapping[str, Status]) -> dict[tuple[str, str], float]:
    """The median speed of what has run so far, by task and method."""
    seen: defaultdict[tuple[str, str], list[float]] = defaultdict(list)
    for job in jobs:
        status = states[job.id]
        took = status.wall_s if status.state is RunState.DONE else None
        if speed := status.step / took if took else status.steps_per_s:
            seen[job.task, job.method].append(speed)
    return {key: statistics.median(values) for key, values in seen.items()}


def stored_speeds(layout: Layout, known: Mapping[str, Status] | None = None) -> dict[tuple[str, str, str], float]:
    """The median speed of the store's runs, by task, method and variant.

    Args:
        known: where some of the runs stand, by id, as read already.
    """
    states, jobs = dict(known or {}), defaultdict[str, list[Job]](list)
    for sweep in readable_sweeps(layout)[0]:
        states |= statuses(layout, (job for job in sweep.everything if job.id not in states))
        jobs[sweep.variant] += sweep.everything
    return {(*key, variant): speed for variant, own in jobs.items() for key, speed in speeds(own, states).items()}
