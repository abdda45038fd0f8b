"""Trying ways to a product: wrong ones are refused, and one that ends its process costs no other."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial

import pytest
import torch
from torch import Tensor

from rrm import tuning
from rrm.nets import trial
from rrm.nets.ways import MklKernel, Work
from rrm.tuning import EXACT, FORMS, SEEING, SHAPES, cell, cells, measure


def rounded(a: Tensor, b: Tensor, out: Tensor) -> Work:
    return lambda: out.copy_(a.bfloat16() @ b.bfloat16())


def slightly_rounded(a: Tensor, b: Tensor, out: Tensor) -> Work:
    return lambda: out.copy_(torch.bmm(a.half().float(), b))


def adding(a: Tensor, b: Tensor, out: Tensor) -> Work:
    """As BLAS does, asked wrongly: to what is there already."""
    return lambda: out.fill_(1.0).baddbmm_(a, b)


def not_a_number(a: Tensor, b: Tensor, out: Tensor) -> Work:
    return partial(out.fill_, torch.nan)


@pytest.mark.parametrize("way", [rounded, slightly_rounded, adding, not_a_number])
def test_a_way_that_is_not_exact_is_refused(
    monkeypatch: pytest.MonkeyPatch, way: Callable[[Tensor, Tensor, Tensor], Work]
) -> None:
    """The reason names the product and the error."""
    monkeypatch.setitem(trial.WAYS, "torch", way)  # type: ignore[arg-type]
    rates, refused = trial.attempt("torch")
    assert rates == {}
    assert f"not exact: {cell('forward', SHAPES[0])} is off by " in refused


def test_an_exact_way_has_a_rate_for_every_product(monkeypatch: pytest.MonkeyPatch) -> None:
    """In operations a second."""
    monkeypatch.setattr(trial, "SHAPES", SHAPES[:2])
    rates, refused = trial.attempt("torch")
    assert refused == ""
    assert list(rates) == [cell(form, shape) for shape in SHAPES[:2] for form in FORMS]
    assert all(1e6 < rate < 1e14 for rate in rates.values())


def test_others_who_want_the_processor_are_not_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    """A way that waits is not slow."""
    monkeypatch.setattr(trial, "_TURN_S", 0.0)
    assert trial._seconds(lambda: time.sleep(0.05)) < 0.02


def test_convolutions_are_measured_in_either_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    """In operations a second, where the processor has it."""
    for precision, way in SEEING.items():
        rates, refused = trial.attempt(way)
        assert (rates.keys() == cells(way) and not refused) or (precision == "bfloat16" and refused)
        assert all(1e6 < rate < 1e14 for rate in rates.values())
    monkeypatch.setattr(trial, "multiplies", lambda precision: precision == "float32")
    assert trial.attempt(SEEING["bfloat16"]) == ({}, "this processor or this torch does not have it")


def test_what_is_not_there_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A symbol that this torch does not have is not called, nor one that the processor could not execute."""
    for way in (MklKernel("mkl_blas_no_such_xsgemm", frozenset()), MklKernel("sgemm_", frozenset({"avx9"}))):
        monkeypatch.setitem(trial.WAYS, "mkl-avx2", way)  # type: ignore[arg-type]
        assert trial.attempt("mkl-avx2") == ({}, "this processor or this torch does not have it")


#: Two shapes; `onednn` does what is asked of it, and `numpy` writes to standard output meanwhile.
PROGRAM = """
import os, signal, sys, time
from rrm.nets import trial

def ending(a, b, out):
    return lambda: {0}

def talking(a, b, out):
    os.write(1, b"one of a library's own lines")
    return trial.WAYS["torch"](a, b, out)

trial.SHAPES, trial._TURN_S, trial._PATIENCE_S = trial.SHAPES[:1], 0, {1}
trial.WAYS = {{**trial.WAYS, "onednn": ending, "numpy": talking}}
trial.main(sys.argv[1:], trial.alone())
"""


@pytest.mark.parametrize(
    ("action", "ended"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "by SIGSEGV"),
        pytest.param("time.sleep(600)", "by SIGALRM", marks=pytest.mark.slow),
    ],
)
def test_a_way_that_ends_its_process_is_refused(monkeypatch: pytest.MonkeyPatch, action: str, ended: str) -> None:
    """With how it ended; the ways after it are tried all the same, and what a library says does not disturb."""
    patience = 20 if ended == "by SIGALRM" else 120  # of each way, however busy the machine
    monkeypatch.setattr(tuning, "TRIAL", (sys.executable, "-c", PROGRAM.format(action, patience)))
    found = measure()
    assert found.refused["onednn"] == f"trying it ended {ended}"
    assert {"torch", "numpy"} <= set(found.rates)
    assert set(found.rates) | set(found.refused) == {*EXACT, tuning.ROUNDED, *tuning.SEEING.values()}


@pytest.mark.slow
def test_a_way_that_fails_is_a_fault_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is said as the process said it, and nothing is taken for measured."""
    monkeypatch.setattr(tuning, "TRIAL", (sys.executable, "-c", PROGRAM.format("1 / 0", 120)))
    with pytest.raises(RuntimeError, match="ZeroDivisionError"):
        measure()
