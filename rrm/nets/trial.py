"""Tries ways to a product, and prints what it found of each as soon as it has: some may end the process.

    python -m rrm.nets.trial WAY ...

Each line is a JSON object: `way`; `rates`, operations a second by cell; `refused`, why the way is not to be taken.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import TextIO

import torch
from torch import Tensor

from rrm.nets.encoder import AT_ONCE
from rrm.nets.precision import multiplies
from rrm.nets.ways import WAYS, MklKernel
from rrm.precision import Precision
from rrm.tuning import CONVOLUTIONS, FORMS, ROUNDED, SEEING, SHAPES, cell

_TURNS, _TURN_S = 3, 0.002
_SIDES = 29, 27  # of pictures before and behind a convolution
_LACKING = "this processor or this torch does not have it"

#: So long may one way take; it is a second at the most. Then the system ends this process.
_PATIENCE_S = 120

#: The largest error of one sum of products of normal numbers, over the root of how many there are: what float32
#: explains, with room for any order of adding up, and what factors rounded to bfloat16 do.
_ERROR = {False: 2.0**-15, True: 2.0**-3}


def main(names: Sequence[str], output: TextIO) -> None:
    """Try the ways of these names in turn."""
    torch.set_num_threads(1)
    for name in names:
        signal.alarm(_PATIENCE_S)
        rates, refused = attempt(name)
        output.write(json.dumps({"way": name, "rates": rates, "refused": refused}) + "\n")
        output.flush()


def attempt(name: str) -> tuple[dict[str, float], str]:
    """Rates of one way by cell, and why it is not to be taken; empty where it is."""
    if name in SEEING.values():
        return _convolutions("bfloat16" if name == SEEING["bfloat16"] else "float32")
    dtype = torch.bfloat16 if name == ROUNDED else torch.float32
    way = WAYS["torch" if name == ROUNDED else name]
    if (isinstance(way, MklKernel) and not way.there()) or (name == ROUNDED and not multiplies("bfloat16")):
        return {}, _LACKING
    rates = {}
    generator = torch.Generator().manual_seed(0)
    for shape in SHAPES:
        rows, inputs, outputs = shape
        x, d = (torch.randn(1, rows, width, generator=generator) for width in (inputs, outputs))
        w = torch.randn(1, inputs, outputs, generator=generator)
        for form in FORMS:
            a, b = {"forward": (x, w), "weights": (x.mT, d), "inputs": (d, w.mT)}[form]
            a, b = a.to(dtype), b.to(dtype)
            out = torch.empty(1, a.shape[1], b.shape[2], dtype=dtype)
            work = way(a, b, out)
            work()
            error = (out - a.double() @ b.double()).abs().max().item()
            if not error <= _ERROR[name == ROUNDED] * math.sqrt(a.shape[2]):
                return {}, f"its products are not exact: {cell(form, shape)} is off by {error:.1g}"
            rates[cell(form, shape)] = 2.0 * rows * inputs * outputs / _seconds(work)
    return rates, ""


def _convolutions(precision: Precision) -> tuple[dict[str, float], str]:
    """Of a layer between two others, as many pictures at a time as an encoder takes."""
    if not multiplies(precision):
        return {}, _LACKING
    rates, generator, dtype = {}, torch.Generator().manual_seed(0), getattr(torch, precision)
    for channels in CONVOLUTIONS:
        count, (below, above) = AT_ONCE[dtype], _SIDES
        x, d = (torch.randn(count, side, side, channels, generator=generator) for side in (below, above))
        x, d = (pictures.to(dtype).permute(0, 3, 1, 2) for pictures in (x, d))
        weight, bias = (
            torch.randn(channels, channels, 3, 3, generator=generator).to(dtype),
            torch.zeros(channels).to(dtype),
        )
        rates[str(channels)] = (
            6.0 * count * (3 * above * channels) ** 2 / _seconds(partial(_there_and_back, x, weight, bias, d))
        )
    return rates, ""


def _there_and_back(x: Tensor, weight: Tensor, bias: Tensor, d: Tensor) -> None:
    torch.nn.functional.conv2d(x, weight, bias)
    torch.ops.aten.convolution_backward(
        d, x, weight, [len(weight)], [1, 1], [0, 0], [1, 1], False, [0, 0], 1, [True] * 3
    )


def _seconds(work: Callable[[], object]) -> float:
    """Of the processor, for a call, in the best of a few turns: others may want it, too."""
    best = math.inf
    for _ in range(_TURNS):
        calls, start = 0, time.process_time()
        while (passed := time.process_time() - start) < _TURN_S or not calls:
            work()
            calls += 1
        best = min(best, passed / calls)
    return best


def alone() -> TextIO:
    """Standard output for us alone: libraries that are told to be verbose write to standard error from now on."""
    ours = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return ours


if __name__ == "__main__":
    main(sys.argv[1:], alone())
