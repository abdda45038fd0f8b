"""In which arithmetic networks multiply.

With `bfloat16` (8 bits of mantissa) the products between hidden layers read and write numbers of that precision; their
sums are taken in float32, and so are bias, activation and derivative before a result is rounded. Weights, gradients in
them and Adam's moments are kept in float32. First and last layers, where the rounding would touch observations, actions
and values directly and where there is little to gain, multiply in float32. Of agents that see frames it is the
convolutions and the products with their features that are rounded so, to which whole pixels are exact; what follows is
float32.

`tf32` is of graphics cards: products of all layers round what they multiply to 10 bits of mantissa, and nothing else
does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from rrm.devices import CPU, CUDA, kind_of
from rrm.errors import ConfigError
from rrm.hardware import extensions

if TYPE_CHECKING:
    from rrm.precision import Precision

#: From this compute capability on, cards multiply in other precisions.
_AMPERE = (8, 0)


def multiplies(precision: Precision) -> bool:
    """Whether this machine's processor has products of this precision."""
    return precision != "bfloat16" or not extensions().isdisjoint(("amx_bf16", "avx512_bf16", "bf16"))


def check_precision(precision: Precision, device: str = CPU) -> None:
    """Refuse a precision that this device does not have."""
    if kind_of(device) == CUDA:
        import torch

        if precision != "float32" and torch.cuda.get_device_capability(device) < _AMPERE:
            raise ConfigError(f'precision: this card has no {precision} products; use precision = "float32"')
    elif not multiplies(precision):
        raise ConfigError(
            "precision: this processor has no bfloat16 products (x86 needs AMX or AVX512_BF16); "
            'use precision = "float32", or "auto" to take what is quicker on the machine'
        )
