"""Every figure there is: where it appears, and that nothing in it is cut off or covered."""

import inspect

import pytest

from rrmctl.errors import UserError
from rrmctl.reports.figures import figures
from rrmctl.reports.figures.gradient_norm import gradient_norms
from rrmctl.reports.select import sections
from rrmctl.reports.statistics import Statistics
from tests.rrmctl.reports import scenes
from tests.rrmctl.reports.frames import RISING, SATURATED, Sweep
from tests.rrmctl.reports.pictures import misplaced, words

SCENES = {
    "main-results": scenes.main_results,
    "one task": lambda: Sweep().frames(),
    "one seed": lambda: Sweep(curves={method: seeds[:1] for method, seeds in RISING.items()}).frames(),
    "ablation": scenes.ablation,
    "less feedback": scenes.less_feedback,
    "two budgets": scenes.two_budgets,
    "opposite": scenes.opposite,
    "human": scenes.human,
    "fine-tuning": lambda: scenes.finetune().frames(),
}
APPEAR = {
    "main-results": {"curves", "box", "profile"},
    "one task": {"curves", "box", "profile"},
    "one seed": {"curves"},
    "ablation": {"curves", "box", "profile", "ablation"},
    "less feedback": {"curves", "less-feedback", "profile"},
    "two budgets": {"curves", "box", "profile"},
    "opposite": {"curves", "box", "profile", "diagnostics"},
    "human": {"curves", "box", "profile", "human"},
    "fine-tuning": {"curves", "box", "profile"},  # gradient-norm where runs left norms, see test_gradient_norm
}
QUICK = {"replicates": 100}


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_a_figure_appears_where_it_says_something(scene):
    """Of each experiment exactly the figures that suit it."""
    (section,) = sections(*SCENES[scene]())
    assert {name for name, entry in figures().items() if entry.load().suits(section)} == APPEAR[scene]


#: The fullest scenes of each figure.
DRAWN = [
    *((scene, name) for scene in ("main-results", "ablation") for name in ("curves", "box", "profile")),
    *(("ablation", "ablation"), ("less feedback", "less-feedback")),
    *(("opposite", "diagnostics"), ("human", "human")),
]


@pytest.mark.parametrize("width", ["column", "page"])
@pytest.mark.parametrize(("scene", "name"), DRAWN)
def test_nothing_is_cut_off_or_covered(scene, name, width):
    """Titles, names of axes, legend and notes lie on the page and not on one another, in both widths."""
    (section,) = sections(*SCENES[scene]())
    assert misplaced(figures()[name].load().draw(section, Statistics(width=width, **QUICK))) == []


@pytest.mark.parametrize("width", ["column", "page"])
def test_gradients_are_not_cut_off(width):
    """The same for the figure that reads a file beside the curves."""
    rows, jobs = scenes.finetune().frames()
    assert misplaced(gradient_norms(rows, scenes.gradients(jobs), jobs, width=width)) == []


@pytest.mark.parametrize(("scene", "name"), DRAWN[3:])
def test_every_figure_tells_what_is_missing(scene, name):
    """A failed run is counted and named below each figure."""
    rows, jobs = SCENES[scene]()
    lost = jobs.index[jobs["method"] == jobs["method"].iloc[-1]][-1]
    jobs.loc[lost, "state"] = "failed"
    rows.loc[rows["run"] == jobs.loc[lost, "run"], "state"] = "failed"
    (section,) = sections(rows, jobs)
    told = words(figures()[name].load().draw(section, Statistics(**QUICK)))
    assert f"{section.experiment} · profile laptop" in told
    assert f"{len(jobs) - 1} of {len(jobs)} planned runs. Not contained, failed:" in told


@pytest.mark.parametrize("name", sorted(set(figures()) - {"gradient-norm"}))
def test_a_figure_without_runs_is_refused(name):
    """There is nothing to draw before the first evaluation."""
    keys = [("button-press", method, seed) for method in RISING for seed in range(5)]
    (section,) = sections(*Sweep(states=dict.fromkeys(keys, "queued"), lengths=dict.fromkeys(keys, 0)).frames())
    module = figures()[name].load()
    assert not module.suits(section)
    with pytest.raises(UserError, match=r"main-results, profile laptop: no .* to draw"):
        module.draw(section)


@pytest.mark.parametrize("name", ["curves", "box", "profile"])
def test_saturated_scores_can_be_drawn(name):
    """All seeds at 100 % throughout: no spread, no warning."""
    (section,) = sections(*Sweep(curves=SATURATED).frames())
    assert misplaced(figures()[name].load().draw(section, Statistics(**QUICK))) == []


def test_every_figure_has_a_help_and_a_function_for_notebooks():
    """The command line shows the first line of each; each module has a function of DataFrames beside `draw`."""
    for name, entry in figures().items():
        assert len(entry.help.splitlines()[0]) > 20, name
        module = entry.load()
        functions = [each for each in vars(module).values() if inspect.isfunction(each)]
        assert any("DataFrame" in each.__annotations__.get("rows", "") for each in functions), name
