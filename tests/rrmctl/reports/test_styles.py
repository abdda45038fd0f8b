import itertools
from pathlib import Path

import pytest
from matplotlib.colors import to_rgb

from rrmctl.planning.manifest import load
from rrmctl.reports.styles import parts, style
from tests.rrmctl.reports.vision import SIGHTS, distance, lightness

EXPERIMENTS = sorted((Path(__file__).parents[3] / "experiments").glob("*.toml"))
#: CIE76 between two lines' colours, and L* between two greys, from which on they count as different.
COLOUR, GREY = 12, 8


def rgb(method):
    return to_rgb(style(method).color)


def channels(one, two):
    """In what two methods differ: their colour for every sight, their grey, marker, filling, line."""
    apart = min(distance(rgb(one), rgb(two), sight) for sight in SIGHTS if sight != "tritanopia") >= COLOUR
    grey = abs(lightness(rgb(one)) - lightness(rgb(two))) >= GREY
    a, b = style(one), style(two)
    hollow = (a.markerfacecolor == "white") != (b.markerfacecolor == "white")
    return {
        name
        for name, differs in {
            "colour": apart,
            "grey": grey,
            "marker": a.marker != b.marker,
            "filling": hollow,
            "line": a.linestyle != b.linestyle,
        }.items()
        if differs
    }


@pytest.mark.parametrize("path", EXPERIMENTS, ids=lambda path: path.stem)
def test_methods_that_meet_differ_twice(path):
    """Any two methods of an experiment differ in two ways for every reader: colour-blind, or of a greyscale print."""
    for grid in load(path).grids:
        for one, two in itertools.combinations(dict.fromkeys(grid.methods), 2):
            found = channels(one, two)
            assert len(found - {"grey"}) >= 2, (one, two, found)  # on a screen, whatever the sight
            assert len(found - {"colour"}) >= (2 if parts(one)[1] == parts(two)[1] else 1), (one, two, found)  # printed


def test_the_main_figure_is_apart_in_grey_and_colour():
    """The five methods of the main figure differ by colour for every sight, and all but neighbours by grey."""
    methods = ("oracle", "rrm-language", "pebble", "rrm-proxy", "rrm-imitation")
    for one, two in itertools.combinations(methods, 2):
        assert {"colour", "grey"} <= channels(one, two), (one, two)


def test_a_method_looks_the_same_everywhere():
    """The look depends on the name alone; methods of the experiments differ in colour, marker or line."""
    priors = ("proxy", "language", "imitation", "o2g", "h2o", "sparse", "zero", "opposite", "random")
    families = ("rrm", "sac", "rrm-surf", "rrm-mrn")
    names = ["oracle", "pebble", "surf", "mrn", "finetune", *(f"{f}-{p}" for f in families for p in priors)]
    assert len({style(name) for name in names}) == len(names)
    assert style("rrm-proxy").color == style("sac-proxy").color == style("rrm-surf-proxy").color
    assert style("rrm-mine") == style("rrm-mine")


def test_neighbours_differ_without_colour():
    """In greyscale every pair of methods differs in marker, filling or line."""
    priors = ("proxy", "o2g", "h2o", "sparse", "language")
    names = ["oracle", "pebble", *(f"{f}-{p}" for f in ("rrm", "sac") for p in priors)]
    assert len({style(name)[1:] for name in names}) == len(names)


@pytest.mark.parametrize(
    ("variant", "base"),
    [("pebble-bfloat16", "pebble"), ("rrm-proxy-bfloat16", "rrm-proxy"), ("oracle-bfloat16", "oracle"),
     ("finetune-mse-tanh", "finetune"), ("pebble-wide", "pebble"), ("rrm-proxy-wide", "rrm-proxy")],
)  # fmt: skip
def test_a_suffix_is_a_lighter_one_of_its_base(variant, base):
    """A method that is named after another has its hue, lighter and hollow, and a look of its own."""
    one, of = style(variant), style(base)
    assert lightness(rgb(variant)) > lightness(rgb(base)) + 5
    mixed = [(1 - a) / (1 - b) for a, b in zip(to_rgb(one.color), to_rgb(of.color), strict=True) if b < 0.9]
    assert max(mixed) - min(mixed) < 0.03  # towards white, all channels alike
    assert one.markerfacecolor == "white"
    assert one[1:] != of[1:]
    assert one.marker


def test_only_oracles_are_dotted():
    """Dots stand for the true reward, whatever its precision."""
    assert style("oracle").linestyle == style("oracle-bfloat16").linestyle == ":"
    others = ("pebble", "rrm-proxy", "sac-proxy", "pebble-bfloat16", "finetune-mse", "rrm-surf-proxy", "mine", "my-own")
    assert ":" not in {style(name).linestyle for name in others}


def test_the_measures_of_colour_are_right():
    """Black and white are 100 apart; the textbook pair red and green nearly meets for a deuteranope only."""
    assert distance((0, 0, 0), (1, 1, 1), "usual") == pytest.approx(100, abs=0.1)
    assert lightness((0.5, 0.5, 0.5)) == pytest.approx(53.4, abs=0.1)
    red, green = (0.75, 0.2, 0.1), (0.3, 0.5, 0.1)
    assert distance(red, green, "usual") > 70 > 30 > distance(red, green, "deuteranopia")
