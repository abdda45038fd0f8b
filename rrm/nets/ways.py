"""The ways to a matrix product in float32 on a processor: the same sums, in another order and at another pace.

torch hands its products to MKL, which keeps its quickest kernels for Intel's processors: on others they run at half the
rate. The same kernels answer to their own names (`mkl-avx512`, `mkl-avx2`); oneDNN and numpy's BLAS are others. None is
the quickest everywhere, so `rrm.tuning` has them measured and `rrm.nets.products` goes by that.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import CDLL, addressof, c_char, c_float, c_int64, c_void_p, cast
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from rrm.hardware import extensions
from rrm.nets.compiled import CALL
from rrm.nets.program import Coded, Work

if TYPE_CHECKING:
    from collections.abc import Mapping

Way = Callable[[Tensor, Tensor, Tensor], Work]


class _Setting:
    """How exact torch's products are inside; what the process had set returns after."""

    __slots__ = ("_before", "_exactness")

    def __init__(self, exactness: str) -> None:
        self._exactness = self._before = exactness

    def __enter__(self) -> None:
        self._before = torch.get_float32_matmul_precision()
        torch.set_float32_matmul_precision(self._exactness)

    def __exit__(self, *_: object) -> None:
        torch.set_float32_matmul_precision(self._before)


def by_torch(a: Tensor, b: Tensor, out: Tensor) -> Work:
    """`torch.bmm`, on any device and in any precision that torch has; exactly so on a processor."""
    if out.dtype == torch.float32 and out.device.type == "cpu":
        return _within(_Setting("highest"), a, b, out)
    return partial(torch.bmm, a, b, out=out)


def by_onednn(a: Tensor, b: Tensor, out: Tensor) -> Work:
    """oneDNN, by way of torch's setting that also permits rounding: exact only where the processor cannot round."""
    return _within(_Setting("medium"), a, b, out)


def _within(setting: _Setting, a: Tensor, b: Tensor, out: Tensor) -> Work:
    def work() -> None:
        with setting:
            torch.bmm(a, b, out=out)

    return work


def by_numpy(a: Tensor, b: Tensor, out: Tensor) -> Work:
    """The BLAS that numpy brings."""
    return partial(np.matmul, a.numpy(), b.numpy(), out=out.numpy())


class MklKernel:
    """One of MKL's own kernels inside torch, past the choice by the maker's name of the processor.

    The symbol is exported but not documented: it is used only after a process of its own has tried it (`rrm.tuning`).
    """

    def __init__(self, symbol: str, needs: frozenset[str]) -> None:
        self._symbol = symbol
        self._needs = needs

    def there(self) -> bool:
        """Whether the processor and this torch have it."""
        return self._needs <= extensions() and _torch_library() is not None and hasattr(_torch_library(), self._symbol)

    def __call__(self, a: Tensor, b: Tensor, out: Tensor) -> Work:
        kernel = getattr(_torch_library(), self._symbol)
        calls = [_arguments(*matrices) for matrices in zip(a, b, out, strict=True)]
        places = np.array([[addressof(of) for of in call] for call in calls], np.uint64)
        address = cast(kernel, c_void_p).value
        assert address is not None
        return Coded([(CALL, address, row.ctypes.data) for row in places], (calls, places, a, b, out))


def _arguments(a: Tensor, b: Tensor, out: Tensor) -> list[Any]:
    """As BLAS' `sgemm` takes them. It counts by columns: a row-major `out` is to it the transposed product, b' a'."""
    (trans_a, step_a), (trans_b, step_b), (_, step_out) = map(_layout, (a, b, out))

    def at(matrix: Tensor) -> c_char:
        return c_char.from_address(matrix.data_ptr())

    return [
        c_char(trans_b), c_char(trans_a), c_int64(b.shape[1]), c_int64(len(a)), c_int64(len(b)),
        c_float(1), at(b), c_int64(step_b), at(a), c_int64(step_a), c_float(0), at(out), c_int64(step_out),
    ]  # fmt: skip


def _layout(matrix: Tensor) -> tuple[bytes, int]:
    """Whether a matrix lies transposed (T) or not (N), and the distance between its rows in memory."""
    rows, columns = matrix.shape
    along_rows, along_columns = matrix.stride()
    if along_columns == 1 or columns == 1:
        return b"N", max(along_rows, columns)
    return b"T", max(along_columns, rows)


@cache
def _torch_library() -> CDLL | None:
    """Torch's library for processors, which the process has loaded already; None where it is packed another way."""
    path = Path(torch.__file__).parent / "lib" / "libtorch_cpu.so"
    try:
        library = CDLL(str(path))
    except OSError:
        return None
    return library


_AVX512 = frozenset({"avx512f", "avx512bw", "avx512dq", "avx512vl", "avx512cd"})

#: By the name that is recorded. Those that a symbol of another library stands behind come last.
WAYS: Mapping[str, Way] = {
    "torch": by_torch,
    "onednn": by_onednn,
    "numpy": by_numpy,
    "mkl-avx512": MklKernel("mkl_blas_avx512_xsgemm", _AVX512),
    "mkl-avx2": MklKernel("mkl_blas_avx2_xsgemm", frozenset({"avx2", "fma"})),
}


def fits(*matrices: Tensor) -> bool:
    """Whether the rows or the columns of every matrix lie together, one after another, as all ways but torch's want."""
    return all(_in_lines(*matrix.shape[-2:], *matrix.stride()[-2:]) for matrix in matrices)


def _in_lines(rows: int, columns: int, along_rows: int, along_columns: int) -> bool:
    by_rows = along_columns == 1 and (along_rows >= columns or rows == 1)
    return by_rows or (along_rows == 1 and (along_columns >= rows or columns == 1))
