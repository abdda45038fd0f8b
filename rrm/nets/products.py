"""Matrix products of networks: each goes the way that is the quickest on this machine for its form and size.

A choice is a property of the machine (`rrm.tuning` measures it once) and recorded with every run, which keeps it
when it is resumed: another way adds the same numbers up in another order.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar, Token

import torch
from torch import Tensor

from rrm.nets.program import Work, times_vectors
from rrm.nets.ways import WAYS, Way, by_torch, fits
from rrm.tuning import OTHERWISE, Choice, Form, Shape, cell, machine, nearest

_CHOICE: ContextVar[Choice | None] = ContextVar("choice", default=None)


def choice() -> Choice:
    """What products made from now on go by: what `use` was given, else this machine's, which may be measured now."""
    return _CHOICE.get() or machine().choice


def use(chosen: Choice | None) -> Token[Choice | None]:
    """Make products by this choice from now on; None: by the machine's own.

    Raises KeyError where a way is none of `WAYS`.
    """
    for way in (chosen or {}).values():
        WAYS[way]
    return _CHOICE.set(chosen)


@contextmanager
def using(chosen: Choice) -> Iterator[None]:
    """`use` for the length of a block."""
    before = use(chosen)
    try:
        yield
    finally:
        _CHOICE.reset(before)


def bind(a: Tensor, b: Tensor, out: Tensor) -> Work:
    """A function that writes the product of two stacks of matrices, [N, M, K] and [N, K, L], to `out`, [N, M, L].

    The tensors are read and written where they lie now, every time it is called; they are float32, or all bfloat16.
    """
    if _by_torch(a, b, out):
        return by_torch(a, b, out)
    if out.stride(2) != 1 and out.shape[2] > 1:  # its transpose lies in rows
        return bind(b.transpose(1, 2), a.transpose(1, 2), out.transpose(1, 2))
    if b.shape[2] == 1:
        return times_vectors(a, b[..., 0], out[..., 0])
    if a.shape[1] == 1:
        return times_vectors(b.transpose(1, 2), a[:, 0], out[:, 0])
    return _way(a, b)(a, b, out)


def _by_torch(*matrices: Tensor) -> bool:
    """Whether this is torch's alone: another device or precision, several threads, a stride that others do not know."""
    plain = all(m.device.type == "cpu" and m.dtype == torch.float32 for m in matrices)
    return not plain or torch.get_num_threads() > 1 or not fits(*matrices)


def _way(a: Tensor, b: Tensor) -> Way:
    chosen, (form, shape) = choice(), _form(a, b)
    return WAYS[chosen.get(cell(form, nearest(shape)), chosen[OTHERWISE])]


def _form(a: Tensor, b: Tensor) -> tuple[Form, Shape]:
    """Which of a layer's products this is by how its factors lie, and of which layer."""
    rows, inner, columns = *a.shape[1:], b.shape[2]
    if a.stride(2) != 1 and inner > 1:
        return "weights", (inner, rows, columns)
    if b.stride(2) != 1 and columns > 1:
        return "inputs", (rows, columns, inner)
    return "forward", (rows, inner, columns)
