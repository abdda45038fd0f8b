import matplotlib as mpl
import numpy as np
import pytest
from scipy.stats import trim_mean

from rrmctl.reports.figures import box
from rrmctl.reports.figures.box import box_plot
from rrmctl.reports.select import sections
from rrmctl.reports.styles import style
from tests.rrmctl.reports import scenes
from tests.rrmctl.reports.frames import RISING, Sweep
from tests.rrmctl.reports.pictures import panels, words

AT_300 = 100 * np.array([seed[2] for seed in RISING["pebble"]])


def parts(figure):
    """The panels with boxes, by their horizontal axis, and those that show the rule."""
    boxes = [axes for axes in panels(figure) if axes.patches]
    return boxes, [axes for axes in panels(figure) if not axes.patches]


def test_a_box_holds_the_quartiles_and_every_seed():
    """At the common step: edges at the quartiles, a line at the mean, which is told, the IQM, and a point a seed."""
    (axes,), _ = parts(box_plot(*Sweep().frames()))
    (drawn,) = (
        patch for patch in axes.patches if mpl.colors.to_hex(patch.get_edgecolor()).upper() == style("pebble").color
    )
    np.testing.assert_allclose([drawn.get_x(), drawn.get_x() + drawn.get_width()], np.quantile(AT_300, [0.25, 0.75]))
    own = [line for line in axes.get_lines() if line.get_color() == style("pebble").color]
    center, seeds = own
    assert set(center.get_xdata()) == {AT_300.mean()}
    assert sorted(seeds.get_xdata()) == sorted(AT_300)
    assert seeds.get_marker() == style("pebble").marker
    iqms = [line.get_xdata()[0] for line in axes.get_lines() if line.get_marker() == "D"]
    assert iqms[0] == pytest.approx(trim_mean(AT_300, 0.25))
    assert [text.get_text() for text in axes.texts] == ["34.0", "98.0"]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["rrm-proxy", "pebble"]


def test_a_seed_can_be_the_mean_of_its_last_evaluations():
    """Up to the step that single evaluations choose, which the rule above shows as ever; and the note says so."""
    figure = box_plot(*Sweep().frames(), last=2)
    (axes,), (rule,) = parts(figure)
    _, seeds = (line for line in axes.get_lines() if line.get_color() == style("pebble").color)
    np.testing.assert_allclose(
        sorted(seeds.get_xdata()), sorted(50 * np.array([a + b for _, a, b, _ in RISING["pebble"]]))
    )
    shares = {line.get_color(): list(line.get_ydata()) for line in rule.get_lines() if len(line.get_xdata()) == 4}
    assert shares[style("rrm-proxy").color] == [0, 0, 80, 80]
    assert "Score at a step: mean of the last 2 evaluations up to it" in words(figure)
    assert "There are fewer: button-press, 3 at step 300." in words(box_plot(*Sweep().frames(), last=4))


def test_equal_seeds_lie_beside_one_another():
    """Four of five seeds at 100 % are four points that can be counted."""
    (axes,), _ = parts(box_plot(*Sweep().frames()))
    seeds = next(line for line in axes.get_lines() if line.get_marker() == style("rrm-proxy").marker)
    assert len({(x, y) for x, y in zip(seeds.get_xdata(), seeds.get_ydata(), strict=True)}) == 5


def test_the_oracle_is_a_dotted_line():
    """The oracle has no box; its mean is dotted across all of them."""
    (axes,), _ = parts(box_plot(*Sweep().frames()))
    (dots,) = (line for line in axes.get_lines() if line.get_linestyle() == ":")
    assert set(dots.get_xdata()) == {100.0}
    assert len(axes.patches) == 2


def test_a_variant_of_the_oracle_is_no_learner():
    """It has a dotted line of its own and no box, does not count in the rule, and alone it is nothing to compare."""
    variant = {"oracle-bfloat16": RISING["oracle"]}
    (axes,), (rule,) = parts(box_plot(*Sweep(curves=RISING | variant).frames()))
    dotted = {line.get_color() for line in axes.get_lines() if line.get_linestyle() == ":"}
    assert dotted == {style("oracle").color, style("oracle-bfloat16").color}
    assert [label.get_text() for label in axes.get_yticklabels()] == ["rrm-proxy", "pebble"]
    assert style("oracle-bfloat16").color not in {line.get_color() for line in rule.get_lines()}
    knowing = dict.fromkeys(("oracle", *variant), RISING["oracle"])
    assert [box.suits(each) for each in sections(*Sweep(curves=knowing).frames())] == [False]


def test_the_rule_is_drawn_and_the_step_named():
    """Above the boxes: shares of seeds at 100 %, the 80 % asked for, and the step; the note says who got there."""
    figure = box_plot(*Sweep().frames())
    _, (rule,) = parts(figure)
    shares = {line.get_color(): list(line.get_ydata()) for line in rule.get_lines() if len(line.get_xdata()) == 4}
    assert shares == {style("pebble").color: [0, 0, 0, 20], style("rrm-proxy").color: [0, 0, 80, 80]}
    straight = [
        (set(line.get_xdata()), set(line.get_ydata())) for line in rule.get_lines() if len(line.get_xdata()) == 2
    ]
    assert straight == [({0, 1}, {80}), ({300}, {0, 1})]
    assert rule.get_title() == "button-press\nat step 300"
    assert "button-press: reached by rrm-proxy." in words(figure)


def test_a_step_that_nobody_chose_is_said_to_be_the_last():
    """Where no method has 80 % of its seeds at 100 %, the last step is named as such."""
    figure = box_plot(*Sweep(curves={name: RISING[name] for name in ("oracle", "pebble")}).frames())
    _, (rule,) = parts(figure)
    assert rule.get_title() == "button-press\nat step 400 (last)"
    assert "button-press: reached by none." in words(figure)


def test_tasks_are_pooled_and_returns_stand_apart():
    """A panel a task; returns at the last step, without a rule; the success tasks together in a panel of their own."""
    boxes, rules = parts(box_plot(*scenes.main_results()))
    assert [axes.get_title() for axes in rules] == [
        f"{t}\nat step 300" for t in ("button-press", "door-open", "door-unlock")
    ]
    assert [axes.get_title() for axes in boxes[3:]] == [
        "walker-walk\nat step 400 (last)",
        "success tasks\neach at its step",
    ]
    assert boxes[3].get_xlabel() == "Return (true reward)"
    pooled = next(line for line in boxes[4].get_lines() if line.get_marker() == style("pebble").marker)
    assert sorted(pooled.get_xdata()) == sorted([*AT_300] * 3)
