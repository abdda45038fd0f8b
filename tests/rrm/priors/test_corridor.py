"""The corridor of the penalty proxy, against the convex hull of the corners that its description gives."""

import itertools

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from rrm.envs import task
from rrm.priors import load_prior
from rrm.priors.corridor import HALF, inside
from rrm.priors.step import PriorStep, Scene

SPEC = task("sweep-into-image")

places = st.tuples(*[st.floats(-0.5, 0.5)] * 3).map(np.array)
shares = st.floats(0, 1)


def worth(hand, start, object_start, goal):
    """The penalty of a hand here, in an episode that began with these places."""
    obs, first = (np.zeros(SPEC.spaces.obs, np.float32) for _ in range(2))
    for state, at in ((obs, hand), (first, start)):
        for name, place in (("hand", at), ("object_start", object_start), ("goal", goal)):
            state[SPEC.features[name]] = place
    step = PriorStep(SPEC, obs, np.zeros(4, np.float32), {}, np.random.default_rng(0), Scene(SPEC, first))
    return load_prior("penalty")(step)


def corners(begin, end):
    """Of the cuboid: one along x, pitched up and then turned about the vertical, and moved there."""
    way = end - begin
    turn, pitch = np.arctan2(way[1], way[0]), np.arctan2(way[2], np.hypot(way[0], way[1]))
    pitched = np.array([[np.cos(pitch), 0, -np.sin(pitch)], [0, 1, 0], [np.sin(pitch), 0, np.cos(pitch)]])
    turned = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]]) @ pitched
    half = np.array([np.linalg.norm(way) / 2 + HALF, HALF, HALF])
    return np.array([turned @ (half * signs) for signs in itertools.product((-1, 1), repeat=3)]) + (begin + end) / 2


def test_width():
    """0.2 m, as the paper says."""
    assert HALF == 0.1


@given(places, places, places)
def test_it_is_the_hull_of_its_corners(begin, end, point):
    """Membership is what scipy's triangulation of the eight corners says, but for points on the surface."""
    assume(np.hypot(*(end - begin)[:2]) > 1e-3)  # straight up, sides may face anywhere
    point = (begin + end) / 2 + (point - begin) / 2  # often inside, often not
    hull = corners(begin, end)
    centre = hull.mean(0)
    grown, shrunk = (Delaunay(centre + (hull - centre) * scale) for scale in (1 + 1e-6, 1 - 1e-6))
    assume(grown.find_simplex(point) < 0 or shrunk.find_simplex(point) >= 0)
    assert inside(point, begin, end) == bool(Delaunay(hull).find_simplex(point) >= 0)


@given(places, places, places, st.booleans(), shares, places)
def test_on_the_way_and_far_from_it(start, object_start, goal, second, share, aside):
    """Nothing is paid on the way and up to 0.1 m from it; -1 beyond half the cuboids' diagonal from both segments."""
    begin, end = (object_start, goal) if second else (start, object_start)
    assume(np.linalg.norm(aside) > 1e-3)
    on = begin + share * (end - begin)
    assert worth(on + 0.099 * aside / np.linalg.norm(aside), start, object_start, goal) == 0.0
    away = min(_distance(aside, *ends) for ends in itertools.pairwise((start, object_start, goal)))
    if away > np.sqrt(3) * HALF + 1e-6:
        assert worth(aside, start, object_start, goal) == -1.0


def _distance(point, begin, end):
    way = end - begin
    share = np.clip((point - begin) @ way / max(way @ way, 1e-12), 0, 1)
    return np.linalg.norm(begin + share * way - point)


@given(places, places, places, places, st.floats(-3, 3))
def test_where_it_stands_plays_no_part(begin, end, point, by, turn):
    """Moved, turned about the vertical or read backwards, it is the same corridor."""
    turned = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    assume(np.hypot(*(end - begin)[:2]) > 1e-3)
    point = (begin + end) / 2 + (point - begin) / 2
    nudges = [
        inside((begin + end) / 2 + (point - (begin + end) / 2) * scale, begin, end) for scale in (1, 1 - 1e-6, 1 + 1e-6)
    ]
    assume(len(set(nudges)) == 1)  # on its surface, rounding decides
    assert inside(point, end, begin) == nudges[0]
    assert inside(turned @ point + by, turned @ begin + by, turned @ end + by) == nudges[0]


@pytest.mark.parametrize(
    ("off", "expected"),
    [
        ((0.0, 0.0, 0.0), True), ((0.0, 0.09, 0.29), True), ((0.09, 0.0, -0.29), True), ((0.0, 0.0, 0.31), False),
        ((0.11, 0.0, 0.0), False), ((0.0, -0.11, 0.1), False),
    ],
)  # fmt: skip
def test_straight_up(off, expected):
    """A way without direction on the floor, 0.4 m high, has faces along x and y; a way of no length is a cube."""
    middle = np.array([0.1, 0.6, 0.3])
    up = np.array([0.0, 0.0, 0.2])
    assert inside(middle + off, middle - up, middle + up) == expected
    assert inside(middle + 0.09, middle, middle)
    assert not inside(middle + np.array([0.0, 0.0, 0.11]), middle, middle)
