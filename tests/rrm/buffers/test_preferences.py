"""The preference buffer."""

import numpy as np
import torch

from rrm.buffers.preferences import EQUAL, FIRST, SECOND, LabelledSegments, Preferences
from tests.rrm.buffers.test_experience import lived


def test_the_oldest_labels_give_way():
    """At most `capacity` labels stay, and they are the newest."""
    preferences = Preferences(3, 2)
    for i in range(5):
        preferences.add(np.array([[i, i + 10]]), np.array([i % 2], np.int8))
    assert len(preferences) == 3
    assert {2, 3, 4} == set(preferences.pairs[:, 0].tolist())


def test_a_restored_ring_goes_on_at_the_same_place():
    """Saved and restored, the next label replaces the same one."""
    first, second = Preferences(3, 2), Preferences(3, 2)
    first.add(np.arange(10).reshape(5, 2), np.zeros(5, np.int8))
    second.load_state_dict(first.state_dict())
    for preferences in (first, second):
        preferences.add(np.array([[77, 78]]), np.array([1], np.int8))
    np.testing.assert_array_equal(first.pairs, second.pairs)
    np.testing.assert_array_equal(first.labels, second.labels)


def test_labelled_segments_are_the_rows_asked_about():
    """Pairs come with their steps and the probability that the second is preferred; equal means one half."""
    experience = lived([6, 6])
    preferences = Preferences(10, 3)
    preferences.add(np.array([[0, 7], [1, 2], [8, 3]]), np.array([FIRST, EQUAL, SECOND], np.int8))
    first, second, target = LabelledSegments(experience, preferences).pairs(torch.tensor([[0, 1], [2, 0]]))
    assert target.tolist() == [[0.0, 0.5], [1.0, 0.0]]
    assert first.obs.shape == (2, 2, 3, 2)
    assert first.obs[1, 0, :, 1].tolist() == [1.0, 2.0, 3.0]
    assert second.obs[0, 0].tolist() == [[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]
