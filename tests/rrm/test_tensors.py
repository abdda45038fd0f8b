"""Tensors in a file: exact, and every changed bit is noticed."""

import json

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st

from rrm.tensors import pack, unpack

ARRAYS = {
    "a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.array(2.5), "none": np.zeros((0, 4), np.float32),
    "flags": np.array([True, False]), "c": np.arange(3),
}  # fmt: skip
TOLD = {"format": "x", "nested": {"ä": [1, 2.5, None], "a": float("nan")}, "z": 0}


def same(arrays, told):
    assert repr(told) == repr(TOLD)  # the order, too
    assert arrays.keys() == ARRAYS.keys()
    for name, array in arrays.items():
        assert (array.dtype, array.shape) == (ARRAYS[name].dtype, ARRAYS[name].shape)
        assert array.tobytes() == ARRAYS[name].tobytes()


def test_what_is_written_is_read():
    """Types, shapes, bits and what is said; equal content is equal bytes."""
    same(*unpack(pack(ARRAYS, "told", TOLD), "told"))
    assert len({pack(ARRAYS, "told", TOLD) for _ in range(20)}) == 1


def test_files_without_a_checksum_are_read():
    """Earlier versions wrote none."""
    same(*unpack(safetensors.numpy.save(ARRAYS, {"told": json.dumps(TOLD)}), "told"))


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_a_flipped_bit_is_refused_or_changes_nothing(data):
    """Wherever it is: values, names, types, shapes and text."""
    good = pack(ARRAYS, "told", TOLD)
    at = data.draw(st.integers(0, len(good) - 1))
    flipped = bytearray(good)
    flipped[at] ^= 1 << data.draw(st.integers(0, 7))
    try:
        arrays, told = unpack(bytes(flipped), "told")
    except ValueError:
        return
    same(arrays, {name: value for name, value in told.items() if name in TOLD})  # the checksum's own name may differ


@pytest.mark.parametrize(
    "content", [b"", b"hello", safetensors.numpy.save({}), safetensors.numpy.save({}, {"told": "[]"})]
)
def test_what_is_no_such_file_is_refused(content):
    """Whatever it is instead."""
    with pytest.raises(ValueError, match=r"."):
        unpack(content, "told")
