"""In which arithmetic networks multiply.

With `bfloat16` everything stays stored in float32; the two factors of a product between hidden layers are rounded to
bfloat16 (8 bits of mantissa) inside the product, and its sums are taken in float32. First and last layers, where the
rounding would touch observations, actions and values directly and where there is little to gain, multiply in float32.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from rrm.errors import ConfigError

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


def rounds(precision: Precision) -> bool:
    """Whether products inside `Multiplying(precision)` round their factors to bfloat16 on this machine."""
    value = 1 + 2.0**-12  # rounds to 1 in bfloat16, and to itself in float32
    factors = torch.full((2, 64, 64), value)
    with Multiplying(precision):
        product = torch.bmm(factors, factors)
    return bool((product == 64).all())


def check_precision(precision: Precision) -> None:
    """Refuse a precision that this machine would silently not use: bfloat16, where torch multiplies in float32."""
    if precision == "bfloat16" and not rounds(precision):
        raise ConfigError(
            "precision: this processor has no bfloat16 products that torch would use (x86 needs AMX); "
            'use precision = "float32", or "auto" to take what the machine has'
        )
