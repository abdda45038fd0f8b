"""People along a sitting: how long an answer takes, and how often it agrees with the true return, person by person.

Who gets tired answers more slowly or more quickly, and errs more.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from rrmctl.reports.answers import EVERYBODY, Answers, answers, everybody
from rrmctl.reports.figure_layout import Axes, Figure, Slot, one_section, sheet
from rrmctl.reports.plot_elements import line, preference_axis
from rrmctl.reports.series import Section
from rrmctl.reports.statistics import DEFAULTS, Statistics, Width
from rrmctl.reports.styles import Style, styles
from rrmctl.stats import Floats

if TYPE_CHECKING:
    import pandas as pd

    from rrm.teachers.labels import Label

#: Answers of a sitting that are of one point, and of all sittings at least.
_STRETCH, _FEWEST = 20, 10
_EVERYBODY = Style("#000000", "", "-", "#000000")


def suits(section: Section) -> bool:
    """People answered queries of its runs."""
    return bool(section.answered)


def draw(section: Section, settings: Statistics = DEFAULTS, labels: Mapping[str, list[Label]] | None = None) -> Figure:
    """Latency, and agreement with the true return, over the place in a sitting; a line for each person."""
    given = everybody(answers(section, labels))
    people = given.people
    own = {EVERYBODY: given} if len(people) > 1 else {}
    own |= {person: given.by(person) for person in people}
    looks = {name: styles(people).get(name, _EVERYBODY) for name in own}
    notes = [
        f"Points: {_STRETCH} answers of every sitting, with {_FEWEST} in all at least; of the latency the median. "
        "Ties and skips take time, and agree with no return. Dotted: chance.",
    ]
    panels: dict[tuple[str, str], Callable[[Answers], Floats]] = {
        ("Latency", "Median latency (s)"): Answers.seconds,
        ("Agreement", "Prefers higher return (%)"): Answers.right,
    }
    slots = [
        Slot(*names, partial(_fill, values=values, own=own, looks=looks), "Answers into the sitting")
        for names, values in panels.items()
        if own
    ]
    legend = {_plain(name): look for name, look in looks.items()}
    return sheet(section, settings, slots, notes=notes, lacking="no answers of people", legend=legend)


def _plain(name: str) -> str:
    """A name that matplotlib takes neither for a formula nor for one to be hidden."""
    return f" {name}".replace("$", r"\$") if name.startswith("_") else name.replace("$", r"\$")


def _fill(
    axes: Axes, *, values: Callable[[Answers], Floats], own: Mapping[str, Answers], looks: Mapping[str, Style]
) -> None:
    """A line for each name, of the median latency or the share in percent, at the middle of each stretch."""
    share, lowest = values is Answers.right, 100.0
    for position, (name, given) in enumerate(own.items()):
        sittings, middles, points = given.sittings(values(given)), [], []
        for start in range(0, max(map(len, sittings)), _STRETCH):
            stretch = np.concatenate([sitting[start : start + _STRETCH] for sitting in sittings])
            stretch = stretch[~np.isnan(stretch)]
            if stretch.size >= _FEWEST:
                middles.append(start + _STRETCH / 2)
                points.append(float(100 * stretch.mean() if share else np.median(stretch)))
        heavy = {"linewidth": 2.0, "zorder": 3} if name == EVERYBODY else {"linewidth": 1.0}
        if points:
            line(axes, np.array(middles), np.array(points), looks[name], position, **heavy)
            lowest = min(lowest, *points)
    axes.set_xlim(left=0)
    if share:
        preference_axis(axes, lowest)
    else:
        axes.set_ylim(bottom=0)


def along_a_sitting(
    rows: pd.DataFrame, labels: Mapping[str, list[Label]], jobs: pd.DataFrame | None = None, *, width: Width = "page"
) -> Figure:
    """The same in a notebook; `labels` as `rrm.teachers.labels.read_labels` returns them, by task."""
    return draw(one_section(rows, jobs), Statistics(width=width), labels)
