"""Compiled work against the same in torch: activations and derivatives in either precision, sums, conversion."""

import copy
import pickle
from collections.abc import Iterator

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor, nn

from rrm.nets import program
from rrm.nets.compiled import LEAK
from rrm.nets.program import (
    Activation,
    Coded,
    activate,
    add_to_rows,
    convert,
    fuse,
    sum_rows,
    times_vectors,
    undo,
)

WIDE, NARROW = torch.float32, torch.bfloat16
#: Of what is read and what is written; in place where they are of one precision.
PRECISIONS = [(WIDE, WIDE), (WIDE, NARROW), (NARROW, WIDE), (NARROW, NARROW)]


@pytest.fixture(params=[True, False], ids=["compiled", "torch"], autouse=True, scope="module")
def _on_a_processor_and_elsewhere(request: pytest.FixtureRequest) -> Iterator[None]:
    """Everything also as it is done on other devices."""
    with pytest.MonkeyPatch.context() as patch:
        if not request.param:
            patch.setattr(program, "_compiles", lambda _tensor: False)
        yield


sizes = st.tuples(st.integers(1, 3), st.integers(1, 70), st.integers(1, 70))
activations = st.sampled_from(["relu", "leaky_relu"])
precisions = st.sampled_from(PRECISIONS)


def numbers(*shape: int, dtype: torch.dtype = WIDE, padding: int = 0, seed: int = 0) -> Tensor:
    """Normal numbers with some zeros, in rows that lie further apart than they are long."""
    drawn = torch.randn(*shape[:-1], shape[-1] + padding, generator=torch.Generator().manual_seed(seed))
    return (drawn * (drawn.abs() > 0.1)).to(dtype)[..., : shape[-1]]


def slope(activation: Activation) -> float:
    return 0.0 if activation == "relu" else LEAK


@given(size=sizes, activation=activations, dtypes=precisions, padding=st.sampled_from([0, 3, 16]))
def test_activations(
    size: tuple[int, int, int], activation: Activation, dtypes: tuple[torch.dtype, torch.dtype], padding: int
) -> None:
    """The sum is taken and bent in float32, and rounded once."""
    source, bias = numbers(*size, dtype=dtypes[0], padding=padding), numbers(size[0], 1, size[2], seed=1)
    target = source if dtypes[0] == dtypes[1] else numbers(*size, dtype=dtypes[1])
    expected = nn.functional.leaky_relu(source.float() + bias, slope(activation)).to(dtypes[1])
    activate(activation, source, bias, target)()
    assert torch.equal(target, expected)


@given(size=sizes, activation=activations, dtypes=precisions, padding=st.sampled_from([0, 3, 16]), summed=st.booleans())
def test_derivatives(
    size: tuple[int, int, int],
    activation: Activation,
    dtypes: tuple[torch.dtype, torch.dtype],
    padding: int,
    summed: bool,
) -> None:
    """The gradient of what an activation was given, by the sign of what it left; its sums are not rounded before."""
    source = numbers(*size, dtype=dtypes[0], padding=padding)
    activated = numbers(*size, dtype=dtypes[0], seed=2)
    target = source if dtypes[0] == dtypes[1] else numbers(*size, dtype=dtypes[1])
    exact = torch.where(activated <= 0, source.float() * slope(activation), source.float())
    total = torch.full((size[0], 1, size[2]), torch.nan) if summed else None
    undo(activation, source, activated, target, total)()
    assert torch.equal(target, exact.to(dtypes[1]))
    if total is not None:
        torch.testing.assert_close(total, exact.sum(1, keepdim=True), rtol=1e-5, atol=1e-5)


@given(size=sizes, bits=st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=50))
def test_conversion(size: tuple[int, int, int], bits: list[int]) -> None:
    """To the nearest bfloat16, of two to the even one, as torch does it; whatever a float32 is; and back exactly."""
    values = torch.tensor(bits, dtype=torch.int64).to(torch.int32).view(WIDE).view(1, 1, -1)
    narrow, wide = torch.empty_like(values, dtype=NARROW), torch.empty_like(values)
    for work in (convert(values, narrow), convert(narrow, wide)):
        work()
    expected = values.to(NARROW)
    assert torch.equal(narrow.isnan(), expected.isnan())
    assert torch.equal(narrow.nan_to_num(), expected.nan_to_num())
    assert torch.equal(wide.nan_to_num(), expected.float().nan_to_num())
    matrices = numbers(*size, padding=5)
    rounded = torch.empty(size, dtype=NARROW)
    convert(matrices, rounded)()
    assert torch.equal(rounded, matrices.to(NARROW))


@given(size=sizes)
def test_rows(size: tuple[int, int, int]) -> None:
    """A number for every row is added, and the sum of every row taken."""
    rows, bias = numbers(*size, padding=2), numbers(*size[:2], 1, seed=1)
    expected, sums = rows + bias, torch.empty(*size[:2], 1)
    for work in fuse([add_to_rows(rows, bias), sum_rows(rows, sums)]):
        work()
    assert torch.equal(rows, expected)
    torch.testing.assert_close(sums, expected.sum(2, keepdim=True), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("activation", ["relu", "leaky_relu"])
def test_what_is_not_a_number_stays_so(activation: Activation) -> None:
    """It must reach the checks on losses and actions."""
    rows = torch.full((1, 2, 20), torch.nan)
    activate(activation, rows, torch.zeros(1, 1, 20), rows)()
    assert rows.isnan().all()
    narrow = torch.empty(1, 2, 20, dtype=NARROW)
    activate(activation, rows, torch.zeros(1, 1, 20), narrow)()
    assert narrow.isnan().all()


def test_joined_works_are_one_and_in_order() -> None:
    """Others stay between those that they stood between."""
    seen: list[str] = []
    a, b = torch.zeros(1, 1, 4), torch.ones(1, 1, 1)
    coded = [times_vectors(b, b[..., 0], a[..., 0]), times_vectors(b, b[..., 0], a[..., 1])]
    works = fuse([*coded, lambda: seen.append(str(a[0, 0, 0].item())), *coded])
    assert [type(work) is Coded for work in works] == [True, False, True]
    for work in works:
        work()
    assert seen == ["1.0"]
    assert a[0, 0, :2].tolist() == [1, 1]


def test_a_work_is_bound_to_its_memory() -> None:
    """A copy of it would write into that of another."""
    ones = torch.ones(1, 1, 1)
    work = times_vectors(ones, ones[..., 0], ones[..., 0])
    for take in (copy.copy, copy.deepcopy, pickle.dumps):
        with pytest.raises(TypeError, match="bound to its memory"):
            take(work)


@given(size=sizes, transposed=st.booleans(), apart=st.integers(1, 3))
def test_vectors(size: tuple[int, int, int], transposed: bool, apart: int) -> None:
    """A matrix that lies either way times a vector, wherever its numbers lie; nothing is written beside the result."""
    stack, rows, columns = size
    matrices = numbers(stack, columns, rows, padding=3).mT if transposed else numbers(*size, padding=3)
    vectors = numbers(stack, columns, apart, seed=1)[..., 0]
    room = torch.full((stack, rows, apart), torch.nan)
    times_vectors(matrices, vectors, room[..., 0])()
    expected = torch.einsum("nrc,nc->nr", matrices.double(), vectors.double())
    torch.testing.assert_close(room[..., 0].double(), expected, rtol=1e-5, atol=1e-4)
    assert room[..., 1:].isnan().all()
