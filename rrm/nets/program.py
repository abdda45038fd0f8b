"""What happens to fixed memory between and in products, as one compiled call for many steps.

At a laptop's sizes a step takes a microsecond, and asking torch for it takes three. A `Coded` work is rows of numbers,
an operation and its addresses; works that follow each other are joined by `fuse` and run without Python in between.
On other devices than a processor the same works are torch's operations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import groupby
from typing import Any, Literal, NoReturn, TypeVar

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
_SLOPES: dict[Activation, float] = {"relu": 0.0, "leaky_relu": LEAK}
_FLAT, _LEAK = np.float32(0), np.float32(LEAK)

#: Operations; what follows each in its row is for the function of its name below.
CALL, ACTIVATE, UNDO, CONVERT, ADD_TO_ROWS, SUM_ROWS, DOT, MIX, ADAM = range(9)
_LENGTH = 11

#: What a matrix of bfloat16 adds to the last number of a row: that is read from, that is written to.
_NARROW_SOURCE, _NARROW_TARGET, _ELSEWHERE, _LEAKY = 1, 2, 4, 8

_F = TypeVar("_F", bound=Callable[..., Any])


class Coded:
    """Operations on memory that stays where it is."""

    def __init__(self, rows: Sequence[Sequence[int]], kept: object) -> None:
        """Args: rows: operations with their arguments, in order; kept: what must live as long as their addresses."""
        self.rows = np.array([[*row, *[0] * (_LENGTH - len(row))] for row in rows], np.int64).reshape(-1, _LENGTH)
        self.kept = kept

    def __call__(self) -> None:
        _run(self.rows)

    def __reduce__(self) -> NoReturn:
        raise TypeError("a work is bound to its memory, and cannot be copied")


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


def activate(activation: Activation, source: Tensor, bias: Tensor, target: Tensor) -> Work:
    """`target` [N, B, H] becomes the activation of `source` [N, B, H] plus `bias` [N, 1, H].

    Source and target may be one, and either float32 or bfloat16.
    """
    if source.device.type == "cpu":
        kind = _kind(source, target, activation)
        rows = [
            (ACTIVATE, *_at(x), b.data_ptr(), *_at(y)[::3], kind) for x, b, y in zip(source, bias, target, strict=True)
        ]
        return Coded(rows, (source, bias, target))
    return lambda: target.copy_(nn.functional.leaky_relu(source + bias, _SLOPES[activation]))


def undo(
    activation: Activation, source: Tensor, activated: Tensor, target: Tensor, total: Tensor | None = None
) -> Work:
    """From `source` [N, B, H], a gradient in what an activation left, to `target`, that in what it was given.

    Its sum over rows goes to `total` [N, 1, H]. Source and target may be one; they are float32 or bfloat16. Both
    activations keep the sign of their input, so that what they left tells on which side of zero it was.
    """
    if source.device.type == "cpu":
        totals = [0] * len(source) if total is None else [one.data_ptr() for one in total]
        kind = _kind(source, target, activation)
        assert activated.dtype == (target if source is target else source if kind & _NARROW_SOURCE else activated).dtype
        rows = [
            (UNDO, *_at(x), *_at(a)[::3], *_at(y)[::3], to, kind)
            for x, a, y, to in zip(source, activated, target, totals, strict=True)
        ]
        return Coded(rows, (source, activated, target, total))

    def work() -> None:
        torch.where(activated <= 0, source * _SLOPES[activation], source, out=target)
        if total is not None:
            torch.sum(target, 1, keepdim=True, out=total)

    return work


def convert(source: Tensor, target: Tensor) -> Work:
    """`target` [N, I, O] becomes `source`, in its own precision."""
    if source.device.type == "cpu":
        kind = _kind(source, target)
        rows = [(CONVERT, *_at(x), *_at(y)[::3], kind) for x, y in zip(source, target, strict=True)]
        return Coded(rows, (source, target))
    return partial(target.copy_, source)


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


def times_vectors(matrices: Tensor, vectors: Tensor, out: Tensor) -> Work:
    """`matrices` [N, R, C] times `vectors` [N, C] go to `out` [N, R]; either may lie with any distance of its numbers.

    Libraries are slow at it, and divide it between cores as they like.
    """
    across = matrices.stride(2) == 1 or matrices.shape[2] == 1
    rows = [
        (DOT if across else MIX, *_at(m if across else m.t()), v.data_ptr(), v.stride(0), o.data_ptr(), o.stride(0))
        for m, v, o in zip(matrices, vectors, out, strict=True)
    ]
    return Coded(rows, (matrices, vectors, out))


def _at(matrix: Tensor) -> tuple[int, int, int, int]:
    """Address, rows, columns and distance of rows of a matrix that lies in rows."""
    assert matrix.stride(1) == 1 or matrix.shape[1] == 1
    return matrix.data_ptr(), *matrix.shape, max(matrix.stride(0), 1)


def _kind(source: Tensor, target: Tensor, activation: Activation = "relu") -> int:
    narrow = source.dtype == torch.bfloat16, target.dtype == torch.bfloat16
    elsewhere = source.data_ptr() != target.data_ptr()
    return sum(
        flag
        for flag, holds in (
            (_NARROW_SOURCE, narrow[0]), (_NARROW_TARGET, narrow[1]), (_ELSEWHERE, elsewhere),
            (_LEAKY, activation == "leaky_relu"),
        )
        if holds
    )  # fmt: skip


def _compiled(function: _F) -> _F:
    """The function for the processor at hand, kept on disk where there is a place for it.

    Sums may be taken in several parts, which makes them quicker and more exact; the order is always the same.
    """
    options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"reassoc", "contract"}}
    try:
        made: _F = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # neither the package's folder nor the user's cache can be written
        made = numba.njit(**options)(function)
    return made


# What follows is compiled; the arguments are the numbers of a row, of which the type checker knows nothing.


@intrinsic  # type: ignore[untyped-decorator]
def _wide_at(_context: Any, _address: Any) -> Any:
    """A pointer to float32 of an address."""
    return types.CPointer(types.float32)(types.int64), _to_pointer


@intrinsic  # type: ignore[untyped-decorator]
def _narrow_at(_context: Any, _address: Any) -> Any:
    """A pointer to bfloat16 of an address."""
    return types.CPointer(types.uint16)(types.int64), _to_pointer


def _to_pointer(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))


@intrinsic  # type: ignore[untyped-decorator]
def _wide(_context: Any, number: Any) -> Any:
    """The float32 that a number of a matrix of either precision stands for."""

    def widen(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        bits = builder.shl(builder.zext(arguments[0], ir.IntType(32)), ir.IntType(32)(16))
        return builder.bitcast(bits, ir.FloatType())

    return types.float32(number), _same if number == types.float32 else widen


@intrinsic  # type: ignore[untyped-decorator]
def _like(_context: Any, _value: Any, pattern: Any) -> Any:
    """A float32 as a matrix of numbers like the other stores it: itself, or the bits of the nearest bfloat16.

    Of two it is the even one; what is not a number stays so.
    """

    def narrow(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        whole, half = ir.IntType(32), ir.IntType(16)
        bits = builder.bitcast(arguments[0], whole)
        odd = builder.and_(builder.lshr(bits, whole(16)), whole(1))
        rounded = builder.lshr(builder.add(builder.add(bits, whole(0x7FFF)), odd), whole(16))
        is_number = builder.fcmp_ordered("ord", arguments[0], arguments[0])
        return builder.select(is_number, builder.trunc(rounded, half), half(0x7FC0))

    return pattern(types.float32, pattern), _same if pattern == types.float32 else narrow


def _same(_context: Any, _builder: Any, _signature: Any, arguments: Any) -> Any:
    return arguments[0]


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
    return carray(_wide_at(address), (rows, step))


@_compiled
def _halves(address: Any, rows: Any, step: Any) -> Any:
    return carray(_narrow_at(address), (rows, step))


@_compiled
def _lifted(value: Any, slope: Any) -> Any:
    if value <= 0:
        return value * slope if slope else np.float32(0)
    return value  # what is not a number stays so


@_compiled
def _descended(gradient: Any, activated: Any, slope: Any) -> Any:
    if activated <= 0:
        return gradient * slope if slope else np.float32(0)
    return gradient


# In place and from place to place are separate: where two matrices might be one, nothing can be done eight at a time.


@_compiled
def _activate_here(y: Any, rows: Any, columns: Any, bias: Any, slope: Any) -> None:
    for r in range(rows):
        for c in range(columns):
            y[r, c] = _like(_lifted(_wide(y[r, c]) + bias[0, c], slope), y[r, c])


@_compiled
def _activate_into(x: Any, rows: Any, columns: Any, bias: Any, y: Any, slope: Any) -> None:
    for r in range(rows):
        for c in range(columns):
            y[r, c] = _like(_lifted(_wide(x[r, c]) + bias[0, c], slope), y[r, c])


@_compiled
def _activate(p: Any, slope: Any) -> None:
    address, rows, columns, step, bias, target, apart, kind = (
        p[1],
        p[2],
        p[3],
        p[4],
        _floats(p[5], 1, p[3]),
        p[6],
        p[7],
        p[8] & 7,
    )
    if kind == 0:
        _activate_here(_floats(address, rows, step), rows, columns, bias, slope)
    elif kind == 3:
        _activate_here(_halves(address, rows, step), rows, columns, bias, slope)
    elif kind == 6:
        _activate_into(_floats(address, rows, step), rows, columns, bias, _halves(target, rows, apart), slope)
    elif kind == 5:
        _activate_into(_halves(address, rows, step), rows, columns, bias, _floats(target, rows, apart), slope)


@_compiled
def _undo_here(x: Any, rows: Any, columns: Any, activated: Any, slope: Any) -> None:
    for r in range(rows):
        for c in range(columns):
            x[r, c] = _like(_descended(_wide(x[r, c]), _wide(activated[r, c]), slope), x[r, c])


@_compiled
def _undo_here_and_sum(x: Any, rows: Any, columns: Any, activated: Any, slope: Any, sums: Any) -> None:
    sums[:] = 0
    for r in range(rows):
        for c in range(columns):
            value = _descended(_wide(x[r, c]), _wide(activated[r, c]), slope)
            x[r, c] = _like(value, x[r, c])
            sums[0, c] += value


@_compiled
def _undo_into(x: Any, rows: Any, columns: Any, activated: Any, y: Any, slope: Any) -> None:
    for r in range(rows):
        for c in range(columns):
            y[r, c] = _like(_descended(_wide(x[r, c]), _wide(activated[r, c]), slope), y[r, c])


@_compiled
def _undo_into_and_sum(x: Any, rows: Any, columns: Any, activated: Any, y: Any, slope: Any, sums: Any) -> None:
    sums[:] = 0
    for r in range(rows):
        for c in range(columns):
            value = _descended(_wide(x[r, c]), _wide(activated[r, c]), slope)
            y[r, c] = _like(value, y[r, c])
            sums[0, c] += value


@_compiled
def _undo(p: Any, slope: Any) -> None:
    address, rows, columns, step, activated, away, target, apart = p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]
    sums, kind = _floats(p[9], 1, columns), p[10] & 7
    if kind == 0:
        x, a = _floats(address, rows, step), _floats(activated, rows, away)
        if p[9]:
            _undo_here_and_sum(x, rows, columns, a, slope, sums)
        else:
            _undo_here(x, rows, columns, a, slope)
    elif kind == 3:
        u, b = _halves(address, rows, step), _halves(activated, rows, away)
        if p[9]:
            _undo_here_and_sum(u, rows, columns, b, slope, sums)
        else:
            _undo_here(u, rows, columns, b, slope)
    elif kind == 6:
        x, a, v = _floats(address, rows, step), _floats(activated, rows, away), _halves(target, rows, apart)
        if p[9]:
            _undo_into_and_sum(x, rows, columns, a, v, slope, sums)
        else:
            _undo_into(x, rows, columns, a, v, slope)
    elif kind == 5:
        u, b, y = _halves(address, rows, step), _halves(activated, rows, away), _floats(target, rows, apart)
        if p[9]:
            _undo_into_and_sum(u, rows, columns, b, y, slope, sums)
        else:
            _undo_into(u, rows, columns, b, y, slope)


@_compiled
def _copy(x: Any, rows: Any, columns: Any, y: Any) -> None:
    for r in range(rows):
        for c in range(columns):
            y[r, c] = _like(_wide(x[r, c]), y[r, c])


@_compiled
def _convert(p: Any) -> None:
    rows, columns, step, apart = p[2], p[3], p[4], p[6]
    if p[7] & 1:
        _copy(_halves(p[1], rows, step), rows, columns, _floats(p[5], rows, apart))
    else:
        _copy(_floats(p[1], rows, step), rows, columns, _halves(p[5], rows, apart))


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
def _together(address: Any, count: Any, apart: Any) -> Any:
    """A vector's numbers side by side."""
    numbers, vector = _floats(address, count, apart), np.empty(count, np.float32)
    for i in range(count):
        vector[i] = numbers[i, 0]
    return vector


