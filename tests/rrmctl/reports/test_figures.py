import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest
from scipy.stats import trim_mean

from rrmctl.errors import UserError
from rrmctl.reports.figure_layout import encode
from rrmctl.reports.figures.curves import learning_curves
from rrmctl.reports.styles import style
from tests.rrmctl.reports.frames import RISING, Sweep
from tests.rrmctl.reports.pictures import legend, panels, words


def test_a_line_is_the_iqm_and_a_band_the_quartiles():
    """Each method's line is the IQM in percent; the band spans the 25th to the 75th percentile."""
    (axes,) = panels(learning_curves(*Sweep().frames()))
    lines = {line.get_color(): line for line in axes.get_lines()}
    pebble = np.array(RISING["pebble"])
    np.testing.assert_allclose(lines[style("pebble").color].get_ydata(), 100 * trim_mean(pebble, 0.25, axis=0))
    band = axes.collections[1].get_paths()[0].vertices
    low, high = np.quantile(100 * pebble[:, 2], [0.25, 0.75])
    np.testing.assert_allclose(sorted({y for x, y in band if x == 300}), [low, high])


def test_a_curve_can_be_of_the_last_evaluations():
    """At each step what would be read there: of every run the mean of its last ones, first of those there are."""
    figure = learning_curves(*Sweep().frames(), last=3)
    drawn = {line.get_color(): line.get_ydata() for line in panels(figure)[0].get_lines()}
    pebble = np.array(RISING["pebble"])
    ends = np.stack([pebble[:, max(0, at - 2) : at + 1].mean(axis=1) for at in range(4)], axis=1)
    np.testing.assert_allclose(drawn[style("pebble").color], 100 * trim_mean(ends, 0.25, axis=0))
    assert "mean of the last 3 evaluations" in words(figure)
    assert "Score at a step" not in words(learning_curves(*Sweep().frames()))


def test_one_panel_a_task_with_units():
    """Every task has a panel; axes name their unit; the title names experiment and profile; the legend has n."""
    figure = learning_curves(*Sweep(tasks=("button-press", "door-open", "walker-walk")).frames())
    assert [axes.get_title() for axes in panels(figure)] == ["button-press", "door-open", "walker-walk"]
    assert {axes.get_ylabel() for axes in panels(figure)} == {"Success rate (%)", "", "Return (true reward)"}
    assert panels(figure)[0].get_xlabel() == "Environment steps"
    assert "main-results · profile laptop" in words(figure)
    assert legend(figure) == ["oracle (n = 5)", "pebble (n = 5)", "rrm-proxy (n = 5)"]


def test_the_oracle_is_dotted():
    """The oracle is the only dotted line."""
    (axes,) = panels(learning_curves(*Sweep().frames()))
    assert [line.get_linestyle() for line in axes.get_lines()] == [":", "-", "-"]


def test_a_single_seed_has_no_band():
    """One seed has no spread to show, and the note does not speak of a band."""
    figure = learning_curves(*Sweep(curves={m: c[:1] for m, c in RISING.items()}).frames())
    assert not panels(figure)[0].collections
    assert "Band" not in words(figure)


def test_missing_runs_stand_below_the_figure():
    """What was planned and is not drawn is named, and n follows it."""
    figure = learning_curves(*Sweep(states={("button-press", "pebble", 1): "failed"}).frames())
    assert "pebble (n = 4)" in legend(figure)
    assert "14 of 15 planned runs. Not contained, failed: button-press, pebble: seed 1." in words(figure)


@pytest.mark.parametrize("count", [2, 3, 4, 5, 7, 10])
@pytest.mark.parametrize("tasks", [("button-press",), ("button-press", "door-open")])
@pytest.mark.parametrize("width", ["column", "page"])
def test_the_legend_stays_within_the_figure(width, tasks, count):
    """However many methods there are, no entry is cut off at the figure's edge."""
    names = ["oracle", "pebble", *(f"{f}-{p}" for f in ("rrm", "sac") for p in ("sparse", "proxy", "language", "o2g"))]
    names = names[:count]
    figure = learning_curves(*Sweep(curves=dict.fromkeys(names, ((0.1, 0.2),)), tasks=tasks).frames(), width=width)
    encode(figure, "png")
    (found,) = figure.findobj(mpl.legend.Legend)
    box, page = found.get_window_extent(), figure.bbox
    assert page.x0 <= box.x0 < box.x1 <= page.x1
    assert page.y0 <= box.y0 < box.y1 <= page.y1
    assert all(box.y1 <= axes.get_window_extent().y0 for axes in panels(figure))


def test_a_figure_of_two_variants_is_refused():
    """Profiles and overrides never share a figure."""
    both = (pd.concat(pair) for pair in zip(Sweep().frames(), Sweep(variant="b").frames(), strict=True))
    with pytest.raises(UserError, match="main-results/laptop, main-results/b"):
        learning_curves(*both)


def test_a_figure_without_runs_is_refused():
    """There is nothing to draw before the first evaluation."""
    keys = [("button-press", method, seed) for method in RISING for seed in range(5)]
    sweep = Sweep(states=dict.fromkeys(keys, "queued"), lengths=dict.fromkeys(keys, 0))
    with pytest.raises(UserError, match="no run to draw"):
        learning_curves(*sweep.frames())


def test_one_evaluation_is_visible():
    """A single point of the oracle gets a marker, since there is no line to dot."""
    figure = learning_curves(*Sweep(curves={m: [[0.5]] for m in RISING}).frames())
    assert all(line.get_marker() not in ("", "None") for line in panels(figure)[0].get_lines())
    assert encode(figure, "png").startswith(b"\x89PNG")


def test_many_missing_runs_take_few_words():
    """Methods of a task that lack the same seeds are named together, and seeds in a row by their ends."""
    keys = [("door-open", method, seed) for method in ("pebble", "rrm-proxy") for seed in range(5)]
    states = dict.fromkeys(keys, "queued") | {("button-press", "pebble", seed): "queued" for seed in (0, 2)}
    sweep = Sweep(tasks=("button-press", "door-open"), states=states, lengths=dict.fromkeys(states, 0))
    told = words(learning_curves(*sweep.frames()))
    which = "Not contained, queued: button-press, pebble: seeds 0, 2; door-open, pebble, rrm-proxy: seeds 0-4."
    assert f"18 of 30 planned runs. {which}" in told
