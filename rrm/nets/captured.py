"""Work on a graphics card as one launch.

An update is some hundred small operations, and asking a card for each takes longer than most of them. What only reads
and writes memory that stays where it is can be recorded once, as a CUDA graph, and asked for as a whole.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Generic, TypeVar

import torch
from torch import Tensor

from rrm.devices import CUDA, check_device, kind_of

if TYPE_CHECKING:
    from rrm.precision import Precision

_T = TypeVar("_T")

#: Memory that cuBLAS works in, of a size that makes its sums the same in every process.
_WORKSPACE = ("CUBLAS_WORKSPACE_CONFIG", ":4096:8")


def prepare(device: str, precision: Precision) -> None:
    """Have torch compute on this device in one way alone, and not otherwise. Nothing to do for the processor.

    Raises ConfigError where the device is not there. An operation that a card can only do in another order every time
    raises RuntimeError from now on.
    """
    check_device(device)
    if kind_of(device) != CUDA:
        return
    os.environ.setdefault(*_WORKSPACE)  # read when the first product is computed
    if torch.device(device).index is not None:
        torch.cuda.set_device(device)
    torch.use_deterministic_algorithms(True)
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]  # nothing reads it unwritten
    torch.backends.cudnn.benchmark = False  # what is quickest may be another today
    exactness = "high" if precision == "tf32" else "highest"
    torch.set_float32_matmul_precision(exactness)
    torch.backends.cudnn.allow_tf32 = precision == "tf32"


class Captured(Generic[_T]):
    """A function, recorded the first time it is called on a card and played from then on; elsewhere it is called.

    Args:
        work: reads and writes tensors that stay where they are, and never waits for the card. What it returns stays
            where it is, too, and is written over the next time.
        changed: every tensor that it changes and that anybody reads before it is written: what a trial changes
            is put back.
        generators: of the device, from which it draws.
    """

    def __init__(
        self,
        work: Callable[[], _T],
        device: torch.device | str,
        changed: Sequence[Tensor] = (),
        generators: Sequence[torch.Generator] = (),
    ) -> None:
        self._work = work
        self._device = torch.device(device)
        self._changed = changed
        self._generators = generators
        self._graph: torch.cuda.CUDAGraph | None = None
        self._result: _T

    def __call__(self) -> _T:
        if self._device.type != CUDA:
            return self._work()
        if self._graph is None:
            with torch.cuda.device(self._device):
                self._graph = self._record()
        self._graph.replay()
        return self._result

    def _record(self) -> torch.cuda.CUDAGraph:
        """A trial goes before: libraries make themselves ready when they are first asked, which no record may hold."""
        kept = [tensor.clone() for tensor in self._changed]
        drawn = [generator.get_state() for generator in self._generators]
        here, beside = torch.cuda.current_stream(), torch.cuda.Stream()  # type: ignore[no-untyped-call]
        beside.wait_stream(here)
        with torch.cuda.stream(beside):
            self._work()
        here.wait_stream(beside)
        for tensor, before in zip(self._changed, kept, strict=True):
            tensor.copy_(before)
        for generator, state in zip(self._generators, drawn, strict=True):
            generator.set_state(state)
        graph = torch.cuda.CUDAGraph()
        for generator in self._generators:
            graph.register_generator_state(generator)
        with torch.cuda.graph(graph, stream=beside):  # where torch sets back what the generators' draws begin from
            self._result = self._work()
        here.wait_stream(beside)  # else that could come after the first replay has set it
        return graph
