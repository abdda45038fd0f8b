"""The operations that `rrm.nets.program` joins, compiled by numba: each is given a row of addresses and sizes.

Matrices lie in rows and are of float32 or bfloat16, of which numba knows the bits alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic

LEAK = 0.01  #: slope of leaky_relu below zero
EPSILON = 1e-5  #: added to the variance of what is normalised
_FLAT, _LEAK = np.float32(0), np.float32(LEAK)

#: Operations; what follows each in its row is for the function of its name below.
CALL, ACTIVATE, UNDO, NORMALISE, UNDO_NORM, CONVERT, ADD_TO_ROWS, SUM_ROWS, DOT, MIX, ADAM = range(11)
LENGTH = 12  #: of a row

#: The last number of some: a matrix of float32 or of bfloat16 changed in place; float32 read and bfloat16 written
#: elsewhere, or the other way round. With LEAKY for an activation that is.
WIDE, NARROW, NARROWING, WIDENING, LEAKY = range(5)

_F = TypeVar("_F", bound=Callable[..., Any])


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


@intrinsic  # type: ignore[untyped-decorator]
def _bytes_at(_context: Any, _address: Any) -> Any:
    """A pointer to bytes of an address."""
    return types.CPointer(types.uint8)(types.int64), _to_pointer


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
    address, rows, columns, step, target, apart, kind = p[1], p[2], p[3], p[4], p[6], p[7], p[8] & 3
    bias = _floats(p[5], 1, columns)
    if kind == WIDE:
        _activate_here(_floats(address, rows, step), rows, columns, bias, slope)
    elif kind == NARROW:
        _activate_here(_halves(address, rows, step), rows, columns, bias, slope)
    elif kind == NARROWING:
        _activate_into(_floats(address, rows, step), rows, columns, bias, _halves(target, rows, apart), slope)
    elif kind == WIDENING:
        _activate_into(_halves(address, rows, step), rows, columns, bias, _floats(target, rows, apart), slope)


@_compiled
def _undo_here(x: Any, rows: Any, columns: Any, activated: Any, slope: Any, sums: Any) -> None:
    sums[:] = 0
    for r in range(rows):
        for c in range(columns):
            value = _descended(_wide(x[r, c]), _wide(activated[r, c]), slope)
            x[r, c] = _like(value, x[r, c])
            sums[0, c] += value


@_compiled
def _undo_into(x: Any, rows: Any, columns: Any, activated: Any, y: Any, slope: Any, sums: Any) -> None:
    sums[:] = 0
    for r in range(rows):
        for c in range(columns):
            value = _descended(_wide(x[r, c]), _wide(activated[r, c]), slope)
            y[r, c] = _like(value, y[r, c])
            sums[0, c] += value


@_compiled
def _undo(p: Any, slope: Any) -> None:
    address, rows, columns, step, activated, away, target, apart = p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]
    sums, kind = _floats(p[9], 1, columns), p[10] & 3
    if kind in (WIDE, NARROWING):
        x, a = _floats(address, rows, step), _floats(activated, rows, away)
        if kind == WIDE:
            _undo_here(x, rows, columns, a, slope, sums)
        else:
            _undo_into(x, rows, columns, a, _halves(target, rows, apart), slope, sums)
    else:
        u, b = _halves(address, rows, step), _halves(activated, rows, away)
        if kind == NARROW:
            _undo_here(u, rows, columns, b, slope, sums)
        else:
            _undo_into(u, rows, columns, b, _floats(target, rows, apart), slope, sums)


@_compiled
def _normalise_into(x: Any, rows: Any, columns: Any, bias: Any, y: Any, normal: Any, factor: Any, slope: Any) -> None:
    for r in range(rows):
        total = np.float32(0)
        for c in range(columns):
            total += _wide(x[r, c]) + bias[0, c]
        mean, square = total / np.float32(columns), np.float32(0)
        for c in range(columns):
            apart = _wide(x[r, c]) + bias[0, c] - mean
            normal[r, c] = apart
            square += apart * apart
        factor[0, r] = np.float32(1) / np.sqrt(square / np.float32(columns) + np.float32(EPSILON))
        for c in range(columns):
            normal[r, c] *= factor[0, r]
        for c in range(columns):
            y[r, c] = _like(_lifted(normal[r, c], slope), y[r, c])


@_compiled
def _normalise(p: Any, slope: Any) -> None:
    address, rows, columns, step, target, apart, kind = p[1], p[2], p[3], p[4], p[6], p[7], p[11] & 3
    bias, normal, factor = _floats(p[5], 1, columns), _floats(p[8], rows, p[9]), _floats(p[10], 1, rows)
    if kind == WIDE:
        here = _floats(address, rows, step)
        _normalise_into(here, rows, columns, bias, here, normal, factor, slope)
    elif kind == NARROW:
        small = _halves(address, rows, step)
        _normalise_into(small, rows, columns, bias, small, normal, factor, slope)
    elif kind == NARROWING:
        x, u = _floats(address, rows, step), _halves(target, rows, apart)
        _normalise_into(x, rows, columns, bias, u, normal, factor, slope)
    elif kind == WIDENING:
        v, y = _halves(address, rows, step), _floats(target, rows, apart)
        _normalise_into(v, rows, columns, bias, y, normal, factor, slope)


@_compiled
def _undo_norm_into(x: Any, rows: Any, columns: Any, normal: Any, factor: Any, y: Any, slope: Any, sums: Any) -> None:
    sums[:] = 0
    row = np.empty(columns, np.float32)
    for r in range(rows):
        total, along = np.float32(0), np.float32(0)
        for c in range(columns):
            row[c] = _descended(_wide(x[r, c]), normal[r, c], slope)
            total += row[c]
            along += row[c] * normal[r, c]
        total /= np.float32(columns)
        along /= np.float32(columns)
        for c in range(columns):
            row[c] = factor[0, r] * (row[c] - total - along * normal[r, c])
            sums[0, c] += row[c]
        for c in range(columns):
            y[r, c] = _like(row[c], y[r, c])


@_compiled
def _undo_norm(p: Any, slope: Any) -> None:
    address, rows, columns, step, target, apart, kind = p[1], p[2], p[3], p[4], p[7], p[8], p[11] & 3
    normal, sums, factor = _floats(p[5], rows, p[6]), _floats(p[9], 1, columns), _floats(p[10], 1, rows)
    if kind in (WIDE, NARROWING):
        x = _floats(address, rows, step)
        if kind == WIDE:
            _undo_norm_into(x, rows, columns, normal, factor, x, slope, sums)
        else:
            _undo_norm_into(x, rows, columns, normal, factor, _halves(target, rows, apart), slope, sums)
    else:
        u = _halves(address, rows, step)
        if kind == NARROW:
            _undo_norm_into(u, rows, columns, normal, factor, u, slope, sums)
        else:
            _undo_norm_into(u, rows, columns, normal, factor, _floats(target, rows, apart), slope, sums)


@_compiled
def _copy(x: Any, rows: Any, columns: Any, y: Any) -> None:
    for r in range(rows):
        for c in range(columns):
            y[r, c] = _like(_wide(x[r, c]), y[r, c])


@_compiled
def _convert(p: Any) -> None:
    rows, columns, step, apart = p[2], p[3], p[4], p[6]
    if p[7] == WIDENING:
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
def _bytes(address: Any, count: Any) -> Any:
    return carray(_bytes_at(address), count)


@_compiled
def move(address: Any, apart: Any, moves: Any, out: Any, planes: Any, height: Any, width: Any) -> None:
    """Pictures [planes, height, width] of bytes, so many bytes apart, go to `out` as x - 128; see `rrm.nets.shift`."""
    for b in range(len(moves)):
        picture, down, right = address + b * apart, moves[b, 0], moves[b, 1]
        left, stop = min(max(0, -right), width), max(0, min(width, width - right))
        middle = max(0, stop - left)
        for p in range(planes):
            for y in range(height):
                start = picture + (p * height + min(max(y + down, 0), height - 1)) * width
                row, target = _bytes(start, width), _bytes(out, width)
                source, within = _bytes(start + right + left, middle), _bytes(out + left, middle)
                for x in range(middle):
                    within[x] = source[x] ^ 128
                for x in range(left):
                    target[x] = row[0] ^ 128
                for x in range(stop, width):
                    target[x] = row[width - 1] ^ 128
                out += width


@_compiled
def run(program: Any) -> None:
    """Go through the rows, int64 [steps, LENGTH]."""
    for p in program:
        if p[0] == CALL:
            _call(p[1], p[2])
        elif p[0] == ACTIVATE:
            _activate(p, _LEAK if p[8] & LEAKY else _FLAT)
        elif p[0] == UNDO:
            _undo(p, _LEAK if p[10] & LEAKY else _FLAT)
        elif p[0] == NORMALISE:
            _normalise(p, _LEAK if p[11] & LEAKY else _FLAT)
        elif p[0] == UNDO_NORM:
            _undo_norm(p, _LEAK if p[11] & LEAKY else _FLAT)
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
