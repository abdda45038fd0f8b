"""What the residual does with a prior that praises the wrong thing: rewards, and how well the model orders pairs.

For the residual model on the opposite prior: means of prior, residual, their sum and the true reward over steps, and
the agreement with the labels it was trained on and with the true reward on fresh pairs.
"""

from __future__ import annotations

from rrmctl.labels import ORACLE
from rrmctl.reports.figure_layout import Axes, Figure, Slot, from_frames, sheet
from rrmctl.reports.plot_elements import curve, iqm_notes, panel_name, score_axis, step_axis
from rrmctl.reports.series import Section, Series, finite
from rrmctl.reports.statistics import DEFAULTS, Statistics
from rrmctl.reports.styles import ALONE, Looks, Style, parts, style
from rrmctl.stats import IqmKind

_OPPOSITE = "opposite"
#: Of the legend where panels are of several methods, each in its colour.
_ANY = "#777777"
#: For each panel its unit, and columns of the curve with their names.
_PANELS = {
    "Reward a step": {"prior_mean": "prior", "residual_mean": "residual", "reward_mean": "prior + residual"},
    "True reward a step": {"true_reward_mean": "true reward"},
    "Agreement (%)": {"label_accuracy": "agreement with labels", "true_accuracy": "agreement with true reward"},
}


def suits(section: Section) -> bool:
    """The residual model on the opposite prior has runs."""
    return bool(_residual(section, _OPPOSITE))


def draw(section: Section, settings: Statistics = DEFAULTS) -> Figure:
    """Three panels a task: rewards, true reward, agreement; without an opposite prior for every residual model."""
    shown, methods, panels = _residual(section, _OPPOSITE) or _residual(section), section.looks(), section.panels()
    own = {series.label.method: _looks(methods[series.label.method].color) for series in shown}
    looks = next(iter(own.values())) if len(own) == 1 else _looks(_ANY)
    slots = [
        _slot(panel_name(panel, panels), unit, series, own[series.label.method], settings.kind)
        for panel in panels
        for series in panel.present()
        if series in shown
        for unit in _PANELS
    ]
    legend = {name: looks[column] for columns in _PANELS.values() for column, name in columns.items()}
    notes = [
        "Rewards: means over the transitions since the evaluation before.",
        f"Seeds: {'; '.join(f'{series.label}: {series.n}' for series in shown)}.",
        *iqm_notes(section, settings.kind),
    ]
    return sheet(section, settings, slots, legend=legend, notes=notes, lacking="no residual model")


def _residual(section: Section, prior: str | None = None) -> list[Series]:
    """Series with something learned on this prior, or on any."""
    named = [(series, *parts(series.label.method)) for series in section.series if series.n]
    return [series for series, family, base in named if family not in ("", *ALONE) and prior in (None, base)]


def _looks(colour: str) -> Looks:
    """Of each column: the prior alone, the whole reward and the true one as where methods are drawn."""
    truth = style(ORACLE)
    return {
        "prior_mean": Style(colour, "o", style(f"{ALONE[0]}-{_OPPOSITE}").linestyle, "white"),
        "residual_mean": Style(colour, "D", (0, (5, 1, 1, 1)), colour),
        "reward_mean": Style(colour, style(f"rrm-{_OPPOSITE}").marker, "-", colour),
        "true_reward_mean": truth,
        "label_accuracy": Style(colour, "s", "-", colour),
        "true_accuracy": truth._replace(marker="v", markerfacecolor="white"),
    }


def _slot(name: str, unit: str, series: Series, looks: Looks, kind: IqmKind) -> Slot:
    def fill(axes: Axes) -> None:
        for position, column in enumerate(_PANELS[unit]):
            steps, values = finite(*series.measure(column))
            if steps.size:
                curve(axes, steps, 100 * values if "%" in unit else values, looks[column], kind, position=position)
        if "%" in unit:
            score_axis(axes, "success")
        step_axis(axes, int(series.steps[-1]))

    return Slot(f"{name}\n{series.label.method}", unit, fill)


diagnostics = from_frames(draw)
