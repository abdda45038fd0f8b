"""Matrix products of networks: each goes the way that is the quickest on this machine for its form and size.

A choice is a property of the machine (`rrm.nets.tuning` measures it once) and recorded with every run, which keeps it
when it is resumed: another way adds the same numbers up in another order.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Literal

import torch
from torch import Tensor

from rrm.nets.precision import Multiplying
from rrm.nets.ways import WAYS, Work, by_torch, fits

if TYPE_CHECKING:
    from rrm.precision import Precision

Form = Literal["forward", "weights", "inputs"]
Shape = tuple[int, int, int]  #: rows, inputs and outputs of a layer

#: Of each layer there are three: x w, x' d for the gradient in w, and d w' for that in x.
FORMS: tuple[Form, ...] = ("forward", "weights", "inputs")

#: What is measured; a product goes the way of the nearest. Acting, the laptop's sizes, the paper's, an image agent's.
SHAPES: tuple[Shape, ...] = (
    (1, 128, 128), (1, 256, 256), (128, 43, 128), (128, 128, 128), (128, 128, 8), (512, 43, 256), (512, 256, 256),
    (512, 256, 8), (2048, 44, 256), (2048, 256, 256), (2048, 256, 1), (512, 1024, 1024),
)  # fmt: skip

#: The key of the way that all products go whose own is not named.
OTHERWISE = "otherwise"

Choice = Mapping[str, str]  #: names of `WAYS` by `cell(form, shape)`, and `OTHERWISE`

TORCH: Choice = {OTHERWISE: "torch"}

_current: Choice | None = None


def cell(form: Form, shape: Shape) -> str:
    """The name under which the way of a measured product is kept, such as `weights 512x256x256`."""
    return f"{form} {'x'.join(map(str, shape))}"


def choice() -> Choice:
    """What products made from now on go by: what `use` was given, else this machine's, which may be measured now."""
    global _current
    if _current is None:
        from rrm.nets import tuning

        _current = tuning.machine().choice
    return _current


def use(chosen: Choice | None) -> None:
    """Make the products of this process by this choice; None: by the machine's own.

    Raises KeyError where a way is none of `WAYS`.
    """
    global _current
    for way in (chosen or {}).values():
        WAYS[way]
    _current = chosen
    _nearest.cache_clear()


@contextmanager
def using(chosen: Choice) -> Iterator[None]:
    """`use` for the length of a block."""
    before = _current
    use(chosen)
    try:
        yield
    finally:
        use(before)


def bind(a: Tensor, b: Tensor, out: Tensor, precision: Precision = "float32") -> Work:
    """A function that writes the product of two stacks of matrices, [N, M, K] and [N, K, L], to `out`, [N, M, L].

    The tensors are read and written where they lie now, every time it is called. They are float32; with `bfloat16`
    their numbers are rounded on the way in (`rrm.nets.precision`).
    """
    if precision == "bfloat16":
        return partial(_rounding, a, b, out)
    if out.device.type != "cpu" or torch.get_num_threads() > 1 or not fits(a, b, out):
        return by_torch(a, b, out)
    if out.stride(2) != 1 and out.shape[2] > 1:  # its transpose lies in rows
        return bind(b.transpose(1, 2), a.transpose(1, 2), out.transpose(1, 2))
    form, shape = _form(a, b)
    chosen = choice()
    return WAYS[chosen.get(_nearest(form, shape), chosen[OTHERWISE])](a, b, out)


def _rounding(a: Tensor, b: Tensor, out: Tensor) -> None:
    with Multiplying("bfloat16"):
        torch.bmm(a, b, out=out)


def _form(a: Tensor, b: Tensor) -> tuple[Form, Shape]:
    """Which of a layer's products this is by how its factors lie, and of which layer."""
    rows, inner, columns = *a.shape[1:], b.shape[2]
    if a.stride(2) != 1 and inner > 1:
        return "weights", (inner, rows, columns)
    if b.stride(2) != 1 and columns > 1:
        return "inputs", (rows, columns, inner)
    return "forward", (rows, inner, columns)


@lru_cache(maxsize=4096)
def _nearest(form: Form, shape: Shape) -> str:
    def distance(other: Shape) -> float:
        return sum(abs(math.log(mine / theirs)) for mine, theirs in zip(shape, other, strict=True))

    return cell(form, min(SHAPES, key=distance))
