"""The convolutions of an agent that sees frames, from whole numbers to features, and back.

Everything between is computed for a few frames at a time, so that it stays in the caches; how many decides how sums
are rounded, and is fixed. Pictures lie with their channels together, and so do features. `plain` is the reference, in
plain differentiable code; the tests compare.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING, cast

import torch
from torch import Tensor, nn

from rrm.errors import ConfigError
from rrm.nets.flat import Parameters
from rrm.nets.shift import pictures

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rrm.config import DrqConfig
    from rrm.envs.spaces import FrameSpace
    from rrm.precision import Precision

_SIDE = 3  #: of every kernel
AT_ONCE = {torch.float32: 16, torch.bfloat16: 64}  #: pictures

#: A picture is read as x - 128, which bfloat16 holds exactly: x / 255 - 1/2 is that over 255, and so much more.
_SCALE, _MORE = 1 / 255, 128 / 255 - 0.5


class Encoder:
    """Convolutions of 3 x 3 without padding, each followed by a ReLU, of pictures scaled to [-1/2, 1/2].

    Args:
        config: its `channels` and `strides`.
        frames: a stack of so many such pictures is what is seen at once.
        generator: where the initial weights are drawn from, orthogonal with gain sqrt(2); None leaves them zero, for an
            encoder that is about to be loaded or copied into.
        precision: of the convolutions; sums of them are float32, and so are weights and gradients.
        device: where the parameters live; the generator may be of another.
    """

    def __init__(
        self,
        config: DrqConfig,
        frames: FrameSpace,
        generator: torch.Generator | None,
        precision: Precision = "float32",
        device: torch.device | str = "cpu",
    ) -> None:
        self._made = config, frames, precision, device
        self.dtype = torch.bfloat16 if precision == "bfloat16" else torch.float32
        self.strides = config.strides
        widths = [frames.stack * frames.channels, *[config.channels] * len(self.strides)]
        sides = [(frames.height, frames.width)]
        for stride in self.strides:
            height, width = ((side - _SIDE) // stride + 1 for side in sides[-1])
            sides.append((height, width))
        if min(sides[-1]) < 1:
            raise ConfigError(
                f"agent.strides: of {frames.height} x {frames.width} pixels, {len(self.strides)} convolutions of 3 x 3 "
                "leave nothing; fewer of them, smaller strides or a larger camera.size would"
            )
        self.shapes = [(*side, width) for side, width in zip(sides[1:], widths[1:], strict=True)]  #: of what is left
        self.outputs = math.prod(self.shapes[-1])  #: features
        self._parameters = Parameters(
            [shape for i, o in pairwise(widths) for shape in ((o, _SIDE, _SIDE, i), (o,))], device
        )
        self.flat, self.flat_grad = self._parameters.flat, self._parameters.flat_grad
        self._leaves = self._parameters.leaves()
        if generator is not None:
            for weight in _planar(self._parameters.values)[::2]:
                drawn = torch.empty(weight.shape, device=generator.device)
                weight.copy_(nn.init.orthogonal_(drawn, math.sqrt(2), generator=generator))

    def frozen(self) -> Encoder:
        """A copy that does not change any more."""
        config, frames, precision, device = self._made
        copy = Encoder(config, frames, None, precision, device)
        copy.flat.copy_(self.flat)
        return copy

    def parameters(self) -> list[Tensor]:
        """Leaves for autograd that share memory with `flat`: `[W0, b0, W1, b1, ...]`, W [out, 3, 3, in], b [out]."""
        return self._leaves

    @torch.no_grad()
    def encode(self, frames: Tensor) -> Tensor:
        """Features float32 [B, outputs] of uint8 [B, stack, channels, height, width], without gradient."""
        return Pass(self, len(frames), back=False).forward(frames).float()

    def factors(self) -> list[Tensor]:
        """`[W0, b0, ...]` as they are multiplied with: rounded, and the first take x - 128."""
        weight, bias, *rest = _planar(self._parameters.values)
        folded = [weight * _SCALE, bias + weight.sum((1, 2, 3)) * _MORE, *rest]
        return [factor.to(self.dtype) for factor in folded]

    def gradients(self) -> list[Tensor]:
        """Views of `flat_grad` with the axes of `factors`."""
        return _planar(self._parameters.grads)

    def plain(self, frames: Tensor, params: Sequence[Tensor] | None = None) -> Tensor:
        """The features of `frames`, differentiable in `params`, which stand in for the encoder's own."""
        params = self.parameters() if params is None else params
        h = frames.flatten(1, 2).to(params[0].dtype) / 255 - 0.5
        planar = _planar(params)
        for weight, bias, stride in zip(planar[::2], planar[1::2], self.strides, strict=True):
            h = torch.relu(nn.functional.conv2d(h, weight, bias, stride))
        return h.permute(0, 2, 3, 1).flatten(1)


