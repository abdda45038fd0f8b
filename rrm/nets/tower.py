"""What reads an encoder's features: a trunk that makes a few numbers of them, and MLPs on those.

The trunk's matrix is by far the largest. Those of several towers go through the features as one product (`project`),
and its gradients are written out; what follows is small, and plain autograd.
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from rrm.nets.flat import Parameters
from rrm.nets.products import bind

_LINEAR, _NORMAL = ["weight", "bias"], ["gain", "offset"]


class Tower:
    """Linear, layer normalisation and tanh; then `members` MLPs with ReLUs, without a non-linearity at the end.

    Args:
        inputs: features, R.
        trunk: numbers that are made of them.
        extra: numbers that the MLPs read beside those.
        generator: where the initial weights are drawn from, orthogonal with gain 1; None leaves everything zero, for a
            tower that is about to be loaded or copied into.
        dropout: of the hidden layers of the MLPs, which are then also normalised, before their ReLUs; None: neither.
    """

    def __init__(
        self,
        members: int,
        inputs: int,
        trunk: int,
        extra: int = 0,
        *,
        hidden: int,
        layers: int,
        outputs: int,
        generator: torch.Generator | None,
        dropout: float | None = None,
        device: torch.device | str = "cpu",
    ) -> None:
        self.members, self.layers, self.dropout = members, layers, dropout
        shapes: list[tuple[int, ...]] = [(trunk, inputs), (trunk,), (trunk,), (trunk,)]
        self._roles = _LINEAR + _NORMAL
        for layer, (i, o) in enumerate(pairwise([trunk + extra, *[hidden] * layers, outputs])):
            roles = _LINEAR if dropout is None or layer == layers else _LINEAR + _NORMAL
            self._roles = self._roles + roles
            shapes += [(members, o, i) if role == "weight" else (members, 1, o) for role in roles]
        self._parameters = Parameters(shapes, device)
        self.flat, self.flat_grad = self._parameters.flat, self._parameters.flat_grad
        self._leaves = self._parameters.leaves()
        self.trunk, self.trunk_grad = self._parameters.values[0], self._parameters.grads[0]  #: [trunk, R]
        if generator is not None:
            self.initialise(generator)

    def parameters(self) -> list[Tensor]:
        """Leaves for autograd that share memory with `flat`, and their gradients with `flat_grad`.

        The trunk's `[W, b, gain, offset]`, W [trunk, R]; then of each layer W [N, out, in], b [N, 1, out], and gain and
        offset [N, 1, out] where it is normalised.
        """
        return self._leaves

    def initialise(self, generator: torch.Generator) -> None:
        """Draw fresh weights in place."""
        for role, value in zip(self._roles, self._parameters.values, strict=True):
            value.fill_(role == "gain")
        self.perturb(0, generator)

    def perturb(self, kept: float, generator: torch.Generator) -> None:
        """Keep this share of every linear layer, and draw the rest anew; what normalises stays."""
        for role, value in zip(self._roles, self._parameters.values, strict=True):
            if role in _LINEAR:
                drawn = torch.zeros_like(value, device=generator.device)
                if role == "weight":
                    for member in drawn.view(-1, *value.shape[-2:]):
                        nn.init.orthogonal_(member, generator=generator)
                value.mul_(kept).add_(drawn.to(value.device), alpha=1 - kept)

    def outputs(
        self, pre: Tensor, extra: Tensor | None = None, *, frozen: bool = False, noise: torch.Generator | None = None
    ) -> list[Tensor]:
        """What every linear layer leaves, those between after their ReLU: [B, trunk], [N, B, hidden] ..., [N, B, out].

        Differentiable in `pre`, `extra` and, unless `frozen`, in the parameters.

        Args:
            pre: the trunk's product, float32 [B, trunk].
            extra: [B, extra].
            noise: what units are dropped by.
        """
        bias, gain, offset, *rest = (self._parameters.values if frozen else self._leaves)[1:]
        left = [pre + bias]
        h = torch.tanh(nn.functional.layer_norm(left[0], pre.shape[1:], gain, offset))
        h = (h if extra is None else torch.cat((h, extra), dim=1)).expand(self.members, -1, -1)
        params = iter(rest)
        for layer in range(self.layers + 1):
            weight, bias = next(params), next(params)
            h = torch.baddbmm(bias, h, weight.mT)
            if layer < self.layers:
                if self.dropout is not None:
                    h = nn.functional.layer_norm(self._dropped(h, noise), h.shape[-1:]) * next(params) + next(params)
                h = torch.relu(h)
            left.append(h)
        return left

    def _dropped(self, h: Tensor, noise: torch.Generator | None) -> Tensor:
        if not self.dropout:
            return h
        kept = torch.rand(h.shape, generator=noise, device=h.device).ge_(self.dropout)
        return h * kept / (1 - self.dropout)


def project(features: Tensor, *towers: Tower) -> list[Tensor]:
    """The product of each tower's trunk with the features [B, R], in their precision: float32 [B, trunk]."""
    weights = torch.cat([tower.trunk for tower in towers]) if len(towers) > 1 else towers[0].trunk
    products = product(features, weights.to(features.dtype).t()).float()
    return list(torch.split(products, [len(tower.trunk) for tower in towers], dim=1))


def product(a: Tensor, b: Tensor, out: Tensor | None = None) -> Tensor:
    """The product of two matrices of one precision, by the way that is the quickest on this machine."""
    out = a.new_empty(len(a), b.shape[1]) if out is None else out
    bind(a[None], b[None], out[None])()
    return out
