"""What a command that runs says before it begins."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from rrmctl.cli.progress import runs
from rrmctl.cli.request import in_words, smaller

if TYPE_CHECKING:
    from rich.console import Console

    from rrmctl.cli.request import Forecast, Request

#: Work above which a person at a terminal is asked first, core-hours.
LARGE_H = 1.0


def from_nothing(expected: Forecast) -> Forecast:
    """The forecast of a plan of which nothing has been run."""
    from rrmctl.store.status import Status

    return replace(expected, states=dict.fromkeys(expected.states, Status()))


def introduce(console: Console, request: Request, expected: Forecast, slots: int) -> None:
    """Say what a command is about to run, what it costs, and what would cost less."""
    from rrmctl.hardware import usable_cores
    from rrmctl.planning.warnings import notes

    plan = expected.plan
    done, failed = expected.count("done"), expected.count("failed")
    there = f", {done} done already" if done else ""
    there += f", {failed} failed" if failed else ""
    more = f" and {len(plan.needed)} that they need" if plan.needed else ""
    told = f"{plan.experiment} ({plan.variant}): {runs(len(plan.jobs))}{more}{there}."
    console.print(told, style="bold", soft_wrap=True)
    console.print(in_words(expected, slots), soft_wrap=True)
    for line in notes(plan, usable_cores()):
        console.print(f"  note: {line}", soft_wrap=True)
    if expected.hours_left > LARGE_H:
        for line in smaller(request, plan):
            console.print(f"  smaller: {line}", soft_wrap=True)
