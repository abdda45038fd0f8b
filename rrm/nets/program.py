"""What happens to fixed memory between and in products, as one compiled call for many steps.

At a laptop's sizes a step takes a microsecond, and asking torch for it takes three. A `Coded` work is rows of numbers,
an operation and its addresses; works that follow each other are joined by `fuse` and run without Python in between.
On other devices than a processor the same works are torch's operations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import groupby
from typing import Any, Literal, TypeVar

import numba
import numpy as np
import torch
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic
from torch import Tensor, nn

Work = Callable[[], object]
Activation = Literal["relu", "leaky_relu"]

LEAK = 0.01  #: slope of leaky_relu below zero
_SLOPE = np.float32(LEAK)

#: Operations; what follows each in its row is for the function of its name below.
CALL, ADD_RELU, ADD_LEAKY_RELU, UNDO_RELU, UNDO_LEAKY_RELU, ADD_TO_ROWS, SUM_ROWS, ADAM = range(8)
_ADD = {"relu": ADD_RELU, "leaky_relu": ADD_LEAKY_RELU}
_UNDO = {"relu": UNDO_RELU, "leaky_relu": UNDO_LEAKY_RELU}
_LENGTH = 8

_relu_backward = torch.ops.aten.threshold_backward.grad_input
_leaky_relu_backward = torch.ops.aten.leaky_relu_backward.grad_input

_F = TypeVar("_F", bound=Callable[..., Any])


class Coded:
    """Operations on memory that stays where it is."""

    def __init__(self, rows: Sequence[Sequence[int]], kept: object) -> None:
        """Args: rows: operations with their arguments, in order; kept: what must live as long as their addresses."""
        self.rows = np.array([[*row, *[0] * (_LENGTH - len(row))] for row in rows], np.int64).reshape(-1, _LENGTH)
        self.kept = kept

    def __call__(self) -> None:
        _run(self.rows)


def fuse(works: Iterable[Work]) -> list[Work]:
    """The same works in their order, coded ones that follow each other joined."""
    fused: list[Work] = []
    for coded, group in groupby(works, lambda work: isinstance(work, Coded)):
        members = [*group]
        if coded:
            rows = [row for work in members for row in work.rows.tolist()]  # type: ignore[attr-defined]
            members = [Coded(rows, members)]
        fused += members
    return fused


def activate(activation: Activation, out: Tensor, bias: Tensor) -> Work:
    """`out` [N, B, H] becomes the activation of `out` plus `bias` [N, 1, H]."""
    if out.device.type == "cpu":
        return Coded([(_ADD[activation], *_at(o), *_at(b)[:1]) for o, b in zip(out, bias, strict=True)], (out, bias))
    function = nn.functional.relu_ if activation == "relu" else partial(nn.functional.leaky_relu_, negative_slope=LEAK)
    return lambda: function(out.add_(bias))


def undo(activation: Activation, delta: Tensor, activated: Tensor, total: Tensor | None = None) -> Work:
    """`delta` [N, B, H], a gradient in what an activation left, becomes that in what it was given; its sum over
    rows goes to `total` [N, 1, H].

    Both activations keep the sign of their input, so that what they left tells on which side of zero it was.
    """
    if delta.device.type == "cpu":
        totals = [0] * len(delta) if total is None else [one.data_ptr() for one in total]
        rows = [
            (_UNDO[activation], *_at(d), *_at(a)[::3], to) for d, a, to in zip(delta, activated, totals, strict=True)
        ]
        return Coded(rows, (delta, activated, total))

    def work() -> None:
        if activation == "relu":
            _relu_backward(delta, activated, 0, grad_input=delta)
        else:
            _leaky_relu_backward(delta, activated, LEAK, True, grad_input=delta)
        if total is not None:
            torch.sum(delta, 1, keepdim=True, out=total)

    return work


def add_to_rows(out: Tensor, bias: Tensor) -> Work:
    """`bias` [N, O, 1] is added to `out` [N, O, B]."""
    if out.device.type == "cpu":
        return Coded([(ADD_TO_ROWS, *_at(o), *_at(b)[::3]) for o, b in zip(out, bias, strict=True)], (out, bias))
    return partial(out.add_, bias)


def sum_rows(rows: Tensor, out: Tensor) -> Work:
    """The sums over the last dimension of `rows` [N, O, B] go to `out` [N, O, 1]."""
    if out.device.type == "cpu":
        return Coded([(SUM_ROWS, *_at(r), *_at(o)[::3]) for r, o in zip(rows, out, strict=True)], (rows, out))
    return partial(torch.sum, rows, 2, keepdim=True, out=out)


def _at(matrix: Tensor) -> tuple[int, int, int, int]:
    """Address, rows, columns and distance of rows of a matrix that lies in rows."""
    assert matrix.dtype == torch.float32
    assert matrix.stride(1) == 1 or matrix.shape[1] == 1
    return matrix.data_ptr(), *matrix.shape, max(matrix.stride(0), 1)


def _compiled(function: _F) -> _F:
    """The function for the processor at hand, kept on disk where there is a place for it."""
    try:
        made: _F = numba.njit(cache=True, error_model="numpy")(function)
    except RuntimeError:  # neither the package's folder nor the user's cache can be written
        made = numba.njit(error_model="numpy")(function)
    return made


# What follows is compiled; the arguments are the numbers of a row, of which the type checker knows nothing.


@intrinsic  # type: ignore[untyped-decorator]
def _pointer(_context: Any, _address: Any) -> Any:
    """A pointer to float32 of an address."""

    def make(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.CPointer(types.float32)(types.int64), make


@intrinsic  # type: ignore[untyped-decorator]
def _call(_context: Any, _function: Any, _arguments: Any) -> Any:
    """Call the function at an address with the 13 pointers that lie at another."""

    def make(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        function = builder.inttoptr(arguments[0], ir.FunctionType(ir.VoidType(), [pointer] * 13).as_pointer())
        places = builder.inttoptr(arguments[1], pointer.as_pointer())
        index = ir.IntType(64)
        builder.call(function, [builder.load(builder.gep(places, [ir.Constant(index, i)])) for i in range(13)])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64), make


@_compiled
def _floats(address: Any, rows: Any, step: Any) -> Any:
    return carray(_pointer(address), (rows, step))


@_compiled
def _add_relu(p: Any) -> None:
    y, bias = _floats(p[1], p[2], p[4]), _floats(p[5], 1, p[3])
    for r in range(p[2]):
        for c in range(p[3]):
            value = y[r, c] + bias[0, c]
            y[r, c] = np.float32(0) if value <= 0 else value  # what is not a number stays so


@_compiled
def _add_leaky_relu(p: Any) -> None:
    y, bias = _floats(p[1], p[2], p[4]), _floats(p[5], 1, p[3])
    for r in range(p[2]):
        for c in range(p[3]):
            value = y[r, c] + bias[0, c]
            y[r, c] = value if value > 0 else value * _SLOPE


@_compiled
def _undo(p: Any, slope: Any) -> None:
    delta, activated = _floats(p[1], p[2], p[4]), _floats(p[5], p[2], p[6])
    for r in range(p[2]):
        for c in range(p[3]):
            delta[r, c] = _descended(delta[r, c], activated[r, c], slope)


@_compiled
def _undo_and_sum(p: Any, slope: Any) -> None:
    delta, activated, sums = _floats(p[1], p[2], p[4]), _floats(p[5], p[2], p[6]), _floats(p[7], 1, p[3])
    sums[:] = 0
    for r in range(p[2]):
        for c in range(p[3]):
            value = _descended(delta[r, c], activated[r, c], slope)
            delta[r, c] = value
            sums[0, c] += value


@_compiled
def _descended(gradient: Any, activated: Any, slope: Any) -> Any:
    if activated <= 0:
        return gradient * slope if slope else np.float32(0)
    return gradient


@_compiled
def _add_to_rows(p: Any) -> None:
    y, bias = _floats(p[1], p[2], p[4]), _floats(p[5], p[2], p[6])
    for r in range(p[2]):
        for c in range(p[3]):
            y[r, c] += bias[r, 0]


@_compiled
def _sum_rows(p: Any) -> None:
    x, sums = _floats(p[1], p[2], p[4]), _floats(p[5], p[2], p[6])
    for r in range(p[2]):
        total = np.float32(0)
        for c in range(p[3]):
            total += x[r, c]
        sums[r, 0] = total


@_compiled
def _adam(p: Any) -> None:
    count, factors = p[5], _floats(p[6], 1, 2)
    param, grad, mean, square = (
        _floats(p[1], 1, count),
        _floats(p[2], 1, count),
        _floats(p[3], 1, count),
        _floats(p[4], 1, count),
    )
    size, root = factors[0, 0], factors[0, 1]
    for i in range(count):
        g = grad[0, i]
        mean[0, i] += np.float32(0.1) * (g - mean[0, i])
        square[0, i] = np.float32(0.999) * square[0, i] + np.float32(0.001) * g * g
        param[0, i] -= size * mean[0, i] / (np.sqrt(square[0, i]) * root + np.float32(1e-8))


@_compiled
def _run(program: Any) -> None:
    for p in program:
        if p[0] == CALL:
            _call(p[1], p[2])
        elif p[0] == ADD_RELU:
            _add_relu(p)
        elif p[0] == ADD_LEAKY_RELU:
            _add_leaky_relu(p)
        elif p[0] == UNDO_RELU or p[0] == UNDO_LEAKY_RELU:
            slope = np.float32(0) if p[0] == UNDO_RELU else _SLOPE
            if p[7]:
                _undo_and_sum(p, slope)
            else:
                _undo(p, slope)
        elif p[0] == ADD_TO_ROWS:
            _add_to_rows(p)
        elif p[0] == SUM_ROWS:
            _sum_rows(p)
        elif p[0] == ADAM:
            _adam(p)
