"""The reward of the unsupervised phase."""

import torch

from rrm.sources.entropy import StateEntropy


def test_distances_are_divided_by_their_running_deviation():
    """The batch enters the deviation before it is divided; the mean is not subtracted."""
    entropy = StateEntropy(None, None, None, 5)
    batches = [torch.tensor([1.0, 2.0, 6.0]), torch.tensor([4.0, 4.0])]
    torch.testing.assert_close(batches[0] / batches[0].std(), entropy.scaled(batches[0]))
    torch.testing.assert_close(batches[1] / torch.cat(batches).std(), entropy.scaled(batches[1]))


def test_equal_distances_are_worth_nothing():
    """Without any spread the reward is zero, not infinite."""
    assert StateEntropy(None, None, None, 5).scaled(torch.ones(4)).tolist() == [0.0] * 4
