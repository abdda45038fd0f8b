"""In which arithmetic networks multiply.

With `bfloat16` everything stays stored in float32; the two factors of a product between hidden layers are rounded to
bfloat16 (8 bits of mantissa) on the way in, and its sums are taken in float32. Where torch does not round by itself,
the sums are rounded once more on the way out. First and last layers, where the rounding would touch observations,
actions and values directly and where there is little to gain, multiply in float32.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import torch

from rrm.errors import ConfigError
from rrm.hardware import extensions

if TYPE_CHECKING:
    from rrm.precision import Precision

_TORCH: dict[Precision, str] = {"float32": "highest", "bfloat16": "medium"}


class Multiplying:
    """`with Multiplying("bfloat16"):` float32 products are computed so inside; torch's own setting returns after."""

    __slots__ = ("_before", "_setting")

    def __init__(self, precision: Precision) -> None:
        self._setting = _TORCH[precision]
        self._before = self._setting

    def __enter__(self) -> None:
        self._before = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision(self._setting)

    def __exit__(self, *_: object) -> None:
        torch.set_float32_matmul_precision(self._before)


@cache
def rounds(precision: Precision) -> bool:
    """Whether products inside `Multiplying(precision)` round their factors to bfloat16 on this machine."""
    value = 1 + 2.0**-12  # rounds to 1 in bfloat16, and to itself in float32
    factors = torch.full((2, 64, 64), value)
    with Multiplying(precision):
        product = torch.bmm(factors, factors)
    return bool((product == 64).all())


def multiplies(precision: Precision) -> bool:
    """Whether this machine has products of this precision: torch rounds to bfloat16 itself, or the processor multiplies
    numbers that are stored so.
    """
    return precision == "float32" or rounds(precision) or not extensions().isdisjoint(("avx512_bf16", "bf16"))


def check_precision(precision: Precision) -> None:
    """Refuse a precision that this machine does not have."""
    if not multiplies(precision):
        raise ConfigError(
            "precision: this processor has no bfloat16 products (x86 needs AMX or AVX512_BF16); "
            'use precision = "float32", or "auto" to take what is quicker on the machine'
        )
