"""Products by choice: every way of this machine computes the same, and what is chosen is what is taken."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from rrm.nets import products
from rrm.nets.precision import multiplies
from rrm.nets.products import bind, choice, use, using
from rrm.nets.ways import WAYS, Work, fits
from rrm.tuning import EXACT, OTHERWISE, machine

#: Those that a process of its own has tried on this machine.
HERE = sorted(machine().rates.keys() & {*EXACT})


@dataclass(frozen=True)
class Layout:
    """How a matrix lies in memory."""

    transposed: bool
    padding: int  #: numbers between the end of a line and the next
    shared: bool  #: one for the whole stack

    def place(self, matrices: Tensor) -> Tensor:
        """These numbers, or those of the first, so laid out."""
        stack, rows, columns = matrices.shape
        lines, length = (columns, rows) if self.transposed else (rows, columns)
        room = torch.full((1 if self.shared else stack, lines, length + self.padding), torch.nan, dtype=matrices.dtype)[
            ..., :length
        ]
        room = room.mT if self.transposed else room
        return room.copy_(matrices[: len(room)]).expand(stack, rows, columns)


layouts = st.builds(Layout, st.booleans(), st.sampled_from([0, 1, 16]), st.booleans())
outputs = st.builds(Layout, st.booleans(), st.sampled_from([0, 1, 16]), st.just(False))
sides = st.one_of(st.sampled_from([1, 2, 8, 16]), st.integers(1, 70))


def check(a: Tensor, b: Tensor, out: Tensor, work: Work) -> None:
    """As exact as float32 is in whatever order the sums are taken; again with other numbers at the same place."""
    for _ in range(2):
        work()
        bound = (a.shape[2] + 1) * 2.0**-23 * (a.double().abs() @ b.double().abs())
        assert ((out - a.double() @ b.double()).abs() <= bound).all()
        a[0].neg_()
        out.fill_(7.0)


@pytest.mark.slow
@pytest.mark.parametrize("way", HERE)
@given(stack=st.integers(1, 3), shape=st.tuples(sides, sides, sides), left=layouts, right=layouts, written=outputs,
       seed=st.integers(0, 99))  # fmt: skip
def test_every_way_computes_the_same(
    way: str, stack: int, shape: tuple[int, int, int], left: Layout, right: Layout, written: Layout, seed: int
) -> None:
    """Whatever the sizes, however the factors and the product lie, and nothing is written beside it."""
    rows, inner, columns = shape
    generator = torch.Generator().manual_seed(seed)
    a = left.place(torch.randn(stack, rows, inner, generator=generator))
    b = right.place(torch.randn(stack, inner, columns, generator=generator))
    out = written.place(torch.zeros(stack, rows, columns))
    with using({OTHERWISE: way}):
        check(a, b, out, bind(a, b, out))
    whole = torch.tensor(out.untyped_storage().tolist(), dtype=torch.uint8).view(torch.float32)
    assert whole.isnan().sum() == whole.numel() - out.numel()


@contextmanager
def threads(number: int) -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(number)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@pytest.fixture
def taken(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The ways that products have gone since."""
    gone: list[str] = []

    def noted(name: str) -> products.Way:
        def way(a: Tensor, b: Tensor, out: Tensor) -> Work:
            gone.append(name)
            return WAYS["torch"](a, b, out)

        return way

    monkeypatch.setattr(products, "WAYS", {name: noted(name) for name in WAYS})
    return gone


def layer(rows: int, inputs: int, outs: int) -> tuple[Tensor, Tensor, Tensor]:
    return torch.randn(1, rows, inputs), torch.randn(1, inputs, outs), torch.randn(1, rows, outs)


