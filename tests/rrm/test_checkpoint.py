"""Checkpoints: exact, atomic, and honest about damage."""

import json

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rrm import checkpoint
from rrm.checkpoint import AppendLog, Checkpoints, decode, encode
from rrm.errors import CheckpointError, ConfigError

arrays = hnp.arrays(
    st.sampled_from([np.float32, np.float64, np.int64, np.uint8, np.bool_]), hnp.array_shapes(min_dims=0, max_dims=3)
)
leaves = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text(max_size=5) | arrays
trees = st.dictionaries(
    st.text(min_size=1, max_size=5).filter(lambda k: not k.startswith("$")),
    st.recursive(leaves, lambda x: st.lists(x, max_size=3) | st.dictionaries(st.text(max_size=3), x, max_size=3)),
    max_size=4,
)


def same(a, b):
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return a == b and type(a) is type(b)


@given(trees)
def test_a_state_survives_bit_for_bit(state):
    """What was encoded is decoded: types, shapes, bits."""
    assert same(state, decode(encode(state)))


def test_tensors_stay_tensors():
    """A tensor comes back as a tensor, a scalar one as a scalar."""
    state = decode(encode({"t": torch.arange(3.0), "s": torch.tensor(2.5)}))
    assert torch.equal(torch.arange(3.0), state["t"])
    assert state["s"].shape == ()


def test_an_object_is_refused_with_its_place():
    """Anything that would need a pickle is a programming error that names the leaf."""
    with pytest.raises(TypeError, match="state/a/0: a state cannot hold a object"):
        encode({"a": [object()]})


def test_newest_two_are_kept(tmp_path):
    """Older checkpoints go; the newest is loaded."""
    checkpoints = Checkpoints(tmp_path)
    for step in (10, 20, 30):
        checkpoints.save(step, {"step": step})
    seen = []
    assert checkpoints.load(seen.append) == 30
    assert seen == [{"step": 30}]
    assert len(list(tmp_path.glob("*.json"))) == 2


@pytest.mark.parametrize("kind", ["marker", "state"])
def test_every_truncation_falls_back_to_the_one_before(tmp_path, kind):
    """A file cut at any length is noticed, reported, removed, and the previous checkpoint is used."""
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(10, {"x": torch.ones(4)})
    checkpoints.save(20, {"x": torch.zeros(4)})
    name = "state-000000000020" + (".json" if kind == "marker" else ".safetensors")
    whole = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for length in range(0, len(whole[name]), 7):
        for path, data in whole.items():
            (tmp_path / path).write_bytes(data)
        (tmp_path / name).write_bytes(whole[name][:length])
        assert checkpoints.load(lambda _: None) == 10
        assert len(checkpoints.skipped) == 1
        assert not (tmp_path / "state-000000000020.json").exists()
        assert (tmp_path / "damaged-state-000000000020.json").exists()


def test_a_file_that_cannot_be_read_now_is_not_damage(tmp_path, monkeypatch):
    """Too many open files, a stale mount: the error goes up and every checkpoint stays."""
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(10, {})

    def refuse(path, limit):
        raise OSError(24, "Too many open files", str(path))

    before = sorted(tmp_path.iterdir())
    monkeypatch.setattr("rrm.checkpoint.read_bounded", refuse)
    with pytest.raises(OSError, match="Too many open files"):
        checkpoints.load(lambda _: None)
    assert sorted(tmp_path.iterdir()) == before


def test_flipped_bytes_are_noticed(tmp_path):
    """One flipped bit anywhere in the state is damage."""
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(10, {"x": torch.ones(4)})
    path = tmp_path / "state-000000000010.safetensors"
    data = bytearray(path.read_bytes())
    data[-3] ^= 4
    path.write_bytes(data)
    assert checkpoints.load(lambda _: None) is None
    assert "checksum" in checkpoints.skipped[0]


def test_a_state_that_does_not_restore_falls_back(tmp_path):
    """When the owner of a log finds it damaged, the checkpoint before is tried."""
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(10, {"good": True})
    checkpoints.save(20, {"good": False})

    def restore(state):
        if not state["good"]:
            raise CheckpointError("the log is torn")

    assert checkpoints.load(restore) == 10


