"""What runs are called, in one place: where nothing is asked, nothing is said."""

from __future__ import annotations

from rrmctl.labels import NOTHING_ASKED, Label, knows, panels
from rrmctl.store.sweeps import Job

ASKING = Label("toy-car", "pebble", "oracle", "5@50/20")
SILENT = Label("toy-car", "oracle")


def test_a_label_says_what_is_asked() -> None:
    """For tables, panels and single runs; records of earlier programs leave teacher and feedback empty."""
    assert (str(ASKING), str(SILENT)) == ("toy-car, pebble (oracle, 5@50/20)", "toy-car, oracle")
    assert (ASKING.place, SILENT.place) == ("toy-car (oracle, 5@50/20)", "toy-car")
    assert ASKING.words == ("toy-car", "pebble", "oracle", "5@50/20")
    assert SILENT.words == Label("toy-car", "oracle", "", "").words == ("toy-car", "oracle")


def test_a_run_is_called_by_its_row_and_seed() -> None:
    """The store's records say it as labels do."""
    job = Job(id="0" * 16, cell="1" * 16, **ASKING._asdict(), seed=3, steps=10)
    assert (job.row, job.label) == (ASKING, "toy-car pebble oracle 5@50/20 seed 3")
    assert SILENT.seeded(0) == "toy-car oracle seed 0"


def test_what_asks_nothing_is_in_every_panel_of_its_task() -> None:
    """In the order of the plan, each label once; alone where nothing of its task asks."""
    noisy, other = ASKING._replace(teacher="noisy"), Label("door-open", "oracle")
    assert panels([SILENT, ASKING, ASKING, other, noisy]) == {
        ASKING[:1] + ASKING[2:]: [SILENT, ASKING],
        noisy[:1] + noisy[2:]: [SILENT, noisy],
        ("door-open", NOTHING_ASKED, NOTHING_ASKED): [other],
    }


def test_who_learns_from_the_true_reward() -> None:
    """The oracle and its variants."""
    assert [knows(name) for name in ("oracle", "oracle-bfloat16", "rrm-oracle", "pebble")] == [True, True, False, False]
