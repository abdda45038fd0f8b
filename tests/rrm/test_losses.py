"""The equations against hand-worked values and independent implementations."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.distributions import Normal, TanhTransform, TransformedDistribution

from rrm.losses import (
    preference_logit,
    preference_loss,
    pseudo_label_loss,
    squashed_gaussian_log_prob,
    window_sums,
    with_uniform,
)


def test_preference_logit_by_hand() -> None:
    """The logit is the difference of the summed rewards, positive where the second segment earns more."""
    first, second = torch.tensor([[[1.0, 2.0]]]), torch.tensor([[[0.5, 4.0]]])
    assert preference_logit(first, second).tolist() == [[1.5]]
    assert preference_logit(second, first).tolist() == [[-1.5]]


def test_preference_loss_by_hand() -> None:
    """Cross entropy with hard and soft labels, averaged over pairs, summed over members."""
    logits = torch.tensor([[math.log(3.0), 0.0], [0.0, 0.0]])  # probabilities 3/4 and 1/2 for the second segment
    target = torch.tensor([1.0, 0.5])
    expected = (-math.log(0.75) + math.log(2)) / 2 + math.log(2)
    assert preference_loss(logits, target).item() == pytest.approx(expected, rel=1e-6)


@given(logit=st.floats(-8, 8), target=st.floats(0, 1))
def test_preference_loss_equals_softmax(logit: float, target: float) -> None:
    """It is the cross entropy of a two-way softmax over the segments, as B-Pref writes it."""
    softmax = torch.log_softmax(torch.tensor([0.0, logit], dtype=torch.float64), dim=0)
    expected = -((1 - target) * softmax[0] + target * softmax[1]).item()
    ours = preference_loss(torch.tensor([[logit]], dtype=torch.float64), torch.tensor([target], dtype=torch.float64))
    assert ours.item() == pytest.approx(expected, abs=1e-12)


def test_preference_loss_gradient() -> None:
    """Its gradient in a logit is predicted minus wanted probability, over the pairs, also at huge logits."""
    logits = torch.tensor([[0.0, 500.0, -500.0]], requires_grad=True)
    preference_loss(logits, torch.tensor([1.0, 0.0, 0.0])).backward()
    assert logits.grad is not None
    torch.testing.assert_close(logits.grad, torch.tensor([[-0.5 / 3, 1 / 3, 0.0]]))


def test_log_prob_equals_torch_distributions() -> None:
    """The density is that of a Gaussian through tanh, as `torch.distributions` computes it."""
    torch.manual_seed(0)
    mean, log_std, noise = (torch.randn(50, 3, dtype=torch.float64) for _ in range(3))
    transform = TanhTransform(cache_size=1)
    act = transform(mean + log_std.exp() * noise)
    expected = TransformedDistribution(Normal(mean, log_std.exp()), transform).log_prob(act).sum(-1)
    torch.testing.assert_close(
        squashed_gaussian_log_prob(noise.t(), log_std.t(), (mean + log_std.exp() * noise).t()), expected
    )


def test_log_prob_integrates_to_one() -> None:
    """The density over actions in (-1, 1) has mass one."""
    pre_tanh = torch.linspace(-12, 12, 20_001, dtype=torch.float64)[None]
    mean, log_std = 0.3, torch.full_like(pre_tanh, -0.4)
    noise = (pre_tanh - mean) / log_std.exp()
    density = squashed_gaussian_log_prob(noise, log_std, pre_tanh).exp()
    assert torch.trapezoid(density, torch.tanh(pre_tanh[0])).item() == pytest.approx(1.0, abs=1e-6)


@given(st.floats(-2000, 20), st.floats(0, 1), st.integers(1, 8))
def test_a_density_mixed_with_uniform_actions(log_prob: float, share: float, actions: int) -> None:
    """As the mixture of both densities has it; nothing mixed in is the density itself."""
    mixed = with_uniform(torch.tensor([log_prob]), share, actions).double()
    expected = (1 - share) * math.exp(log_prob) + share / 2**actions
    torch.testing.assert_close(mixed.exp(), torch.tensor([expected]).double(), rtol=1e-4, atol=1e-30)
    assert with_uniform(torch.tensor([log_prob]), 0.0, actions).item() == pytest.approx(log_prob, rel=1e-6)


def test_log_prob_is_finite_where_tanh_saturates() -> None:
    """Far out, where tanh rounds to one in float32, the density stays finite."""
    pre_tanh = torch.tensor([[60.0, -60.0]])
    assert squashed_gaussian_log_prob(torch.zeros(1, 2), torch.zeros(1, 2), pre_tanh).isfinite().all()


@given(st.integers(1, 9), st.data())
def test_window_sums_are_the_sums(steps: int, data: st.DataObject) -> None:
    """Every window from start to end, the empty and the whole one included, is summed as a loop sums it."""
    windows = data.draw(st.lists(st.tuples(*[st.integers(0, steps)] * 2).map(sorted), min_size=1, max_size=4))
    rewards = torch.randn(2, 3, steps, dtype=torch.float64)
    starts, ends = (edges.expand(2, 3, -1) for edges in torch.tensor(windows).unbind(dim=1))
    sums = window_sums(rewards, starts, ends)
    for k, (start, end) in enumerate(windows):
        torch.testing.assert_close(rewards[..., start:end].sum(-1), sums[..., k])


def test_pseudo_labels_by_hand() -> None:
    """Sure opinions are labels, unsure ones count as nothing in the mean over all pairs, members add up."""
    opinion = torch.tensor([[3.0, -3.0, 1.0, 0.0]] * 2, requires_grad=True)  # probabilities 0.953, 0.047, 0.731, 0.5
    logits = torch.tensor([[math.log(3.0), math.log(3.0), 7.0, 7.0], [0.0, 0.0, 7.0, 7.0]], requires_grad=True)
    loss, sure = pseudo_label_loss(logits, opinion, 0.95)
    expected = (-math.log(0.75) - math.log(0.25)) / 4 + 2 * math.log(2) / 4
    assert loss.item() == pytest.approx(expected, rel=1e-6)
    assert sure.item() == 4
    loss.backward()
    assert opinion.grad is None
    assert logits.grad is not None
    assert logits.grad[:, 2:].tolist() == [[0.0, 0.0], [0.0, 0.0]]


def test_a_pseudo_label_counts_from_the_threshold_on() -> None:
    """A threshold of one half takes every opinion, and none is sure beyond one's reach."""
    opinion = torch.tensor([[0.0, 0.1, -0.1]])
    assert [pseudo_label_loss(opinion, opinion, t)[1].item() for t in (0.5, 0.51, 1.0)] == [3, 2, 0]
