"""The preference buffer."""

import numpy as np
import torch

from rrm.buffers.pairs import EQUAL, FIRST, SECOND, PairRing, Preferences, StoredFeedback
from tests.rrm.buffers.test_experience import lived


def test_the_oldest_labels_give_way():
    """At most `capacity` labels stay, and they are the newest."""
    preferences = Preferences(3, 2)
    for i in range(5):
        preferences.add(np.array([[i, i + 10]]), np.array([i % 2], np.float32))
    assert len(preferences) == 3
    assert {2, 3, 4} == set(preferences.pairs[:, 0].tolist())


def test_a_restored_ring_goes_on_at_the_same_place():
    """Saved and restored, the next label replaces the same one."""
    first, second = Preferences(3, 2), Preferences(3, 2)
    first.add(np.arange(10).reshape(5, 2), np.zeros(5, np.float32))
    second.load_state_dict(first.state_dict())
    for preferences in (first, second):
        preferences.add(np.array([[77, 78]]), np.array([1], np.float32))
    np.testing.assert_array_equal(first.pairs, second.pairs)
    np.testing.assert_array_equal(first.labels, second.labels)


def test_labelled_segments_are_the_rows_asked_about():
    """Pairs come with their steps and the probability that the second is preferred; equal means one half."""
    experience = lived([6, 6])
    preferences = Preferences(10, 3)
    preferences.add(np.array([[0, 7], [1, 2], [8, 3]]), np.array([FIRST, EQUAL, SECOND], np.float32))
    feedback = StoredFeedback(experience, preferences, PairRing(1, 3), batch=2)
    first, second, target = feedback.pairs(torch.tensor([[0, 1], [2, 0]]))
    assert target.tolist() == [[0.0, 0.5], [1.0, 0.0]]
    assert first.obs.shape == (2, 2, 3, 2)
    assert first.obs[1, 0, :, 1].tolist() == [1.0, 2.0, 3.0]
    assert second.obs[0, 0].tolist() == [[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]


def test_the_newest_labels_are_those_given_last():
    """As many as a session asks for, newest last, also once the ring has come round; all while there are fewer."""
    preferences = Preferences(4, 3)
    feedback = StoredFeedback(lived([6]), preferences, PairRing(1, 3), batch=3)
    assert feedback.newest().tolist() == []
    seen = []
    for i in range(6):
        preferences.add(np.array([[i, i + 10]]), np.array([FIRST], np.float32))
        seen.append(preferences.pairs[feedback.newest().numpy(), 0].tolist())
    assert seen == [[0], [0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4], [3, 4, 5]]


def test_pairs_without_a_label_stand_beside_those_with_one():
    """They are looked up in their own ring, and a restored ring goes on where it was."""
    ring = PairRing(3, 2)
    ring.put(np.array([[0, 1], [2, 3], [1, 3], [4, 0]]))
    restored = PairRing(3, 2)
    restored.load_state_dict(ring.state_dict())
    for each in (ring, restored):
        each.put(np.array([[3, 3]]))
        feedback = StoredFeedback(lived([6]), Preferences(5, 2), each, batch=3)
        first, second = feedback.unlabelled_pairs(torch.tensor([[0], [1], [2]]))
        assert (len(feedback), feedback.unlabelled) == (0, 3)
        assert first.obs[:, 0, :, 1].tolist() == [[4.0, 5.0], [3.0, 4.0], [1.0, 2.0]]
        assert second.obs[:, 0, 0, 1].tolist() == [0.0, 3.0, 3.0]
