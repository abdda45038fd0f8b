import itertools
from pathlib import Path

import pytest
from matplotlib.colors import to_rgb

from rrmctl.planning.manifest import load
from rrmctl.reports.figures.curves import learning_curves
from rrmctl.reports.styles import parts, style, styles
from tests.rrmctl.reports.frames import Sweep
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


#: Names of users', whom no table knows, among some that are known.
CROWDS = {
    "versions": ["rrm-v1", "rrm-new", "rrm-old"],
    "twelve": [
        "oracle",
        "pebble",
        *(f"rrm-{name}" for name in ("v1", "v2", "new", "old", "a", "b", "c", "d", "e", "f")),
    ],
    "learners": ["oracle", "pebble", "surf", *(f"mine{n}" for n in range(9))],
    "families": [f"{family}{name}" for name in ("v1", "new", "old") for family in ("", "rrm-", "sac-", "rrm-surf-")],
    "suffixes": ["oracle", "pebble", *(f"{m}-{s}" for m in ("oracle", "pebble", "rrm-proxy") for s in ("a", "b", "c"))],
    "settings": [f"{family}-proxy-bfloat16" for family in ("rrm", "sac", "rrm-surf", "rrm-mrn")],
    "crossed": ["pebble", "rrm-pebble", "proxy", "rrm-proxy", "finetune-mse", "pebble-mse", "surf-mse"],
    "forty": [f"rrm-{n}" for n in range(40)],
}


@pytest.mark.parametrize("crowd", CROWDS.values(), ids=CROWDS)
def test_whatever_is_drawn_together_is_told_apart(crowd):
    """Printed in black and white, every method of a figure has a marker, filling or line of its own."""
    looks = styles(crowd)
    assert len({(look.marker, look.linestyle, look.markerfacecolor == "white") for look in looks.values()}) == len(
        crowd
    )


def test_twelve_methods_differ_in_marker_and_colour():
    """Ten new methods beside two known ones: a marker and a colour for each, whatever the sight."""
    looks = styles(CROWDS["twelve"])
    assert len({look.marker for look in looks.values()}) == 12
    for one, two in itertools.combinations(looks.values(), 2):
        for sight in SIGHTS:
            if sight != "tritanopia":
                assert distance(to_rgb(one.color), to_rgb(two.color), sight) >= COLOUR, (one, two)


def test_new_methods_change_no_known_one():
    """Known methods keep their looks, a new one among them its own; the order of the plan plays no role."""
    crowd = ["rrm-mine", *CROWDS["families"], *CROWDS["suffixes"], "pebble", "rrm-proxy", "finetune-mse"]
    looks = styles(crowd)
    assert looks == styles(sorted(crowd, reverse=True))
    for known in ("oracle", "pebble", "rrm-proxy", "finetune-mse"):
        assert looks[known] == style(known)
    assert styles(["rrm-mine", "pebble", "rrm-proxy"])["rrm-mine"] == style("rrm-mine")


def test_a_prior_of_the_users_keeps_its_colour_in_every_family():
    """`rrm-mine` and `sac-mine` are to one another as `rrm-proxy` and `sac-proxy`, in whatever company."""
    looks = styles(["rrm-new", "sac-new", "rrm-old", "sac-old", "rrm-v1", "sac-v1"])
    for prior in ("new", "old", "v1"):
        ours, alone = looks[f"rrm-{prior}"], looks[f"sac-{prior}"]
        assert (ours.color, ours.marker) == (alone.color, alone.marker)
        assert (ours.markerfacecolor, alone.markerfacecolor) == (ours.color, "white")


def test_a_figure_draws_its_methods_apart():
    """Lines and legend of a figure go by the looks of all its methods, those without a run yet among them."""
    names = CROWDS["versions"]
    sweep = Sweep(curves={name: [[0.1 * n, 0.5, 1.0, 1.0]] for n, name in enumerate(names)})
    rows, jobs = sweep.frames()
    lines = learning_curves(rows, jobs).axes[0].lines
    assert [(line.get_color(), line.get_marker()) for line in lines] == [styles(names)[name][:2] for name in names]
    fewer = learning_curves(rows[rows["method"] != "rrm-v1"], jobs).axes[0].lines
    assert [line.get_marker() for line in fewer] == [styles(names)[name].marker for name in names[1:]]


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
