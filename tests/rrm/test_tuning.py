"""What is measured of products: once for each machine, whatever becomes of those who measure, and what follows."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import pytest

from rrm import tuning
from rrm.tuning import (
    EXACT,
    FORMS,
    OTHERWISE,
    ROUNDED,
    SEEING,
    SHAPES,
    Machine,
    cell,
    cells,
    in_words,
    kept_in,
    machine,
    measure,
)

CELLS = [cell(form, shape) for form in FORMS for shape in SHAPES]
RATES = {way: dict.fromkeys(cells(way), 1e9 + at) for at, way in enumerate([*EXACT, ROUNDED, *SEEING.values()])}
FOUND = Machine(RATES, {})


def standin(folder: Path, before: str = "") -> tuple[str, ...]:
    """What measures in no time, and leaves a line in `measured`."""
    program = f"import json, sys, time; open({str(folder / 'measured')!r}, 'a').write('once\\n'); rates = {RATES}\n"
    program += f"for way in sys.argv[1:]:\n {before}\n print(json.dumps(dict(way=way, rates=rates[way], refused='')))"
    return (sys.executable, "-c", program)


@pytest.fixture
def fresh(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], tuple[Machine, int]]:
    """What a new process would find with an empty cache folder, and how often was measured until then."""
    monkeypatch.setattr(tuning, "TRIAL", standin(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    measured = tmp_path / "measured"
    return lambda: (machine.__wrapped__(), len(measured.read_text().split()) if measured.exists() else 0)


def test_what_was_measured_is_kept(fresh: Callable[[], tuple[Machine, int]]) -> None:
    """Who comes later reads it, and writes nothing: the folder may be another user's."""
    assert fresh() == fresh() == (FOUND, 1)
    kept_in().with_suffix(".lock").unlink()
    assert fresh() == (FOUND, 1)
    assert list(kept_in().parent.iterdir()) == [kept_in()]


def without_a_cell(content: dict[str, dict[str, dict[str, float]]]) -> None:
    del content["rates"]["torch"][CELLS[3]]


def with_no_number(content: dict[str, dict[str, dict[str, float]]]) -> None:
    content["rates"]["numpy"][CELLS[3]] = float("nan")


def with_an_unknown_way(content: dict[str, dict[str, dict[str, float]]]) -> None:
    content["rates"]["abacus"] = content["rates"]["torch"]


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b'{"rates": {}}', b'{"rates": 7}', b"[" * 5000, b"\xff"])
def test_a_damaged_file_is_measured_anew(fresh: Callable[[], tuple[Machine, int]], content: bytes) -> None:
    """And is whole again."""
    fresh()
    kept_in().write_bytes(content)
    assert fresh() == (FOUND, 2)
    assert fresh() == (FOUND, 2)


@pytest.mark.parametrize("change", [without_a_cell, with_no_number, with_an_unknown_way])
def test_a_foreign_file_is_measured_anew(
    fresh: Callable[[], tuple[Machine, int]], change: Callable[[object], None]
) -> None:
    """What it lacks, or has too much, nobody could go by."""
    fresh()
    content = json.loads(kept_in().read_bytes())
    change(content)
    kept_in().write_text(json.dumps(content))
    assert fresh() == (FOUND, 2)


