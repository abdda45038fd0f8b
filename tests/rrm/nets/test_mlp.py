"""The stacked MLP against `nn.Linear`, member by member."""

import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from torch import Tensor, nn

from rrm.nets.mlp import Pass, StackedMLP
from rrm.nets.program import Activation
from tests.rrm.agents.reference_sac import unstack

SHAPE = {"members": 3, "inputs": 7, "hidden": 20, "layers": 2, "outputs": 2}


def make(**changes: object) -> StackedMLP:
    return StackedMLP(**{**SHAPE, "generator": torch.Generator().manual_seed(0), **changes})  # type: ignore[arg-type]


shapes = st.fixed_dictionaries(
    {
        "members": st.integers(1, 4),
        "inputs": st.integers(1, 50),
        "hidden": st.integers(1, 70),
        "layers": st.integers(0, 4),
        "outputs": st.integers(1, 9),
        "activation": st.sampled_from(["relu", "leaky_relu"]),
        "init": st.sampled_from(["orthogonal", "torch"]),
        "normalised": st.booleans(),
    }
)


@settings(max_examples=40, deadline=None)
@given(shape=shapes, rows=st.integers(1, 70), shared=st.booleans(), seed=st.integers(0, 10**6))
def test_equals_linear_layers(shape: dict[str, int], rows: int, shared: bool, seed: int) -> None:
    """Both forwards and both backwards equal autograd over separate networks of `nn.Linear`, whatever the shape."""
    assume(shape["hidden"] >= 8 or not shape["normalised"])  # of two units normalisation leaves a sign
    g = torch.Generator().manual_seed(seed)
    net = make(**shape, generator=g)
    members, inputs = shape["members"], shape["inputs"]
    x = torch.randn(*([rows] if shared else [members, rows]), inputs, generator=g)
    grad = torch.randn(members, rows, shape["outputs"], generator=g)
    columns = slice(inputs // 2, None)

    plain = unstack(net)
    own = x.expand(members, -1, -1).clone().requires_grad_()
    expected = torch.stack([member(rows_of) for member, rows_of in zip(plain, own, strict=True)])
    expected.backward(grad)
    expected_grad = torch.cat([p.grad.flatten() for p in plain.parameters() if p.grad is not None])
    assert own.grad is not None

    def close(theirs: Tensor, ours: Tensor) -> None:
        exact = 1e-4 if shape["normalised"] else 1e-5  # a row that hardly varies is enlarged, and so is its rounding
        torch.testing.assert_close(ours, theirs, rtol=1e-4, atol=exact * (1 + theirs.abs().max().item()))

    there = Pass(net, x, columns=columns)
    close(expected.detach(), there.forward().transpose(1, 2))
    narrow = there.grad.copy_(grad.transpose(1, 2))
    close(own.grad[..., columns], there.backward_inputs().transpose(1, 2))
    there.backward_params()
    written_out = net.flat_grad.clone()
    close(expected_grad, unstacked_grads(net, shape))

    for differentiable in (net, net.plain):
        outputs = differentiable(x)
        close(expected.detach(), outputs.detach().transpose(1, 2))
        for window, leaf in zip(net.grads, torch.autograd.grad(outputs, net.parameters(), narrow), strict=True):
            window.copy_(leaf)
        close(written_out, net.flat_grad)
        close(expected_grad, unstacked_grads(net, shape))


def unstacked_grads(net: StackedMLP, shape: dict[str, int]) -> Tensor:
    twin = make(**{**shape, "generator": None})
    twin.flat.copy_(net.flat_grad)
    return torch.cat([p.detach().flatten() for p in unstack(twin).parameters()])


def test_given_params_are_differentiable_twice() -> None:
    """With parameters passed in, a gradient step can itself be differentiated, as MRN's pseudo critic needs."""
    net = make()
    x, target = torch.randn(5, 7), torch.tensor(0.5, requires_grad=True)
    params = [p.detach().requires_grad_() for p in net.parameters()]
    inner = (net.plain(x, params) - target).square().mean()
    steps = torch.autograd.grad(inner, params, create_graph=True)
    stepped = [p - 0.1 * s for p, s in zip(params, steps, strict=True)]
    net.plain(x, stepped).sum().backward()
    assert target.grad is not None
    assert target.grad.abs() > 0
    assert all(p.grad is None for p in net.parameters())


def test_orthogonal_start() -> None:
    """Every member starts with its own orthogonal matrices of gain one and zero biases."""
    net = make(init="orthogonal")
    weights, biases = net.parameters()[::2], net.parameters()[1::2]
    assert all(not b.any() for b in biases)
    square = weights[1].detach()
    for member in square:
        torch.testing.assert_close(member @ member.t(), torch.eye(20), rtol=0, atol=1e-5)
    assert not torch.equal(square[0], square[1])
    wide = weights[0].detach()[0]
    torch.testing.assert_close(wide @ wide.t(), torch.eye(7), rtol=0, atol=1e-5)


def test_torch_start() -> None:
    """PyTorch's own start is uniform within one over the root of the inputs, biases included."""
    net = make(init="torch", hidden=100)
    first, bias = (p.detach() for p in net.parameters()[:2])
    bound = 7**-0.5
    for drawn in (first, bias):
        assert bound * 0.9 < drawn.abs().max() <= bound
        assert drawn.std().item() == pytest.approx(bound / 3**0.5, rel=0.1)
    torch.manual_seed(0)
    assert nn.Linear(7, 100).weight.abs().max() <= bound


def test_start_depends_on_the_generator_alone() -> None:
    """Equal generators give equal weights, and torch's global generator is left alone."""
    before = torch.get_rng_state()
    assert torch.equal(make().flat, make().flat)
    assert torch.equal(before, torch.get_rng_state())


@pytest.mark.parametrize("activation", ["relu", "leaky_relu"])
def test_optimiser_reaches_every_parameter(activation: Activation) -> None:
    """An in-place change of the flat buffer is seen by the next differentiable pass."""
    net = make(activation=activation)
    x = torch.randn(4, 7)
    net.flat.zero_()
    assert not net(x).any()
