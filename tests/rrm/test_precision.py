"""The precision of a run is one of two; "auto" is read off the processor."""

from pathlib import Path

import pytest
from pydantic import ValidationError

from rrm import precision
from tests.rrm.training.test_run_config import run


@pytest.mark.parametrize(("flags", "best"), [("fpu amx_bf16", "bfloat16"), ("fpu avx512_bf16", "float32")])
def test_auto_is_what_the_machine_has(monkeypatch: pytest.MonkeyPatch, flags: str, best: str) -> None:
    """What is stored, and enters the identity, is the arithmetic and not the word."""
    monkeypatch.setattr(precision, "extensions", lambda: frozenset(flags.split()))
    precision.native_precision.cache_clear()
    try:
        assert run(precision="auto").precision == best
        assert run(precision="auto").identity == run(precision=best).identity
    finally:
        precision.native_precision.cache_clear()


def test_precision_is_part_of_the_identity() -> None:
    """The two are different runs and different cells; float32 is the default."""
    assert run().identity == run(precision="float32").identity != run(precision="bfloat16").identity
    assert run().cell != run(precision="bfloat16").cell


def test_an_unknown_precision_is_refused() -> None:
    """Half precision is none of ours."""
    with pytest.raises(ValidationError, match="float32"):
        run(precision="float16")


def test_a_system_that_does_not_tell(tmp_path: Path) -> None:
    """Without a description of the processor there are no extensions."""
    assert precision.extensions(tmp_path / "absent") == frozenset()
