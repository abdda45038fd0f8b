"""The flat Adam against PyTorch's."""

import torch

from rrm.nets.adam import FlatAdam


def run(adam: FlatAdam, grads: torch.Tensor) -> None:
    for grad in grads:
        adam.grad.copy_(grad)
        adam.step()


def test_equals_torch() -> None:
    """Parameters follow `torch.optim.Adam` with its default settings."""
    torch.manual_seed(0)
    start, grads = torch.randn(1001), torch.randn(7, 1001)
    ours = FlatAdam(start.clone(), torch.zeros(1001), lr=3e-3)
    theirs = start.clone().requires_grad_()
    optimiser = torch.optim.Adam([theirs], lr=3e-3, foreach=False)
    run(ours, grads)
    for grad in grads:
        theirs.grad = grad.clone()
        optimiser.step()
    torch.testing.assert_close(ours.param, theirs.detach(), rtol=1e-6, atol=1e-6)


def test_continues_exactly() -> None:
    """Saved and loaded, it continues to the last bit; after a reset it starts afresh."""
    torch.manual_seed(0)
    start, grads = torch.randn(100), torch.randn(6, 100)
    whole = FlatAdam(start.clone(), torch.zeros(100), lr=0.1)
    run(whole, grads[:3])
    other = FlatAdam(whole.param.clone(), torch.zeros(100), lr=0.1)
    other.load_state_dict(whole.state_dict())
    run(whole, grads[3:])
    run(other, grads[3:])
    assert torch.equal(whole.param, other.param)

    fresh = FlatAdam(start.clone(), torch.zeros(100), lr=0.1)
    run(fresh, grads[:1])
    whole.reset()
    whole.param.copy_(start)
    run(whole, grads[:1])
    assert torch.equal(fresh.param, whole.param)
