"""Milliseconds of a DrQ-v2 update beside those of its authors' code and of plain autograd, and beside what the
arithmetic alone would allow.

All of it runs on one core. The floor is each convolution forward and back, by itself and on as many pictures at a time
as it is the quickest at, and the other products at the best rate that any library reaches; no unused gradient is
counted.

The authors' code takes part where `DRQV2` names its folder:

    git clone https://github.com/facebookresearch/drqv2 && DRQV2=drqv2 python -m benchmarks drqv2_update

It is timed twice, in processes of its own: as it is, and with glibc told to keep the memory of large tensors, without
which more than half of its time goes into getting that from the system again and again.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path
from statistics import median

import torch

from benchmarks.lines import Line, in_turns, one_core, seconds
from benchmarks.sac_update import best_products, products_flop
from rrm.agents.drqv2 import Drq
from rrm.config import DrqConfig, SacConfig
from rrm.envs import FrameSpace, Spaces
from rrm.nets.encoder import Encoder
from rrm.nets.precision import multiplies
from rrm.precision import Precision
from rrm.seeding import Streams
from rrm.types import Batch
from tests.rrm.agents.reference_drqv2 import ReferenceDrq

ACT, FRAMES = 4, FrameSpace(64, 64)
PAPER = DrqConfig(kind="drqv2")
LAPTOP = DrqConfig(kind="drqv2", channels=16, strides=(2, 2, 1, 1), batch=128)

#: What glibc is told: no block is so large that it goes back to the system when it is freed.
_KEPT = {
    "MALLOC_MMAP_THRESHOLD_": str(1 << 32), "MALLOC_TRIM_THRESHOLD_": str(1 << 34), "MALLOC_TOP_PAD_": str(1 << 28)
}  # fmt: skip

#: By precision, at the paper's sizes: least ratio to the authors' code as it is, and to the best of all.
_DEMANDS: dict[Precision, tuple[float, float]] = {"float32": (3.2, 1.3), "bfloat16": (6.0, 2.3)}
_SHARE, _LAPTOP_MS = 0.65, 35.0
_GAIN = 1.5  #: of the floor, from which on bfloat16 is asked to be quicker

_TURNS, _BUDGET_S = 5, 0.5


def lines(configs: tuple[DrqConfig, ...] = (PAPER, LAPTOP), budget: float = _BUDGET_S) -> list[Line]:
    """The paper's sizes and the laptop profile's, in both precisions."""
    torch.set_num_threads(1)
    precisions: tuple[Precision, ...] = ("float32", "bfloat16") if multiplies("bfloat16") else ("float32",)
    with one_core():
        return [line for config in configs for line in _lines(config, precisions, budget)]


def _lines(config: DrqConfig, precisions: tuple[Precision, ...], budget: float) -> Iterator[Line]:
    floors = {precision: floor_s(config, precision) for precision in precisions}
    with ExitStack() as stack:
        works = {precision: agent_update(config, precision) for precision in precisions}
        timed: dict[str, Callable[[], float]] = {
            name: lambda work=work: seconds(work, budget)
            for name, work in {**works, "autograd": plain_update(config)}.items()
        }
        timed |= {name: stack.enter_context(other) for name, other in authors(config, budget).items()}
        for measure in timed.values():
            measure()
        rounds = [{name: 1e3 * measure() for name, measure in timed.items()} for _ in range(_TURNS)]
    ms = {name: median(each[name] for each in rounds) for name in timed}
    peers = {name: figure for name, figure in ms.items() if name not in precisions}
    as_it_is = peers.pop("DrQ-v2", None)
    for precision in precisions:
        asked = config == PAPER and floors["float32"] >= floors[precision] * (_GAIN if precision == "bfloat16" else 1)
        item = f"DrQ-v2 update, batch {config.batch}, {config.channels} channels, {precision}"
        of_it, of_best = _DEMANDS[precision]
        yield Line(
            item=item, ours=ms[precision], unit="ms", peers=peers, floor=1e3 * floors[precision],
            least_ratio=of_best if asked and as_it_is is not None else None,
            least_share=_SHARE if config == PAPER else None, bound=_LAPTOP_MS if config == LAPTOP else None,
        )  # fmt: skip
        if as_it_is is not None:
            yield Line(
                item=item, ours=ms[precision], unit="ms", peers={"DrQ-v2 as it is": as_it_is},
                least_ratio=of_it if asked else None,
            )  # fmt: skip


def random_batch(config: DrqConfig) -> Batch:
    """Windows of random frames."""
    shape = config.batch, config.n_step
    frames = torch.randint(256, (config.batch, FRAMES.stack + config.n_step, *FRAMES.planar), dtype=torch.uint8)
    obs, act = torch.zeros(*shape, 1), torch.rand(*shape, ACT) * 2 - 1
    return Batch(obs, act, torch.zeros(shape), torch.randn(shape), obs, torch.ones(shape), frames)


def agent_update(config: DrqConfig, precision: Precision) -> Callable[[], None]:
    """Ours."""
    agent, batch = Drq(config, Spaces(1, ACT, FRAMES), Streams(0), precision=precision), random_batch(config)
    return lambda: agent.update(batch)


def plain_update(config: DrqConfig) -> Callable[[], object]:
    """The textbook's, from the networks of an agent of ours."""
    textbook, batch = ReferenceDrq(Drq(config, Spaces(1, ACT, FRAMES), Streams(0))), random_batch(config)

    def work() -> None:
        moves = torch.randint(-config.shift, config.shift + 1, (2, config.batch, 2))
        textbook.update(batch, moves, *torch.randn(2, config.batch, ACT))

    return work


