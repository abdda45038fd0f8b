"""Products in bfloat16: what is rounded, what is not, and that a machine that cannot says so."""

import os
import subprocess
import sys

import pytest
import torch

from rrm.nets.mlp import Pass, StackedMLP
from rrm.nets.precision import multiplies

here = pytest.mark.skipif(not multiplies("bfloat16"), reason="this processor has no bfloat16 products")


def test_a_processor_without_it_is_refused() -> None:
    """Where the library would compute in float32 instead, asking for bfloat16 is an error and not a wish."""
    program = "from rrm.nets import precision; precision.extensions = frozenset; precision.check_precision('bfloat16')"
    environment = os.environ | {"ONEDNN_MAX_CPU_ISA": "AVX2"}
    found = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert 'use precision = "float32"' in found.stderr


def rounded(x: torch.Tensor) -> torch.Tensor:
    return x.bfloat16().float()


def multiplied(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
    """A product in bfloat16."""
    return rounded(rounded(a) @ rounded(b))


def far(a: torch.Tensor, b: torch.Tensor) -> float:
    return ((a - b).norm() / b.norm()).item()


@here
def test_only_products_between_hidden_layers_round() -> None:
    """The output is what rounding the factors of the inner products gives, first and last layer left in float32."""
    shape = {"members": 2, "inputs": 64, "hidden": 64, "layers": 2, "outputs": 64}
    net = StackedMLP(**shape, generator=torch.Generator().manual_seed(0), precision="bfloat16")
    x = torch.randn(96, 64)
    weights, biases = ([p.detach() for p in net.parameters()[start::2]] for start in (0, 1))
    h = torch.relu(x @ weights[0] + biases[0])
    h = torch.relu(multiplied(h, weights[1]) + biases[1])
    expected = (h @ weights[2] + biases[2]).transpose(1, 2)
    # A few sums lie so near the middle of two numbers that they are rounded otherwise where added in another order.
    assert far(Pass(net, x).forward(), expected) < 2e-4
    assert far(net.plain(x), expected) > 1e-3


@here
def test_gradients_stay_close() -> None:
    """Gradients differ from those in float32 by what eight bits of mantissa explain."""
    shape = {"members": 2, "inputs": 40, "hidden": 64, "layers": 3, "outputs": 3}
    net = StackedMLP(**shape, generator=torch.Generator().manual_seed(0), precision="bfloat16")
    x, grad = torch.randn(96, 40), torch.randn(2, 3, 96)
    exact = torch.cat([g.flatten() for g in torch.autograd.grad(net.plain(x), net.parameters(), grad)])
    close = torch.cat([g.flatten() for g in torch.autograd.grad(net(x), net.parameters(), grad)])
    error = (exact - close).norm() / exact.norm()
    assert 1e-4 < error < 0.1, error  # a unit that rounds to the other side of zero changes its whole column