@pytest.mark.parametrize("obstacle", ["cache", "cache/rrm", "no home"])
def test_where_nothing_can_be_kept(
    fresh: Callable[[], tuple[Machine, int]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, obstacle: str
) -> None:
    """It is measured, once in each process."""
    if obstacle == "no home":
        monkeypatch.delenv("XDG_CACHE_HOME")

        def nobody() -> Path:
            raise RuntimeError("Could not determine home directory.")

        monkeypatch.setattr(Path, "home", nobody)
    else:
        (tmp_path / obstacle).parent.mkdir(exist_ok=True)
        (tmp_path / obstacle).write_text("a file")
    assert fresh() == (FOUND, 1)
    assert fresh() == (FOUND, 2)
    assert not kept_in().exists()


def test_processes_that_start_together_measure_once(tmp_path: Path) -> None:
    """The others wait for the first, and take what it found."""
    trial = standin(tmp_path, before="time.sleep(0.1)")
    program = (
        f"from rrm import tuning; tuning.TRIAL = {trial!r}; print(tuning.machine() == tuning.Machine({RATES}, {{}}))"
    )
    own = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    command = [sys.executable, "-c", program]
    started = [subprocess.Popen(command, env=own, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    assert [process.communicate()[0] for process in started] == ["True\n"] * 3
    assert (tmp_path / "measured").read_text() == "once\n"


def test_another_machine_has_another_file(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processor, instructions, versions, and what steers a library; not how many threads it has."""
    for name in [name for name in os.environ if name.startswith(("MKL_", "ONEDNN_", "DNNL_"))]:
        monkeypatch.delenv(name)
    files = [kept_in()]
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.setenv("MKL_NUM_THREADS", "7")
    assert kept_in() == files[0]
    monkeypatch.setenv("ONEDNN_MAX_CPU_ISA", "AVX2")
    files.append(kept_in())
    monkeypatch.setattr(tuning, "version", lambda name: f"{name} 99")
    files.append(kept_in())
    monkeypatch.setattr(tuning, "cpu_model", lambda: "Another")
    files.append(kept_in())
    monkeypatch.setattr(tuning, "extensions", lambda: frozenset({"mmx"}))
    files.append(kept_in())
    assert len(set(files)) == len(files)


def test_without_products_of_torch_there_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    """A torch that does not load is said, with its own words."""
    monkeypatch.setattr(tuning, "TRIAL", (sys.executable, "-c", "import torch_that_is_broken"))
    with pytest.raises(
        RuntimeError, match=r"could not be measured \(exit code 1\)(.|\n)*ModuleNotFoundError: .*broken"
    ):
        measure()


def test_only_what_is_clearly_quicker_leaves_the_quickest() -> None:
    """A product goes its own way where that gains more than a measurement errs."""
    close, clear = CELLS[0], CELLS[1]
    numpy = dict.fromkeys(CELLS, 10.0)
    torch = dict.fromkeys(CELLS, 1.0) | {close: 11.0, clear: 12.0}
    assert Machine({"torch": torch, "numpy": numpy}).choice == {OTHERWISE: "numpy", clear: "torch"}
    assert Machine({"torch": torch, "numpy": numpy, ROUNDED: dict.fromkeys(CELLS, 99.0)}).choice[OTHERWISE] == "numpy"


def test_an_earlier_choice_is_kept_where_its_ways_are_here() -> None:
    """All of it or nothing: a mixture would compute as neither."""
    here = Machine({way: RATES[way] for way in ("torch", "numpy", ROUNDED)}, {})
    earlier = {OTHERWISE: "torch", CELLS[0]: "numpy"}
    assert here.keep(earlier) == earlier
    for gone in ("mkl-avx2", "abacus", ROUNDED):
        assert here.keep(earlier | {CELLS[1]: gone}) == here.choice
    assert here.keep(None) == here.choice


def test_a_choice_in_words() -> None:
    """The way of most products first, then those of the others, whatever the order in which they were found."""
    assert in_words({OTHERWISE: "numpy"}) == "numpy"
    choice = {"inputs 8x9x9": "torch", OTHERWISE: "numpy", "inputs 1x2x3": "mkl-avx2", "forward 8x9x9": "torch"}
    choice |= {f"{form} 1x9x9": "torch" for form in FORMS}
    assert in_words(choice) == "numpy; mkl-avx2 for 1x2x3 inputs; torch for 1x9x9, 8x9x9 forward/inputs"


def test_what_is_written_is_what_is_read(fresh: Callable[[], tuple[Machine, int]]) -> None:
    """Reasons for refusing a way included."""
    fresh()
    found = Machine({"torch": RATES["torch"]}, {"numpy": "trying it ended by SIGSEGV"})
    kept_in().write_text(json.dumps(asdict(found)))
    assert fresh() == (found, 1)
