"""What the residual does with a prior that praises the wrong thing: rewards, and how well the model orders pairs.

For the residual model on the opposite prior: means of prior, residual, their sum and the true reward over steps, and
the agreement with the labels it was trained on and with the true reward on fresh pairs.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rrmctl.labels import ORACLE
from rrmctl.reports.captions import title
from rrmctl.reports.figure_layout import Slot, cells_sheet
from rrmctl.reports.notebook import FromFrames, nothing
from rrmctl.reports.plot_elements import band, contents, iqm_notes, line, panel_name, score_axis, step_axis
from rrmctl.reports.series import Panel, Section, Series, finite
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.styles import ALONE, Style, parts, style
from rrmctl.stats import iqm

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rrmctl.stats import IqmKind

_OPPOSITE = "opposite"
#: Of the legend where panels are of several methods, each in its colour.
_ANY = "#777777"
_NAMES = {
    "prior_mean": "prior",
    "residual_mean": "residual",
    "reward_mean": "prior + residual",
    "true_reward_mean": "true reward",
    "label_accuracy": "agreement with labels",
    "true_accuracy": "agreement with true reward",
}


def suits(section: Section) -> bool:
    """The residual model on the opposite prior has runs."""
    return any(parts(each.label.method)[1] == _OPPOSITE for each in _residual(section))


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """Three panels for each task: rewards, true reward, agreement. Without an opposite prior: of every residual model.

    Raises:
        UserError: there is no residual model.
    """
    shown = _residual(section)
    if not shown:
        raise nothing(section, "no residual model")
    shown = [each for each in shown if parts(each.label.method)[1] == _OPPOSITE] or shown
    methods = list(dict.fromkeys(each.label.method for each in shown))
    own, panels = section.looks(), section.panels()
    looks = _looks(own[methods[0]].color if len(methods) == 1 else _ANY)
    return cells_sheet(
        title(section),
        [
            cell
            for panel in panels
            for each in panel.present()
            if each in shown
            for cell in _cells(each, panel, panels, own[each.label.method].color, settings.kind)
        ],
        size=settings.width,
        handles={_NAMES[column]: look for column, look in looks.items()},
        notes=[
            "Rewards: means over the transitions since the evaluation before.",
            f"Seeds: {'; '.join(f'{each.label}: {each.n}' for each in shown)}.",
            *iqm_notes(section, settings.kind),
            *contents(section),
        ],
    )


def _residual(section: Section) -> list[Series]:
    """Series with a prior and something learned on it."""
    return [each for each in section.series if each.n and parts(each.label.method)[0] not in ("", ALONE)]


def _looks(colour: str) -> dict[str, Style]:
    """Of each quantity: the prior alone, the whole reward and the true one as where methods are drawn."""
    truth = style(ORACLE)
    return {
        "prior_mean": Style(colour, "o", style(f"{ALONE}-{_OPPOSITE}").linestyle, "white"),
        "residual_mean": Style(colour, "D", (0, (5, 1, 1, 1)), colour),
        "reward_mean": Style(colour, style(f"rrm-{_OPPOSITE}").marker, "-", colour),
        "true_reward_mean": truth,
        "label_accuracy": Style(colour, "s", "-", colour),
        "true_accuracy": truth._replace(marker="v", markerfacecolor="white"),
    }


def _cells(series: Series, panel: Panel, panels: Sequence[Panel], colour: str, kind: IqmKind) -> list[Slot]:
    looks, name = _looks(colour), f"{panel_name(panel, panels)}\n{series.label.method}"

    def cell(unit: str, columns: Sequence[str], scale: float = 1) -> Slot:
        def fill(axes: Axes) -> None:
            for place, column in enumerate(columns):
                steps, values = finite(*series.measure(column))
                if steps.size:
                    line(axes, steps, scale * iqm(values, kind, axis=0), looks[column], place)
                    band(axes, steps, scale * values, looks[column])
            if scale != 1:
                score_axis(axes, "success")
            step_axis(axes, int(series.steps[-1]))

        return Slot(name, unit, fill)

    return [
        cell("Reward a step", ("prior_mean", "residual_mean", "reward_mean")),
        cell("True reward a step", ("true_reward_mean",)),
        cell("Agreement (%)", ("label_accuracy", "true_accuracy"), 100),
    ]


diagnostics = FromFrames(draw)
