"""What a run ran with, and what had changed when it went on."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from rrm.devices import Card
from rrm.hardware import usable_cores
from rrm.tuning import OTHERWISE
from rrmctl.store import provenance
from rrmctl.store.files import DamagedError
from rrmctl.store.layout import Layout, RunFolder
from rrmctl.store.provenance import code_digest, collect, made_with, read_provenance, record

CONFIG = {"precision": "float32", "threads": 1, "task": "toy-car"}


def now(**changes: object) -> dict[str, object]:
    world, argv = {"metaworld": "3.1.1", "reward": "abc"}, ["rrmctl", "run", "toy-car"]
    told = collect(CONFIG, world, {OTHERWISE: "numpy"}, argv, attempt=1)
    return told | changes


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return Layout(tmp_path).run("r")


def test_the_first_attempt_is_recorded_whole(folder: RunFolder) -> None:
    """Versions, machine, code, environment, precision, threads, time and command are in the file."""
    assert record(folder, now()) == []
    told = json.loads(folder.provenance.read_text())
    assert set(now()) <= set(told)
    assert told["versions"]["numpy"][0].isdigit()
    assert told["fingerprint"] == {"metaworld": "3.1.1", "reward": "abc"}
    assert told["argv"] == ["rrmctl", "run", "toy-car"]


def test_a_run_on_a_card_names_it(folder: RunFolder, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another card on resumption is a change; runs on the processor say nothing of cards."""
    assert "card" not in now()

    def on(card: str) -> dict[str, object]:
        monkeypatch.setattr(provenance, "cards", lambda: (Card(0, card, 2**36),))
        return collect(CONFIG | {"device": "cuda"}, {}, {OTHERWISE: "numpy"}, [], attempt=1)

    assert record(folder, on("NVIDIA A")) == []
    assert record(folder, on("NVIDIA B")) == ["card: NVIDIA A -> NVIDIA B"]
    assert made_with(read_provenance(folder))["card"] == "NVIDIA A, then NVIDIA B"


def test_resuming_over_the_same_changes_nothing(folder: RunFolder) -> None:
    """Another time, host and attempt are circumstances, not changes; the resumption is noted."""
    record(folder, now())
    assert record(folder, now(host="other", started="later", attempt=2)) == []
    (again,) = json.loads(folder.provenance.read_text())["resumed"]
    assert (again["host"], again["attempt"], again["changes"]) == ("other", 2, {})


def test_every_change_is_told_once_with_both_values(folder: RunFolder) -> None:
    """A resumption is compared with the attempt before it, not with the first."""
    record(folder, now())
    assert record(folder, now(threads=2, fingerprint={"metaworld": "3.1.1", "reward": "xyz"})) == [
        "fingerprint.reward: abc -> xyz",
        "threads: 1 -> 2",
    ]
    assert record(folder, now(threads=2, fingerprint={"reward": "xyz"})) == ["fingerprint.metaworld: 3.1.1 -> absent"]
    assert record(folder, now(threads=2, fingerprint={"reward": "xyz"})) == []
    assert len(json.loads(folder.provenance.read_text())["resumed"]) == 3


def test_another_choice_of_products_is_one_change(folder: RunFolder) -> None:
    """It is told whole, however many products it speaks of."""
    record(folder, now(products={OTHERWISE: "mkl-avx2", "inputs 1x128x128": "torch", "forward 8x128x128": "torch"}))
    (told,) = record(folder, now())
    assert told == "products: mkl-avx2; torch for 1x128x128 inputs, 8x128x128 forward -> numpy"


def test_a_run_from_before_there_was_a_choice(folder: RunFolder) -> None:
    """It multiplied as torch does by itself; going on so is no change."""
    record(folder, {name: value for name, value in now().items() if name != "products"})
    assert (read_provenance(folder) or {})["products"] == {OTHERWISE: "torch"}
    assert record(folder, now(products={OTHERWISE: "torch"})) == []


@pytest.mark.parametrize("products", [[], {}, {OTHERWISE: 1}, {"inputs 1x128x128": "torch"}])
def test_a_choice_that_is_none_is_damage(folder: RunFolder, products: object) -> None:
    """Whoever reads it can rely on it."""
    record(folder, now() | {"products": {OTHERWISE: "torch"}})
    content = json.loads(folder.provenance.read_text()) | {"products": products}
    folder.provenance.write_text(json.dumps(content))
    with pytest.raises(DamagedError, match=r"provenance.json is damaged: .*products"):
        read_provenance(folder)


@pytest.mark.parametrize("trained", ["curve", "checkpoint"])
def test_what_earlier_attempts_ran_with_is_unknown_where_it_is_lost(folder: RunFolder, trained: str) -> None:
    """A run whose record was set aside is not taken for one made as its last attempt was."""
    record(folder, now())
    assert made_with(read_provenance(folder))["threads"] == "1"
    folder.provenance.unlink()
    getattr(folder, trained).mkdir()
    record(folder, now(threads=2))
    record(folder, now(threads=3))
    told = made_with(read_provenance(folder))
    assert told["threads"] == "unknown, then 2, then 3"
    assert told["fingerprint.reward"] == "unknown, then abc"
    assert "lost" not in told


def test_the_code_digest_follows_names_and_contents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A changed, renamed or added module changes it; other files do not."""
    package = tmp_path / "somepackage"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "a.py").write_text("x = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    seen = {code_digest("somepackage")}
    (package / "notes.txt").write_text("nothing")
    assert {code_digest("somepackage")} == seen
    (package / "a.py").write_text("x = 2\n")
    seen.add(code_digest("somepackage"))
    (package / "a.py").rename(package / "b.py")
    seen.add(code_digest("somepackage"))
    assert len(seen) == 3


@pytest.mark.parametrize(("quota", "cores"), [("max 100000", None), ("50000 100000", 1), ("100000000000 100000", None)])
def test_cores_respect_the_container_s_quota(tmp_path: Path, quota: str, cores: int | None) -> None:
    """Half a core is one worker; a quota beyond the machine's cores means all of them."""
    path = tmp_path / "cpu.max"
    path.write_text(quota)
    everything = usable_cores(tmp_path / "absent")
    assert usable_cores(path) == (cores or everything)
