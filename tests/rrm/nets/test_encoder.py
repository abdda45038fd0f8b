"""The encoder against plain autograd in double precision, and the moves of its pictures."""

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import pad

from rrm.config import DrqConfig
from rrm.envs import FrameSpace
from rrm.errors import ConfigError
from rrm.nets.encoder import Encoder, Pass
from rrm.nets.precision import multiplies
from rrm.nets.shift import pictures

CONFIG = DrqConfig(kind="drqv2", channels=4, strides=(2, 1), batch=8)
FRAMES = FrameSpace(height=16, width=18, stack=3)


def scenes(count: int, seed: int = 0, frames: FrameSpace = FRAMES) -> Tensor:
    """Pictures as a camera makes them: areas of one colour, with an edge, shades and a little noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[: frames.height, : frames.width]
    shade = rng.uniform(0, 150, (count, frames.stack, frames.channels, 1, 1)) + 3 * x + 2 * y
    box = (abs(y - rng.uniform(0, frames.height, (count, frames.stack, 1, 1, 1))) < 3) & (x > frames.width / 3)
    noise = rng.integers(-5, 6, (count, frames.stack, *frames.planar))
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


def gradients(encoder: Encoder, frames: Tensor, grad: Tensor) -> tuple[Tensor, Tensor]:
    """Those written out, and those of autograd in double precision, each in one piece."""
    there = Pass(encoder, len(frames))
    there.forward(frames)
    there.backward(grad.to(encoder.dtype))
    params = in_double(encoder)
    expected = torch.autograd.grad(encoder.plain(frames, params), params, grad.double())
    return encoder.flat_grad, torch.cat([flat(encoder, leaf) for leaf in expected])


def flat(encoder: Encoder, leaf: Tensor) -> Tensor:
    """Padded as the encoder's own are."""
    return torch.nn.functional.pad(leaf.flatten(), (0, -leaf.numel() % 16))


def test_gradients() -> None:
    """To 1e-5 those of autograd in double precision, on pictures like real ones and with biases that are not zero."""
    encoder, frames = make(), scenes(37)
    grad = torch.randn(37, encoder.outputs, generator=torch.Generator().manual_seed(2))
    ours, expected = gradients(encoder, frames, grad)
    assert (ours - expected).norm() <= 1e-5 * expected.norm()
    first = encoder.parameters()[0].numel()  # small beside the others, and what is folded
    assert (ours - expected)[:first].norm() <= 1e-5 * expected[:first].norm()


@pytest.mark.skipif(not multiplies("bfloat16"), reason="this processor has no products in bfloat16")
def test_bfloat16() -> None:
    """Features and gradients in bfloat16 are those of double precision but for its rounding."""
    encoder, frames = make("bfloat16"), scenes(37)
    expected = encoder.plain(frames, in_double(encoder)).detach()
    assert (encoder.encode(frames) - expected).norm() <= 0.02 * expected.norm()
    grad = torch.randn(37, encoder.outputs, generator=torch.Generator().manual_seed(2))
    ours, expected = gradients(encoder, frames, grad)
    assert (ours - expected).norm() <= 0.05 * expected.norm()


def test_moved_pictures_are_crops_of_padded_ones() -> None:
    """A move by whole pixels is a crop of what replicate-padding makes, the same for all pictures of a stack."""
    reach, (height, width) = 3, (FRAMES.height, FRAMES.width)
    moves = torch.tensor([(y, x) for y in range(-reach, reach + 1) for x in range(-reach, reach + 1)])
    frames = scenes(len(moves))
    padded = pad(frames.flatten(1, 2).float(), [reach] * 4, mode="replicate")
    expected = torch.stack([
        one[:, reach + y : reach + y + height, reach + x : reach + x + width]
        for one, (y, x) in zip(padded, moves.tolist(), strict=True)
    ])  # fmt: skip
    assert torch.equal(pictures(frames, moves) + 128.0, expected)
    windows = torch.cat((frames, frames), dim=1)
    assert torch.equal(pictures(windows[:, : FRAMES.stack], moves), pictures(frames, moves))
    assert torch.equal(pictures(frames), pictures(frames, 0 * moves))


def test_a_move_beyond_the_picture() -> None:
    """What is further away than the picture is wide is its edge."""
    frames = scenes(2)
    far = pictures(frames, torch.tensor([(0, 40), (-40, 0)])) + 128.0
    assert torch.equal(far[0], frames[0].flatten(0, 1)[..., -1:].expand(-1, -1, FRAMES.width))
    assert torch.equal(far[1], frames[1].flatten(0, 1)[..., :1, :].expand(-1, FRAMES.height, -1))


def test_the_start() -> None:
    """Orthogonal with gain sqrt(2), zero biases, from the generator alone."""
    before = torch.get_rng_state()
    encoder, again = (Encoder(CONFIG, FRAMES, torch.Generator().manual_seed(3)) for _ in range(2))
    assert torch.equal(encoder.flat, again.flat)
    assert torch.equal(before, torch.get_rng_state())
    for weight, bias in zip(encoder.parameters()[::2], encoder.parameters()[1::2], strict=True):
        rows = weight.detach().flatten(1)
        torch.testing.assert_close(rows @ rows.t(), 2 * torch.eye(4), rtol=0, atol=1e-5)
        assert not bias.any()


def test_one_stack_is_as_good_as_many() -> None:
    encoder, frames = make(), scenes(20)
    torch.testing.assert_close(encoder.encode(frames[:1]), encoder.encode(frames)[:1], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize(("height", "width"), [(4, 16), (16, 4)])
def test_pictures_that_are_too_small(height: int, width: int) -> None:
    """Convolutions of 3 x 3 that leave nothing over are refused, and it is said what would do."""
    with pytest.raises(ConfigError, match=rf"{height} x {width} pixels.* 4 convolutions.*camera.size"):
        Encoder(CONFIG.model_copy(update={"strides": (2, 1, 1, 1)}), FrameSpace(height, width), None)