def floor_s(config: DrqConfig, precision: Precision) -> float:
    """Seconds of the arithmetic of an update alone."""
    encoder = Encoder(config, FRAMES, None, precision)
    features, products = encoder.outputs, SacConfig()
    rate = products_flop(products) / in_turns(best_products(products, precision), turns=3, budget=0.05)[0]
    convolutions = sum(2 * forward + back for forward, back in _convolutions(encoder, FRAMES))

    def mlp(first: int, last: int) -> int:
        widths = [first, *[config.hidden] * config.layers, last]
        return sum(i * o for i, o in pairwise(widths))

    actor, critics = mlp(config.features, ACT), 2 * mlp(config.features + ACT, 1)
    # Trunks: two for the next frames, two for the present ones and one again for the critics when they have learned;
    # gradients of two, and one in the features.
    other = 8 * features * config.features + 4 * actor + 6 * critics
    return config.batch * (convolutions + 2 * other / rate)


def _convolutions(encoder: Encoder, frames: FrameSpace) -> Iterator[tuple[float, float]]:
    """Seconds a stack of pictures, forward and back, of each."""
    factors, below = encoder.factors(), (frames.height, frames.width, frames.stack * frames.channels)
    for layer, above in enumerate(encoder.shapes):
        weight, bias, stride = factors[2 * layer], factors[2 * layer + 1], encoder.strides[layer]
        works, counts = [], (4, 8, 16, 64)
        for count in counts:
            x, g = (torch.randn(count, *shape).to(encoder.dtype).permute(0, 3, 1, 2) for shape in (below, above))
            works += [_forward(x, weight, bias, stride), _back(x, g, weight, stride, layer > 0)]
        times = in_turns(*works, turns=3, budget=0.01)
        best = (min(s / n for s, n in zip(times[way::2], counts, strict=True)) for way in range(2))
        yield next(best), next(best)
        below = above


def _forward(x: torch.Tensor, weight: torch.Tensor, bias: torch.Tensor, stride: int) -> Callable[[], object]:
    return lambda: torch.nn.functional.conv2d(x, weight, bias, stride)


def _back(x: torch.Tensor, g: torch.Tensor, weight: torch.Tensor, stride: int, inputs: bool) -> Callable[[], object]:
    return lambda: torch.ops.aten.convolution_backward(
        g, x, weight, [len(weight)], [stride] * 2, [0, 0], [1, 1], False, [0, 0], 1, [inputs, True, True]
    )


def authors(config: DrqConfig, budget: float) -> dict[str, AbstractContextManager[Callable[[], float]]]:
    """Their code, as it is and with its memory kept; nothing where no folder is named.

    Raises:
        ValueError: the folder that `DRQV2` names does not hold it.
    """
    folder = os.environ.get("DRQV2")
    if not folder:
        return {}
    if not (Path(folder) / "drqv2.py").is_file():
        raise ValueError(f"DRQV2: there is no drqv2.py in {folder}; clone https://github.com/facebookresearch/drqv2")
    arguments = (folder, config.model_dump_json(), str(budget))
    return {"DrQ-v2": _timed(arguments, {}), "DrQ-v2, memory kept": _timed(arguments, _KEPT)}


@contextmanager
def _timed(arguments: tuple[str, ...], environment: Mapping[str, str]) -> Iterator[Callable[[], float]]:
    """What has a process of `drqv2_authors` time an update."""
    command = [sys.executable, "-m", "benchmarks.drqv2_authors", *arguments]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, env=os.environ | environment, stdin=pipe, stdout=pipe, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None

        def measure() -> float:
            print(file=process.stdin, flush=True)
            return float(process.stdout.readline())  # type: ignore[union-attr]

        yield measure
