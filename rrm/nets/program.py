"""What happens to fixed memory between and in products, as one compiled call for many steps.

At a laptop's sizes a step takes a microsecond, and asking torch for it takes three. A `Coded` work is rows of numbers,
an operation and its addresses; works that follow each other are joined by `fuse` and run without Python in between.
On other devices than a processor the same works are torch's operations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from itertools import groupby
from typing import Literal, NamedTuple, NoReturn

import numpy as np
import torch
from torch import Tensor, nn

from rrm.nets.compiled import (
    ACTIVATE,
    ADD_TO_ROWS,
    CONVERT,
    DOT,
    EPSILON,
    LEAK,
    LEAKY,
    LENGTH,
    MIX,
    NARROW,
    NARROWING,
    NORMALISE,
    SUM_ROWS,
    UNDO,
    UNDO_NORM,
    WIDE,
    WIDENING,
    run,
)  # fmt: skip

Work = Callable[[], object]
Activation = Literal["relu", "leaky_relu"]

_SLOPES: dict[Activation, float] = {"relu": 0.0, "leaky_relu": LEAK}


class Coded:
    """Operations on memory that stays where it is."""

    def __init__(self, rows: Sequence[Sequence[int]], kept: object) -> None:
        """Args: rows: operations with their arguments, in order; kept: what must live as long as their addresses."""
        self.rows = np.array([[*row, *[0] * (LENGTH - len(row))] for row in rows], np.int64).reshape(-1, LENGTH)
        self.kept = kept

    def __call__(self) -> None:
        run(self.rows)

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


def _compiles(tensor: Tensor) -> bool:
    return tensor.device.type == "cpu"


def activate(activation: Activation, source: Tensor, bias: Tensor, target: Tensor) -> Work:
    """`target` [N, B, H] becomes the activation of `source` [N, B, H] plus `bias` [N, 1, H].

    Source and target are one where they are of one precision, float32 or bfloat16.
    """
    if _compiles(source):
        kind = _kind(source, target, activation)
        rows = [
            (ACTIVATE, *_at(x), b.data_ptr(), *_at(y)[::3], kind) for x, b, y in zip(source, bias, target, strict=True)
        ]
        return Coded(rows, (source, bias, target))
    slope = _SLOPES[activation]
    if source.dtype == target.dtype == torch.float32:
        return lambda: nn.functional.leaky_relu_(torch.add(source, bias, out=target), slope)
    return lambda: target.copy_(nn.functional.leaky_relu(source + bias, slope))


def undo(
    activation: Activation, source: Tensor, activated: Tensor, target: Tensor, total: Tensor | None = None
) -> Work:
    """From `source` [N, B, H], a gradient in what an activation left, to `target`, that in what it was given.

    Its sum over rows goes to `total` [N, 1, H]. Source and target are one where they are of one precision, and
    what was activated is of the source's. Both activations keep the sign of their input, so that what they left tells
    on which side of zero it was.
    """
    if _compiles(source):
        if total is None:  # taking sums that nobody reads costs less than code that does not
            total = torch.empty(len(source), 1, source.shape[2])
        kind = _kind(source, target, activation)
        assert activated.dtype == source.dtype
        rows = [
            (UNDO, *_at(x), *_at(a)[::3], *_at(y)[::3], to.data_ptr(), kind)
            for x, a, y, to in zip(source, activated, target, total, strict=True)
        ]
        return Coded(rows, (source, activated, target, total))

    ones = _ones(source)

    def work() -> None:
        if source.dtype == target.dtype == torch.float32:
            gradient = torch.ops.aten.leaky_relu_backward.grad_input(
                source, activated, _SLOPES[activation], True, grad_input=target
            )
        else:
            gradient = source.float()
            gradient = torch.where(activated <= 0, gradient * _SLOPES[activation], gradient)
            target.copy_(gradient)
        if total is not None:
            torch.bmm(ones, gradient, out=total)

    return work


def _ones(rows: Tensor) -> Tensor:
    """What sums rows [N, B, H] up as a product, which is quicker on a card than a sum."""
    return torch.ones(1, 1, rows.shape[1], device=rows.device).expand(len(rows), -1, -1)


class Normal(NamedTuple):
    """What layer normalisation left of a layer, before its activation."""

    rows: Tensor  #: of mean 0 and variance 1, float32 [N, B, H]
    factor: Tensor  #: what each was scaled by, float32 [N, B]


def normalise(activation: Activation, source: Tensor, bias: Tensor, target: Tensor, normal: Normal) -> Work:
    """As `activate`, each row of the sum first shifted and scaled to mean 0 and variance 1: `normal` is overwritten."""
    if _compiles(source):
        kind = _kind(source, target, activation)
        rows = [
            (NORMALISE, *_at(x), b.data_ptr(), *_at(y)[::3], *_at(n)[::3], f.data_ptr(), kind)
            for x, b, y, n, f in zip(source, bias, target, *normal, strict=True)
        ]
        return Coded(rows, (source, bias, target, normal))

    def work() -> None:
        total = source.float() + bias
        var, mean = torch.var_mean(total, -1, correction=0, keepdim=True)
        scale = torch.rsqrt(var + EPSILON)
        normal.factor.copy_(scale[..., 0])
        torch.mul(total - mean, scale, out=normal.rows)
        target.copy_(nn.functional.leaky_relu(normal.rows, _SLOPES[activation]))

    return work


def undo_norm(
    activation: Activation, source: Tensor, normal: Normal, target: Tensor, total: Tensor | None = None
) -> Work:
    """As `undo`, of what `normalise` did."""
    if _compiles(source):
        if total is None:
            total = torch.empty(len(source), 1, source.shape[2])
        kind = _kind(source, target, activation)
        rows = [
            (UNDO_NORM, *_at(x), *_at(n)[::3], *_at(y)[::3], to.data_ptr(), f.data_ptr(), kind)
            for x, n, f, y, to in zip(source, *normal, target, total, strict=True)
        ]
        return Coded(rows, (source, normal, target, total))

    ones = _ones(source)

    def work() -> None:
        gradient = source.float()
        gradient = torch.where(normal.rows <= 0, gradient * _SLOPES[activation], gradient)
        along = (gradient * normal.rows).mean(-1, keepdim=True)
        gradient = normal.factor[..., None] * (gradient - gradient.mean(-1, keepdim=True) - along * normal.rows)
        target.copy_(gradient)
        if total is not None:
            torch.bmm(ones, gradient, out=total)

    return work


def convert(source: Tensor, target: Tensor) -> Work:
    """`target` [N, I, O] becomes `source`, in its own precision."""
    if _compiles(source):
        kind = _kind(source, target)
        rows = [(CONVERT, *_at(x), *_at(y)[::3], kind) for x, y in zip(source, target, strict=True)]
        return Coded(rows, (source, target))
    return partial(target.copy_, source)


def add_to_rows(out: Tensor, bias: Tensor) -> Work:
    """`bias` [N, O, 1] is added to `out` [N, O, B]."""
    if _compiles(out):
        return Coded([(ADD_TO_ROWS, *_at(o), *_at(b)[::3]) for o, b in zip(out, bias, strict=True)], (out, bias))
    return partial(out.add_, bias)


def sum_rows(rows: Tensor, out: Tensor) -> Work:
    """The sums over the last dimension of `rows` [N, O, B] go to `out` [N, O, 1]."""
    if _compiles(out):
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
    assert narrow[0] != narrow[1] or source.data_ptr() == target.data_ptr(), "of one precision: in place"
    kind = {(False, False): WIDE, (True, True): NARROW, (False, True): NARROWING, (True, False): WIDENING}[narrow]
    return kind + (LEAKY if activation == "leaky_relu" else 0)