def test_each_product_goes_the_way_of_its_form_and_size(taken: list[str]) -> None:
    """That of the nearest product that was measured; where none is named, the one of all."""
    own = {f"{form} 128x128x128": way for form, way in (("forward", "numpy"), ("weights", "onednn"))}
    with threads(1), using({OTHERWISE: "torch", **own}):
        for size in ((120, 140, 128), (2000, 256, 256)):
            x, w, d = layer(*size)
            for a, b in ((x, w), (x.mT, d), (d, w.mT)):
                out = torch.empty(1, a.shape[1], b.shape[2])
                check(a, b, out, bind(a, b, out))
    assert taken == ["numpy", "onednn", "torch", "torch", "torch", "torch"]


def test_a_product_that_is_written_transposed_is_another_product(taken: list[str]) -> None:
    """(a b)' is b' a': the form is that of the factors as they lie then."""
    x, w, _ = layer(128, 128, 128)
    out = torch.empty(1, 128, 128).mT
    with threads(1), using({OTHERWISE: "torch", "weights 128x128x128": "numpy"}):
        check(x, w, out, bind(x, w, out))
    assert taken == ["numpy"]


def test_torch_alone_uses_several_threads(taken: list[str]) -> None:
    """No other way does, so that none is taken then."""
    x, w, out = layer(128, 64, 128)
    with threads(2), using({OTHERWISE: "numpy"}):
        check(x, w, out, bind(x, w, out))
    assert taken == []


@pytest.mark.parametrize("spread", [True, False], ids=["spread", "repeated"])
def test_what_other_libraries_cannot_read_is_torchs(taken: list[str], spread: bool) -> None:
    """Numbers apart in both directions, and a line that stands for many."""
    x, w, out = layer(32, 16, 48)
    x = torch.randn(1, 64, 32)[:, ::2, ::2] if spread else torch.randn(1, 1, 16).expand(1, 32, 16)
    assert not fits(x)
    with threads(1), using({OTHERWISE: "numpy"}):
        bind(x, w, out)()
    assert taken == []
    torch.testing.assert_close(out, x @ w)


def test_the_choice_is_the_machine_s_until_another_is_given() -> None:
    """And again after a block that had its own; an unknown way is refused, and changes nothing."""
    assert choice() == machine().choice
    with using({OTHERWISE: "torch"}):
        assert choice() == {OTHERWISE: "torch"}
        with pytest.raises(KeyError, match="abacus"):
            use({OTHERWISE: "torch", "forward 128x128x128": "abacus"})
        assert choice() == {OTHERWISE: "torch"}
    assert choice() == machine().choice


@pytest.mark.skipif(not multiplies("bfloat16"), reason="this processor has no bfloat16 products")
@given(stack=st.integers(1, 3), shape=st.tuples(sides, sides, sides), left=layouts, right=layouts, written=outputs)
def test_products_of_bfloat16(
    stack: int, shape: tuple[int, int, int], left: Layout, right: Layout, written: Layout
) -> None:
    """And nothing else is but the sums on the way out."""
    rows, inner, columns = shape
    numbers = torch.randn(stack, rows, inner).bfloat16(), torch.randn(stack, inner, columns).bfloat16()
    a, b = left.place(numbers[0]), right.place(numbers[1])
    out = written.place(torch.zeros(stack, rows, columns, dtype=torch.bfloat16))
    bind(a, b, out)()
    expected = a.double() @ b.double()
    bound = (inner + 1) * 2.0**-23 * (a.double().abs() @ b.double().abs()) + 2.0**-8 * expected.abs()
    assert ((out - expected).abs() <= bound).all()


def test_torch_s_own_setting_rounds_nothing() -> None:
    """Products in float32 keep their digits whatever a process has set, and that setting is left alone."""
    x = torch.full((1, 64, 64), 1 + 2.0**-12)  # rounds to 1 in bfloat16
    out = torch.empty(1, 64, 64)
    torch.set_float32_matmul_precision("medium")
    try:
        with using({OTHERWISE: "torch"}):
            bind(x, x, out)()
        assert torch.get_float32_matmul_precision() == "medium"
    finally:
        torch.set_float32_matmul_precision("highest")
    torch.testing.assert_close(out, (x.double() @ x.double()).float(), rtol=1e-6, atol=0)
