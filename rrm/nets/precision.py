"""In which arithmetic networks multiply.

With `bfloat16` (8 bits of mantissa) the products between hidden layers read and write numbers of that precision; their
sums are taken in float32, and so are bias, activation and derivative before a result is rounded. Weights, gradients in
them and Adam's moments are kept in float32. First and last layers, where the rounding would touch observations, actions
and values directly and where there is little to gain, multiply in float32. Of agents that see frames it is the
convolutions and the products with their features that are rounded so, to which whole pixels are exact; what follows is
float32.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rrm.errors import ConfigError
from rrm.hardware import extensions

if TYPE_CHECKING:
    from rrm.precision import Precision


def multiplies(precision: Precision) -> bool:
    """Whether this machine's processor has products of this precision."""
    return precision == "float32" or not extensions().isdisjoint(("amx_bf16", "avx512_bf16", "bf16"))


def check_precision(precision: Precision) -> None:
    """Refuse a precision that this machine does not have."""
    if not multiplies(precision):
        raise ConfigError(
            "precision: this processor has no bfloat16 products (x86 needs AMX or AVX512_BF16); "
            'use precision = "float32", or "auto" to take what is quicker on the machine'
        )
