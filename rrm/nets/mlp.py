"""Several independent MLPs of one shape, stacked so that each layer is one batched matrix product.

The parameters of a stack lie in one flat buffer: an optimiser step or a Polyak average is then a single operation.
`forward` and `backward_*` are written out: they work in a reusable `Tape` and compute only the gradients asked for.
Calling a stack uses the same equations under autograd. `plain` is the reference, ordinary differentiable code that
takes the parameters as an argument; the tests compare all of them, and with `torch.nn.Linear`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import torch
from torch import Tensor, nn

from rrm.nets.precision import Multiplying

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rrm.precision import Precision

Activation = Literal["relu", "leaky_relu"]
Init = Literal["orthogonal", "torch"]

LEAK = 0.01  #: slope of leaky_relu below zero

#: Every parameter starts on a cache line, so that results do not depend on the sizes of its neighbours.
_ALIGN = 16


@dataclass
class Tape:
    """What one `forward` leaves for a backward pass, and room for the gradients on the way down."""

    inputs: Tensor  #: what the stack was given, [N, B, in]
    hidden: list[Tensor]  #: after the activation, [N, B, hidden] each
    outputs: Tensor  #: [N, out, B]
    deltas: tuple[Tensor, Tensor]  #: [N, B, hidden], used in turns

    def second_half(self) -> Tape:
        """The part of a tape of one member that belongs to the second half of the rows; it shares memory."""
        groups = self.hidden, self.deltas
        hidden, deltas = ([rows.view(2, -1, rows.shape[-1])[1:] for rows in group] for group in groups)
        inputs = self.inputs[:, self.inputs.shape[1] // 2 :]
        return Tape(inputs, hidden, self.outputs.chunk(2, dim=-1)[1], (deltas[0], deltas[1]))


class StackedMLP:
    """`members` MLPs `inputs -> hidden (x layers) -> outputs`, without a non-linearity at the end.

    Args:
        members: networks in the stack, N.
        generator: where the initial weights are drawn from, each member as a network of its own; None leaves them zero,
            for a stack that is about to be loaded or copied into.
        activation: of the hidden layers; leaky_relu has slope 0.01.
        init: `orthogonal` with gain 1 and zero biases (B-Pref's agent), or `torch`, `nn.Linear`'s own (its reward).
        precision: of the products between hidden layers, see `rrm.nets.precision`.
        device: where the parameters live; the generator must be of the same device.
    """

    def __init__(
        self,
        members: int,
        inputs: int,
        hidden: int,
        layers: int,
        outputs: int,
        *,
        generator: torch.Generator | None,
        activation: Activation = "relu",
        init: Init = "orthogonal",
        precision: Precision = "float32",
        device: torch.device | str = "cpu",
    ) -> None:
        self.members = members
        self.widths = (inputs, *[hidden] * layers, outputs)
        self.activation = activation
        self.init = init
        self._inner, self._outer = Multiplying(precision), Multiplying("float32")
        shapes = [s for i, o in zip(self.widths, self.widths[1:], strict=False) for s in ((i, o), (1, o))]
        shapes[-2] = (outputs, self.widths[-2])
        size = sum(_padded(members * math.prod(shape)) for shape in shapes)
        self.flat = torch.zeros(size, device=device)  #: all parameters; the padding between them stays zero
        self.flat_grad = torch.zeros_like(self.flat)  #: their gradients, filled by `backward_params`
        self._params = self._windows(self.flat, shapes)
        self._transposed = [_t(p) for p in self._params]
        self.grads = self._windows(self.flat_grad, shapes)  #: views in the order and shapes of `parameters()`
        self._spare: tuple[int, Tape] | None = None
        self._leaves = [p.detach().requires_grad_() for p in self._params]
        if generator is not None:
            self.initialise(generator)

    def _windows(self, flat: Tensor, shapes: Sequence[tuple[int, int]]) -> list[Tensor]:
        """Views into a flat buffer, [N, *shape] each; the last weight is stored transposed, see `forward`."""
        views: list[Tensor] = []
        offset = 0
        for shape in shapes:
            size = self.members * math.prod(shape)
            views.append(flat[offset : offset + size].view(self.members, *shape))
            offset += _padded(size)
        views[-2] = views[-2].transpose(1, 2)
        return views

    def initialise(self, generator: torch.Generator) -> None:
        """Draw fresh weights in place."""
        for member in range(self.members):
            for weight, bias in zip(self._params[::2], self._params[1::2], strict=True):
                fan_in, fan_out = weight.shape[1:]
                drawn = torch.empty(fan_out, fan_in, device=weight.device)
                if self.init == "orthogonal":
                    nn.init.orthogonal_(drawn, generator=generator)
                    bias[member].zero_()
                else:
                    bound = 1 / math.sqrt(fan_in)
                    drawn.uniform_(-bound, bound, generator=generator)
                    bias[member].uniform_(-bound, bound, generator=generator)
                weight[member].copy_(drawn.t())

    def tape(self, batch: int) -> Tape:
        """A fresh tape for inputs of `batch` rows, to be used again and again."""

        def room(*shape: int) -> Tensor:
            return torch.empty(self.members, *shape, device=self.flat.device)

        hidden = [room(batch, width) for width in self.widths[1:-1]]
        widest = max(self.widths[1:-1], default=0)
        return Tape(room(batch, 0), hidden, room(self.widths[-1], batch), (room(batch, widest), room(batch, widest)))

    def take_tape(self, batch: int) -> Tape:
        """The tape given back last, where it is of this size: fresh memory costs as much as a layer."""
        spare, self._spare = self._spare, None
        return spare[1] if spare is not None and spare[0] == batch else self.tape(batch)

    def give_back(self, tape: Tape) -> None:
        """Let the next call write into this tape."""
        self._spare = (tape.outputs.shape[-1], tape)

    def parameters(self) -> list[Tensor]:
        """Leaves for autograd that share memory with `flat`: `[W0, b0, W1, b1, ...]`, W [N, in, out], b [N, 1, out]."""
        return self._leaves

    def __call__(self, x: Tensor) -> Tensor:
        """Outputs float32 [N, out, B] of x, [B, in] or [N, B, in]; differentiable in `parameters()`, not in x."""
        if not torch.is_grad_enabled():
            tape = self.take_tape(x.shape[-2])
            outputs = self.forward(x, tape).clone()
            self.give_back(tape)
            return outputs
        return _WrittenOut.apply(self, x, *self._leaves)  # type: ignore[no-any-return, no-untyped-call]

    def plain(self, x: Tensor, params: Sequence[Tensor] | None = None) -> Tensor:
        """The same outputs, differentiable in everything and any number of times, in float32.

        `params` stand in for the stack's own, in the order and shapes of `parameters()`.
        """
        params = self._leaves if params is None else params
        h = x.expand(self.members, -1, -1)
        for weight, bias in zip(params[:-2:2], params[1:-2:2], strict=True):
            h = torch.baddbmm(bias, h, weight)
            h = torch.relu_(h) if self.activation == "relu" else nn.functional.leaky_relu_(h, LEAK)
        return torch.baddbmm(_t(params[-1]), _t(params[-2]), _t(h))

    def forward(self, x: Tensor, tape: Tape) -> Tensor:
        """Outputs [N, out, B] of x, [B, in] or [N, B, in], in the tape; x must not change before the backward pass.

        The output is narrow, and matrix libraries are several times quicker when the narrow side comes first: the last
        product, its weights and its gradient are computed transposed.
        """
        tape.inputs = h = x.expand(self.members, -1, -1)
        for layer, out in enumerate(tape.hidden):
            weight, bias = self._params[2 * layer : 2 * layer + 2]
            with self._inner if layer else self._outer:
                torch.bmm(h, weight, out=out)
            if self.activation == "leaky_relu":
                h = nn.functional.leaky_relu_(out.add_(bias), LEAK)
            elif out.device.type == "cpu":  # one pass over memory
                torch.ops.aten._add_relu_.Tensor(out, bias)
                h = out
            else:
                h = out.add_(bias).relu_()
        with self._outer:
            return torch.baddbmm(self._transposed[-1], self._transposed[-2], _t(h), out=tape.outputs)

    def backward_params(self, grad: Tensor, tape: Tape) -> None:
        """Overwrite `flat_grad` with a loss' gradient, given its gradient [N, out, B] in the tape's outputs."""
        below = tape.hidden[-1] if tape.hidden else tape.inputs
        with self._outer:
            torch.bmm(grad, below, out=_t(self.grads[-2]))
        torch.sum(grad, 2, keepdim=True, out=_t(self.grads[-1]))
        grad = _t(grad)
        for layer in reversed(range(len(tape.hidden))):
            grad = self._descend(layer, grad, tape)
            below = tape.hidden[layer - 1] if layer else tape.inputs
            with self._inner if layer else self._outer:
                torch.bmm(_t(below), grad, out=self.grads[2 * layer])
            torch.sum(grad, 1, keepdim=True, out=self.grads[2 * layer + 1])

    def backward_inputs(self, grad: Tensor, tape: Tape, columns: slice) -> Tensor:
        """Gradient in these columns of the tape's inputs, [N, columns, B], given that in its outputs, [N, out, B]."""
        grad = _t(grad)
        for layer in reversed(range(len(tape.hidden))):
            grad = self._descend(layer, grad, tape)
        with self._outer:
            return torch.bmm(self._params[0][:, columns], _t(grad))

    def _descend(self, layer: int, grad: Tensor, tape: Tape) -> Tensor:
        """The gradient in the product of a hidden layer, given that in the product of the layer above."""
        activated = tape.hidden[layer]
        with self._inner if layer + 1 < len(tape.hidden) else self._outer:
            delta = torch.bmm(grad, self._transposed[2 * layer + 2], out=tape.deltas[layer % 2])
        # Both activations keep the sign of their input, so their output tells on which side it was.
        if self.activation == "relu":
            torch.ops.aten.threshold_backward.grad_input(delta, activated, 0, grad_input=delta)
        else:
            torch.ops.aten.leaky_relu_backward.grad_input(delta, activated, LEAK, True, grad_input=delta)
        return delta


class _WrittenOut(torch.autograd.Function):
    """`StackedMLP.forward` and `backward_params` as one differentiable operation."""

    @staticmethod
    def forward(ctx: Any, net: StackedMLP, x: Tensor, *leaves: Tensor) -> Tensor:
        ctx.net, ctx.tape = net, net.take_tape(x.shape[-2])
        ctx.save_for_backward(*leaves)  # autograd refuses a backward pass after they were changed
        return net.forward(x, ctx.tape).clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors
        ctx.net.backward_params(grad, ctx.tape)
        ctx.net.give_back(ctx.tape)
        return None, None, *(window.clone() for window in ctx.net.grads)


def _t(stack: Tensor) -> Tensor:
    return stack.transpose(1, 2)


def _padded(size: int) -> int:
    return -(-size // _ALIGN) * _ALIGN
