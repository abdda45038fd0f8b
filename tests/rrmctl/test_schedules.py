"""Labels of feedback are read as they are written."""

import pytest

from rrmctl.planning.schedules import Schedule


@pytest.mark.parametrize("label", ["50@5000/2500", "5@20000/125 short segments"])
def test_a_label_is_read_back(label):
    """Queries, steps and budget, and the name of a schedule that sets more."""
    read = Schedule.of(label)
    assert str(read) == label
    assert read[:3] == tuple(int(number) for number in label.split()[0].replace("@", "/").split("/"))


@pytest.mark.parametrize(
    "label", ["-", "", "often", "50@5000", "50@5000/2500/1", "50@5000/2500 ", "0@0/0", "9" * 5000 + "@1/1"]
)
def test_what_is_no_schedule_is_none(label):
    """Where nothing is asked, or a record was written by hand, there is nothing to read."""
    assert Schedule.of(label) is None
