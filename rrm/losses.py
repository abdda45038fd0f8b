"""The equations of the methods as pure functions."""

from __future__ import annotations

import math
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits, pad

Array = TypeVar("Array", Tensor, "np.ndarray[Any, np.dtype[np.float32]]")

_LOG_SQRT_2PI = 0.5 * math.log(2 * math.pi)


def preference_logit(r_hat_0: Tensor, r_hat_1: Tensor) -> Tensor:
    """Log-odds [...] that segment 1 is preferred to segment 0 (Bradley-Terry, paper eq. 1).

    Rewards per step are float32 [..., T]; those of a segment are summed, not averaged.
    """
    return r_hat_1.sum(dim=-1) - r_hat_0.sum(dim=-1)


def preference_loss(logits: Tensor, target: Tensor) -> Tensor:
    """Cross entropy between labels and preferences, averaged over pairs and summed over members (paper eq. 2).

    Args:
        logits: log-odds for segment 1 by every member, float32 [N, B].
        target: probability that segment 1 is preferred, float32 [B] or [N, B]; 0.5 for a tie.
    """
    losses = binary_cross_entropy_with_logits(logits, target.expand_as(logits), reduction="none")
    return losses.mean(dim=-1).sum()


def window_sums(r_hat: Tensor, starts: Tensor, ends: Tensor) -> Tensor:
    """Sums [..., K] of the rewards [..., T] of steps `starts` up to, not including, `ends`, int64 [..., K]."""
    if r_hat.device.type != "cpu":  # whose cumulative sums are in another order every time
        steps = torch.arange(r_hat.shape[-1], device=r_hat.device)
        inside = (steps >= starts.unsqueeze(-1)) & (steps < ends.unsqueeze(-1))
        return (r_hat.unsqueeze(-2) * inside).sum(dim=-1)
    before = pad(r_hat.cumsum(dim=-1), (1, 0))
    at_starts, at_ends = before.gather(-1, torch.cat((starts, ends), dim=-1)).chunk(2, dim=-1)
    return at_ends - at_starts


def pseudo_label_loss(logits: Tensor, opinion: Tensor, threshold: float) -> tuple[Tensor, Tensor]:
    """Cross entropy with labels that the members give themselves where they are sure (SURF, Park et al. 2022, eq. 4).

    Args:
        logits: log-odds for segment 1 by every member, float32 [N, B].
        opinion: log-odds by which each member labels, float32 [N, B]; a label has no gradient in them.
        threshold: probability of the likelier segment from which on the label counts.

    Returns:
        The loss, a float32 scalar, averaged over *all* pairs and summed over members; and how many labels counted.
    """
    sure = torch.sigmoid(opinion.abs()) >= threshold
    losses = binary_cross_entropy_with_logits(logits, (opinion > 0).to(logits.dtype), reduction="none")
    return (losses * sure).mean(dim=-1).sum(), sure.sum()


def with_uniform(log_prob: Tensor, share: float, actions: int) -> Tensor:
    """Log density [...] where an action of so many numbers is drawn uniformly from [-1, 1] with this probability, and
    with density exp(`log_prob`) otherwise: bounded below, however little the latter thinks of an action.
    """
    by_policy, by_chance = torch.tensor([1 - share, share]).log().tolist()
    uniform = torch.tensor(by_chance - actions * math.log(2), device=log_prob.device)
    return torch.logaddexp(log_prob + by_policy, uniform)


def squashed_gaussian_log_prob(noise: Array, log_std: Array, pre_tanh: Array, xp: Any = torch) -> Array:
    """Log density of the action `tanh(pre_tanh)`, where `pre_tanh = mean + exp(log_std) * noise` and noise is N(0, 1).

    The log-determinant of tanh, log(1 - tanh(x)^2), is taken as 2 (ln 2 - |x| - log(1 + exp(-2 |x|))), which stays
    finite where tanh rounds to one.

    Arguments are float32 [A, B]; the result is [B], nats, summed over the A dimensions. They are tensors, or arrays of
    numpy where `xp` is numpy.
    """
    size = abs(pre_tanh)
    log_cosh = size + xp.log1p(xp.exp(size * -2))  # and ln 2 less
    each = log_cosh * 2 - log_std - noise * noise * 0.5
    log_prob: Array = each.sum(0) - len(noise) * (_LOG_SQRT_2PI + 2 * math.log(2))
    return log_prob
