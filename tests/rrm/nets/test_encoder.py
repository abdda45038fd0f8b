"""The encoder against plain autograd in double precision, and the moves of its pictures."""

import numpy as np
import torch
from torch import Tensor

from rrm.config import DrqConfig
from rrm.envs import FrameSpace
from rrm.nets.encoder import Encoder

CONFIG = DrqConfig(kind="drqv2", channels=4, strides=(2, 1), batch=8)
FRAMES = FrameSpace(height=16, width=18, stack=3)


def scenes(count: int, seed: int = 0, frames: FrameSpace = FRAMES) -> Tensor:
    """Pictures as a camera makes them: areas of one colour, with an edge, shades and a little noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: frames.height, : frames.width]
    shade = rng.uniform(0, 150, (count, frames.stack, frames.channels, 1, 1)) + 3 * x + 2 * y
    box = (abs(y - rng.uniform(0, frames.height, (count, frames.stack, 1, 1, 1))) < 3) & (x > frames.width / 3)
    noise = rng.integers(-5, 6, (count, *([frames.stack]), *frames.planar))
    return torch.from_numpy(np.clip(np.where(box, 250, shade) + noise, 0, 255).astype(np.uint8))


def make(precision: str = "float32", **changes: object) -> Encoder:
    """With biases that are not zero."""
    config = CONFIG.model_copy(update=changes)
    encoder = Encoder(config, FRAMES, torch.Generator().manual_seed(0), precision)  # type: ignore[arg-type]
    for bias in encoder.parameters()[1::2]:
        bias.data.normal_(0, 0.1, generator=torch.Generator().manual_seed(1))
    return encoder


def in_double(encoder: Encoder) -> list[Tensor]:
    return [p.detach().double().requires_grad_() for p in encoder.parameters()]


def test_features() -> None:
    """As plain convolutions in double precision have them, whatever is folded into the first."""
    encoder, frames = make(), scenes(37)
    expected = encoder.plain(frames, in_double(encoder)).detach()
    assert encoder.outputs == expected.shape[1] == 5 * 6 * 4
    torch.testing.assert_close(encoder.encode(frames).double(), expected, rtol=1e-5, atol=1e-5)


def test_a_frozen_copy_stays() -> None:
    encoder, frames = make(), scenes(3)
    frozen, before = encoder.frozen(), encoder.encode(frames)
    encoder.flat.add_(0.1)
    assert torch.equal(frozen.encode(frames), before)
    assert not torch.equal(encoder.encode(frames), before)
