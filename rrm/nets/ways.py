"""The ways to a matrix product in float32 on a processor: all compute the same sums, in another order and at another pace.

torch hands its products to MKL, which keeps its quickest kernels for Intel's processors: on others they run at half the
rate. The same kernels answer to their own names (`mkl-avx512`, `mkl-avx2`); oneDNN and numpy's BLAS have theirs. None is
the quickest everywhere, so `rrm.nets.tuning` measures them and `rrm.nets.products` takes the quickest.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from rrm.nets.precision import Multiplying
from rrm.precision import extensions

if TYPE_CHECKING:
    from collections.abc import Mapping

Work = Callable[[], object]  #: writes one product to where it belongs


def by_torch(a: Tensor, b: Tensor, out: Tensor) -> Work:
    """`torch.bmm`, on any device and in any precision that torch has."""
    return partial(torch.bmm, a, b, out=out)


def by_onednn(a: Tensor, b: Tensor, out: Tensor) -> Work:
    """oneDNN, by way of torch's setting that also permits rounding: exact only where the processor cannot round."""
    setting = Multiplying("bfloat16")

    def work() -> None:
        with setting:
            torch.bmm(a, b, out=out)

    return work


def by_numpy(a: Tensor, b: Tensor, out: Tensor) -> Work:
    """The BLAS that numpy brings."""
    return partial(np.matmul, a.numpy(), b.numpy(), out=out.numpy())


class MklKernel:
    """One of MKL's own kernels inside torch, past the choice by the maker's name of the processor.

    The symbol is exported but not documented: it is used only after a process of its own has tried it (`rrm.nets.tuning`).
    """

    def __init__(self, symbol: str, needs: frozenset[str]) -> None:
        self._symbol = symbol
        self._needs = needs

    def there(self) -> bool:
        """Whether the processor and this torch have it."""
        return self._needs <= extensions() and _torch_library() is not None and hasattr(_torch_library(), self._symbol)

    def __call__(self, a: Tensor, b: Tensor, out: Tensor) -> Work:
        kernel = getattr(_torch_library(), self._symbol)
        # The kernel counts by columns, so a row-major `out` is to it the transposed product, b' a'.
        (trans_a, step_a), (trans_b, step_b) = _layout(a), _layout(b)
        rows, inner, columns = *a.shape[1:], b.shape[2]
        sizes = [ctypes.byref(ctypes.c_int64(size)) for size in (columns, rows, inner, step_b, step_a, _layout(out)[1])]
        one, zero = ctypes.byref(ctypes.c_float(1)), ctypes.byref(ctypes.c_float(0))
        calls = [
            (
                ctypes.c_char_p(trans_b), ctypes.c_char_p(trans_a), *sizes[:3], one,
                ctypes.c_void_p(b_one.data_ptr()), sizes[3], ctypes.c_void_p(a_one.data_ptr()), sizes[4], zero,
                ctypes.c_void_p(out_one.data_ptr()), sizes[5],
            )
            for a_one, b_one, out_one in zip(a, b, out, strict=True)
        ]  # fmt: skip
        kept = a, b, out  # the addresses are theirs

        if len(calls) == 1:
            return partial(_call_one, kernel, calls[0], kept)
        return partial(_call_all, kernel, calls, kept)


def _call_one(kernel: Callable[..., object], call: tuple[object, ...], _kept: object) -> None:
    kernel(*call)


def _call_all(kernel: Callable[..., object], calls: list[tuple[object, ...]], _kept: object) -> None:
    for call in calls:
        kernel(*call)


def _layout(matrix: Tensor) -> tuple[bytes, int]:
    """Whether a matrix of a stack lies transposed (T) or not (N), and the distance between its rows in memory."""
    rows, columns = matrix.shape[1:]
    along_rows, along_columns = matrix.stride()[1:]
    if along_columns == 1 or columns == 1 and along_rows != 1:
        return b"N", max(along_rows, columns)
    return b"T", max(along_columns, rows)


@cache
def _torch_library() -> ctypes.CDLL | None:
    """torch's library for processors, which the process has loaded already; None where it is packed another way."""
    path = Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"
    try:
        library = ctypes.CDLL(str(path))
    except OSError:
        return None
    return library


_AVX512 = frozenset({"avx512f", "avx512bw", "avx512dq", "avx512vl", "avx512cd"})

#: By the name that is recorded. Those that a symbol of another library stands behind come last.
WAYS: Mapping[str, Callable[[Tensor, Tensor, Tensor], Work]] = {
    "torch": by_torch,
    "onednn": by_onednn,
    "numpy": by_numpy,
    "mkl-avx512": MklKernel("mkl_blas_avx512_xsgemm", _AVX512),
    "mkl-avx2": MklKernel("mkl_blas_avx2_xsgemm", frozenset({"avx2", "fma"})),
}


def fits(*matrices: Tensor) -> bool:
    """Whether the rows or the columns of every matrix lie together, as all ways but torch's want them."""
    return all(1 in matrix.stride()[1:] for matrix in matrices)