@_compiled
def _dot(p: Any) -> None:
    x, vector, out = _floats(p[1], p[2], p[4]), _together(p[5], p[3], p[6]), _floats(p[7], p[2], p[8])
    for r in range(p[2]):
        total = np.float32(0)
        for c in range(p[3]):
            total += x[r, c] * vector[c]
        out[r, 0] = total


@_compiled
def _mix(p: Any) -> None:
    x, vector, out = _floats(p[1], p[2], p[4]), _together(p[5], p[2], p[6]), _floats(p[7], p[3], p[8])
    total = np.zeros(p[3], np.float32)
    for r in range(p[2]):
        weight = vector[r]
        for c in range(p[3]):
            total[c] += weight * x[r, c]
    for c in range(p[3]):
        out[c, 0] = total[c]


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
        elif p[0] == ACTIVATE:
            _activate(p, _LEAK if p[8] & _LEAKY else _FLAT)
        elif p[0] == UNDO:
            _undo(p, _LEAK if p[10] & _LEAKY else _FLAT)
        elif p[0] == CONVERT:
            _convert(p)
        elif p[0] == ADD_TO_ROWS:
            _add_to_rows(p)
        elif p[0] == SUM_ROWS:
            _sum_rows(p)
        elif p[0] == DOT:
            _dot(p)
        elif p[0] == MIX:
            _mix(p)
        elif p[0] == ADAM:
            _adam(p)