class Pass:
    """A way of so many stacks through an encoder, and back to its parameters, with what it leaves in fixed places.

    Args:
        back: whether what the way back needs is kept.
    """

    def __init__(self, net: Encoder, stacks: int, *, back: bool = True) -> None:
        self._net, self._back = net, back
        last = len(net.shapes) - 1
        self._rooms = [  # what each layer leaves, where it is kept
            torch.empty(stacks, *shape, dtype=net.dtype, device=net.flat.device) if back or layer == last else None
            for layer, shape in enumerate(net.shapes)
        ]
        self.features = cast("Tensor", self._rooms[-1]).view(stacks, -1)  #: in the encoder's precision, [B, outputs]
        step = AT_ONCE[net.dtype] if net.flat.device.type == "cpu" else stacks
        self._chunks = [slice(begin, min(begin + step, stacks)) for begin in range(0, stacks, step)]
        self._factors: list[Tensor] = []
        self._pictures: list[Tensor] = []

    @torch.no_grad()
    def forward(self, frames: Tensor, moves: Tensor | None = None) -> Tensor:
        """The features of `frames` uint8 [B, stack, channels, height, width], moved as `pictures` does it."""
        self._factors, self._pictures = self._net.factors(), []
        for rows in self._chunks:
            seen = pictures(frames[rows], None if moves is None else moves[rows])
            if self._back:
                self._pictures.append(seen)
            h = self._read(seen)
            for layer, room in enumerate(self._rooms):
                weight, bias = self._factors[2 * layer : 2 * layer + 2]
                product = nn.functional.conv2d(h, weight, bias, self._net.strides[layer])
                h = product.relu_() if room is None else torch.clamp_min(product, 0, out=_planes(room[rows]))
        return self.features

    @torch.no_grad()
    def backward(self, grad: Tensor) -> None:
        """Overwrite `flat_grad` of the encoder with a loss' gradient, given that in the features, [B, outputs]."""
        net, grads = self._net, self._net.gradients()
        net.flat_grad.zero_()
        for rows, seen in zip(self._chunks, self._pictures, strict=True):
            left = [_planes(room[rows]) for room in self._rooms if room is not None]
            delta = _planes(grad[rows].view(-1, *net.shapes[-1]))
            for layer in reversed(range(len(left))):
                delta = torch.ops.aten.threshold_backward(delta, left[layer], 0)
                below = left[layer - 1] if layer else self._read(seen)
                weight, stride = self._factors[2 * layer], [net.strides[layer]] * 2
                delta, of_weight, of_bias = torch.ops.aten.convolution_backward(
                    delta, below, weight, [len(weight)], stride, [0, 0], [1, 1], False, [0, 0], 1,
                    [layer > 0, True, True],
                )  # fmt: skip
                grads[2 * layer].add_(of_weight)
                grads[2 * layer + 1].add_(of_bias)
        grads[0].mul_(_SCALE).add_(grads[1].view(-1, 1, 1, 1), alpha=_MORE)  # of what was folded

    def _read(self, seen: Tensor) -> Tensor:
        return seen.to(self._net.flat.device, self._net.dtype)


def _planar(params: Sequence[Tensor]) -> list[Tensor]:
    """Weights with the axes of `conv2d`, [out, in, 3, 3], and biases."""
    return [param.permute(0, 3, 1, 2) if param.ndim == 4 else param for param in params]


def _planes(rows: Tensor) -> Tensor:
    """[b, height, width, channels] with the axes of `conv2d`."""
    return rows.permute(0, 3, 1, 2)
