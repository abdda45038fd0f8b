"""Several independent MLPs of one shape, stacked so that each layer is one batched matrix product.

The parameters of a stack lie in one flat buffer: an optimiser step or a Polyak average is then a single operation.
A `Pass` is a way through a stack and back with everything at a fixed place in memory; both directions are written out
and compute only the gradients asked for. Calling a stack makes passes under autograd. `plain` is the reference, plain
differentiable code that takes the parameters as an argument; the tests compare all of them, and with `nn.Linear`.
"""

from __future__ import annotations

import copy
import math
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import torch
from torch import Tensor, nn

from rrm.nets.compiled import EPSILON, LEAK
from rrm.nets.flat import ALIGN, Parameters
from rrm.nets.products import bind
from rrm.nets.program import (
    Activation,
    Normal,
    Work,
    activate,
    add_to_rows,
    convert,
    fuse,
    normalise,
    sum_rows,
    undo,
    undo_norm,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from rrm.precision import Precision

Init = Literal["orthogonal", "torch"]

#: Rows that go through a stack together where no way back is needed, by the kind of device: their activations stay in
#: the caches of a processor; a card wants more to do at a time.
_AT_ONCE = {"cpu": 2048, "cuda": 8192}

#: Passes kept by a stack for its next calls, of different numbers of rows.
_SPARES = 2


class Memory:
    """Room for the activations of one pass; passes that are not under way at the same time can share it.

    With products in bfloat16 what they read is stored so: the activations but for the last, and gradients but for those
    at the first layer.
    """

    def __init__(self, net: StackedMLP, rows: int) -> None:
        def room(width: int, dtype: torch.dtype) -> Tensor:
            # Rows a multiple of 1 KiB apart fall into the same few sets of a cache, which costs a product 5 %.
            here = net.flat.device.type == "cpu"
            apart = width + ALIGN * (here and width % 256 == 0 and dtype == torch.float32)
            return torch.empty(net.members, rows, apart, dtype=dtype, device=net.flat.device)[..., :width]

        layers, widest = len(net.widths) - 2, max(net.widths[1:-1], default=0)
        self.hidden = [  #: after the activation, [N, B, hidden] each
            room(width, torch.float32 if layer == layers - 1 else net.inner)
            for layer, width in enumerate(net.widths[1:-1])
        ]
        self.outputs = torch.zeros(net.members, net.widths[-1], rows, device=net.flat.device)  #: [N, out, B]
        self.normal = [  #: of each hidden layer, where they are normalised
            Normal(room(width, torch.float32), torch.empty(net.members, rows, device=net.flat.device))
            for width in net.widths[1:-1]
            if net.normalised
        ]
        self._spare = {
            dtype: [room(widest, dtype) for _ in range(2)] for dtype in {torch.float32, net.inner}
        }  # used in turns

    def spare(self, dtype: torch.dtype, turn: int) -> Tensor:
        """Room for a product, [N, B, hidden], that two turns later is written over."""
        return self._spare[dtype][turn % 2]

    def part(self, rows: slice) -> Memory:
        """That of these rows alone."""
        part = copy.copy(self)
        part.hidden, part.outputs = [layer[:, rows] for layer in self.hidden], self.outputs[..., rows]
        part.normal = [Normal(*(kept[:, rows] for kept in normal)) for normal in self.normal]
        part._spare = {dtype: [room[:, rows] for room in rooms] for dtype, rooms in self._spare.items()}
        return part


class Pass:
    """A way through a stack and back. Whoever owns it fills `inputs`, and `grad` before it asks for gradients.

    The output is narrow, and matrix libraries are several times quicker when the narrow side comes first: the last
    product, its weights and its gradient are computed transposed.

    Args:
        inputs: [B, in] or [N, B, in], read when `forward` is called and again on the way back.
        columns: of the inputs that `backward_inputs` is about.
    """

    def __init__(
        self, net: StackedMLP, inputs: Tensor, memory: Memory | None = None, columns: slice | None = None
    ) -> None:
        self._net = net
        self.given = inputs
        self.inputs = inputs.expand(net.members, -1, -1)
        self._memory = memory = memory or Memory(net, inputs.shape[-2])
        self.outputs = memory.outputs  #: [N, out, B]
        self.grad = torch.empty_like(memory.outputs, memory_format=torch.contiguous_format)  #: in the outputs
        self._weight = net.weights[0][:, columns or slice(None)]

    def __call__(self, x: Tensor) -> Tensor:
        """`forward` of these inputs, which are copied to where it reads them."""
        self.given.copy_(x)
        return self.forward()

    def forward(self) -> Tensor:
        """The outputs, [N, out, B], where they stay until the next pass in this memory."""
        for work in self._up:
            work()
        return self.outputs

    def backward_params(self) -> None:
        """Overwrite `flat_grad` of the stack with a loss' gradient, given its gradient in the outputs."""
        for work in self._to_params:
            work()

    def backward_inputs(self) -> Tensor:
        """Gradient in the columns of the inputs, [N, columns, B], where it stays, given that in the outputs."""
        works, input_grad = self._to_inputs
        for work in works:
            work()
        return input_grad

    @cached_property
    def _up(self) -> list[Work]:
        net, h = self._net, self.inputs
        works: list[Work] = []
        for layer, out in enumerate(self._memory.hidden):
            weight, bias = net.factors[layer], net.weights[2 * layer + 1]
            if weight.dtype != bias.dtype:
                works.append(convert(net.weights[2 * layer], weight))
            product = out if out.dtype == weight.dtype else self._memory.spare(weight.dtype, layer)
            works.append(bind(h, weight, product))
            if net.normalised:
                works.append(normalise(net.activation, product, bias, out, self._memory.normal[layer]))
            else:
                works.append(activate(net.activation, product, bias, out))
            h = out
        works.append(bind(_t(net.weights[-2]), _t(h), self.outputs))
        works.append(add_to_rows(self.outputs, _t(net.weights[-1])))
        return fuse(works)

    @cached_property
    def _to_params(self) -> list[Work]:
        net, below = self._net, [self.inputs, *self._memory.hidden]
        works = [bind(self.grad, below[-1], _t(net.grads[-2])), sum_rows(self.grad, _t(net.grads[-1]))]
        for layer, down, delta in self._descent(net.grads[1::2]):
            grads = net.grads[2 * layer]
            product = grads if delta.dtype == grads.dtype else torch.empty_like(grads, dtype=delta.dtype)
            works += [*down, bind(_t(below[layer]), delta, product)]
            if product is not grads:
                works.append(convert(product, grads))
        return fuse(works)

    @cached_property
    def _to_inputs(self) -> tuple[list[Work], Tensor]:
        works: list[Work] = []
        delta = _t(self.grad)
        for _, down, below in self._descent():
            works, delta = works + down, below
        out = torch.empty(len(delta), self._weight.shape[1], delta.shape[1], device=delta.device)
        return fuse([*works, bind(self._weight, _t(delta), out)]), out

    def _descent(self, totals: Sequence[Tensor] | None = None) -> Iterator[tuple[int, list[Work], Tensor]]:
        """For each hidden layer from the top, how to get the gradient in its product, and where that is put; its sums
        over rows go to the layer's place in `totals`.
        """
        net, memory, grad = self._net, self._memory, _t(self.grad)
        for layer in reversed(range(len(memory.hidden))):
            above = net.factors[layer + 1]
            product = memory.spare(above.dtype, layer)
            delta = memory.spare(net.factors[layer].dtype, layer)
            total = totals[layer] if totals is not None else None
            if net.normalised:
                down = undo_norm(net.activation, product, memory.normal[layer], delta, total)
            else:
                down = undo(net.activation, product, memory.hidden[layer], delta, total)
            yield layer, [bind(grad, _t(above), product), down], delta
            grad = delta


class StackedMLP:
    """`members` MLPs `inputs -> hidden (x layers) -> outputs`, without a non-linearity at the end.

    Args:
        members: networks in the stack, N.
        generator: where the initial weights are drawn from, each member as a network of its own; None leaves them zero,
            for a stack that is about to be loaded or copied into. It may be of another device.
        activation: of the hidden layers; leaky_relu has slope 0.01.
        init: `orthogonal` with gain 1 and zero biases (B-Pref's agent), or `torch`, `nn.Linear`'s own (its reward).
        precision: of the products between hidden layers, see `rrm.nets.precision`.
        normalised: every hidden layer is normalised before its activation (Ba et al. 2016), without gain and shift
            of its own: the next layer has both.
        device: where the parameters live.
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
        normalised: bool = False,
        device: torch.device | str = "cpu",
    ) -> None:
        self.members = members
        self.normalised = normalised
        self.widths = (inputs, *[hidden] * layers, outputs)
        self.activation = activation
        self.init = init
        #: Precision in which hidden layers are multiplied with each other.
        self.inner = torch.bfloat16 if precision == "bfloat16" and layers > 1 else torch.float32
        shapes = [(members, *s) for i, o in pairwise(self.widths) for s in ((i, o), (1, o))]
        shapes[-2] = (members, outputs, self.widths[-2])  # the last weight is stored transposed, see `Pass`
        parameters = Parameters(shapes, device)
        self.flat = parameters.flat  #: all parameters; the padding between them stays zero
        self.flat_grad = parameters.flat_grad  #: their gradients, filled by `backward_params`
        self.weights = parameters.values  #: and biases: `[W0, b0, W1, b1, ...]`, W [N, in, out], b [N, 1, out]
        self.grads = parameters.grads  #: views in the order and shapes of `parameters()`
        for views in (self.weights, self.grads):
            views[-2] = _t(views[-2])
        self._spares: dict[torch.Size, Pass] = {}
        #: What the inputs of each layer are multiplied with: its weights, rounded between hidden layers.
        self.factors = [
            torch.empty_like(w, dtype=self.inner) if 0 < layer < layers else w
            for layer, w in enumerate(self.weights[::2])
        ]
        if self.inner == torch.float32:
            self.factors = self.weights[::2]
        self._leaves = [p.detach().requires_grad_() for p in self.weights]
        if generator is not None:
            self.initialise(generator)

    def initialise(self, generator: torch.Generator) -> None:
        """Draw fresh weights in place."""
        for member in range(self.members):
            for weight, bias in zip(self.weights[::2], self.weights[1::2], strict=True):
                fan_in, fan_out = weight.shape[1:]
                drawn = torch.empty(fan_out, fan_in, device=generator.device)
                if self.init == "orthogonal":
                    nn.init.orthogonal_(drawn, generator=generator)
                    bias[member].zero_()
                else:
                    bound = 1 / math.sqrt(fan_in)
                    drawn.uniform_(-bound, bound, generator=generator)
                    shifts = torch.empty(fan_out, device=generator.device)
                    bias[member].copy_(shifts.uniform_(-bound, bound, generator=generator))
                weight[member].copy_(drawn.t())

    def take(self, shape: torch.Size) -> Pass:
        """A pass for inputs of this shape, the one given back last where there is one: fresh memory costs as much as a
        layer.
        """
        spare = self._spares.pop(shape, None)
        return spare or Pass(self, torch.empty(shape, device=self.flat.device))

    def give_back(self, done: Pass) -> None:
        """Let the next call of this shape have this pass."""
        self._spares[done.given.shape] = done
        while len(self._spares) > _SPARES:
            del self._spares[next(iter(self._spares))]

    def parameters(self) -> list[Tensor]:
        """Leaves for autograd that share memory with `flat`: `[W0, b0, W1, b1, ...]`, W [N, in, out], b [N, 1, out]."""
        return self._leaves

    def __call__(self, x: Tensor) -> Tensor:
        """Outputs float32 [N, out, B] of x, [B, in] or [N, B, in]; differentiable in `parameters()`, not in x."""
        if not torch.is_grad_enabled():
            return torch.cat([self._outputs(rows) for rows in torch.split(x, _AT_ONCE[x.device.type], dim=-2)], dim=-1)
        return _WrittenOut.apply(self, x, *self._leaves)  # type: ignore[no-any-return, no-untyped-call]

    def _outputs(self, x: Tensor) -> Tensor:
        here = self.take(x.shape)
        outputs = here(x).clone()
        self.give_back(here)
        return outputs

    def plain(self, x: Tensor, params: Sequence[Tensor] | None = None) -> Tensor:
        """The same outputs, differentiable in everything and any number of times, in float32.

        `params` stand in for the stack's own, in the order and shapes of `parameters()`.
        """
        params = self._leaves if params is None else params
        h = x.expand(self.members, -1, -1)
        for weight, bias in zip(params[:-2:2], params[1:-2:2], strict=True):
            h = torch.baddbmm(bias, h, weight)
            if self.normalised:
                h = nn.functional.layer_norm(h, h.shape[-1:], eps=EPSILON)
            h = torch.relu_(h) if self.activation == "relu" else nn.functional.leaky_relu_(h, LEAK)
        return torch.baddbmm(_t(params[-1]), _t(params[-2]), _t(h))


class _WrittenOut(torch.autograd.Function):
    """`forward` and `backward_params` of a pass as one differentiable operation."""

    @staticmethod
    def forward(ctx: Any, net: StackedMLP, x: Tensor, *leaves: Tensor) -> Tensor:
        ctx.net, ctx.here = net, net.take(x.shape)
        ctx.save_for_backward(*leaves)  # autograd refuses a backward pass after they were changed
        return ctx.here(x).clone()  # type: ignore[no-any-return]

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        _ = ctx.saved_tensors
        ctx.here.grad.copy_(grad)
        ctx.here.backward_params()
        ctx.net.give_back(ctx.here)
        return None, None, *(window.clone() for window in ctx.net.grads)


def _t(stack: Tensor) -> Tensor:
    return stack.transpose(1, 2)