@pytest.mark.parametrize("version", [1, 99])
def test_another_format_is_refused_not_removed(tmp_path, monkeypatch, version):
    """A checkpoint of another version stays, and the message says which version wrote it. The first had no seal."""
    checkpoints = Checkpoints(tmp_path)
    with monkeypatch.context() as other:
        other.setattr(checkpoint, "FORMAT", version)
        checkpoints.save(10, {})
    marker = tmp_path / "state-000000000010.json"
    if version == 1:
        marker.write_text(
            json.dumps({key: value for key, value in json.loads(marker.read_text()).items() if key != "checksum"})
        )
    with pytest.raises(ConfigError, match=f"format {version}, this version reads {checkpoint.FORMAT}"):
        checkpoints.load(lambda _: None)
    assert marker.exists()


@pytest.mark.parametrize("entry", ["format", "step", "size", "crc32", "checksum"])
def test_a_marker_that_was_changed_is_damaged(tmp_path, entry):
    """No number in it can turn into another one and be believed."""
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(10, {"step": 10})
    checkpoints.save(20, {"step": 20})
    marker = tmp_path / "state-000000000020.json"
    told = json.loads(marker.read_text())
    marker.write_text(json.dumps(told | {entry: told[entry] + 1}))
    found = []
    assert checkpoints.load(found.append) == 10
    assert found == [{"step": 10}]


def test_what_a_process_left_that_died_while_it_wrote_goes(tmp_path):
    """Temporary files, and states without marker: one that was never written, or one that is set aside."""
    checkpoints = Checkpoints(tmp_path)
    for step in (10, 20):
        checkpoints.save(step, {"step": step})
    (tmp_path / ".state-000000000030.safetensors.1.tmp").write_bytes(b"half")
    (tmp_path / "state-000000000030.safetensors").write_bytes(encode({}))
    (tmp_path / "state-000000000020.json").write_bytes(b"{")
    (tmp_path / "transitions.bin").touch()
    for _ in range(2):
        assert checkpoints.load(lambda _: None) == 10
    left = {"damaged-state-000000000020.json", "transitions.bin"}
    left |= {f"state-000000000010.{suffix}" for suffix in ("json", "safetensors")}
    assert {path.name for path in tmp_path.iterdir()} == left


@given(st.lists(st.binary(max_size=20), max_size=6), st.binary(max_size=9), st.data())
def test_a_log_restores_any_committed_prefix(tmp_path_factory, chunks, torn, data):
    """Bytes behind the committed length, from a process that died, are ignored and overwritten."""
    path = tmp_path_factory.mktemp("log") / "log.bin"
    log = AppendLog(path)
    marks = []
    for chunk in chunks:
        log.append(chunk)
        marks.append((log.size, log.crc))
    if not marks:
        return
    with path.open("ab") as file:
        file.write(torn)
    size, crc = data.draw(st.sampled_from(marks))
    again = AppendLog(path)
    assert b"".join(again.restore(size, crc, 1)) == b"".join(chunks)[:size]
    again.append(b"new")
    assert path.read_bytes() == b"".join(chunks)[:size] + b"new"


def test_a_damaged_log_is_refused(tmp_path):
    """Missing, short or changed logs raise."""
    log = AppendLog(tmp_path / "log.bin")
    log.append(b"hello")
    (tmp_path / "log.bin").write_bytes(b"hellO")
    with pytest.raises(CheckpointError, match="checksum"):
        list(AppendLog(tmp_path / "log.bin").restore(log.size, log.crc, 1))
    with pytest.raises(CheckpointError, match="No such file"):
        list(AppendLog(tmp_path / "none.bin").restore(1, 0, 1))


def test_a_log_comes_back_in_whole_records(tmp_path, monkeypatch):
    """No block cuts a record, whatever fits into one; a log cut inside a record is damaged."""
    monkeypatch.setattr(checkpoint, "_BLOCK", 10)
    log = AppendLog(tmp_path / "log.bin")
    log.append(bytes(range(21)))
    assert [len(block) for block in AppendLog(tmp_path / "log.bin").restore(log.size, log.crc, 3)] == [9, 9, 3]
    (tmp_path / "log.bin").write_bytes(bytes(range(20)))
    with pytest.raises(CheckpointError, match="checksum"):
        list(AppendLog(tmp_path / "log.bin").restore(log.size, log.crc, 3))
