"""docs/human.md says of labels, widths and options what the code does."""

import contextlib
import io
import re
from dataclasses import fields
from pathlib import Path

import pytest

from rrm.teachers.labels import Label

PAGE = (Path(__file__).parent.parent / "docs" / "human.md").read_text()


def rows(heading):
    """The cells of the table below a heading row."""
    table = PAGE.split(heading)[1].split("\n\n")[0]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def test_the_columns_are_those_of_a_label():
    """Every column of the file, in its order and with its type."""
    told = [(name.strip("`"), kind) for name, kind, _ in rows("| column | type | |")]
    assert told == [(field.name, str(field.type)) for field in fields(Label)]


@pytest.mark.slow
def test_the_widths_are_those_that_the_command_prints():
    """The page's table and its command, to what rounding may change."""
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(code, {})
    numbers = [[float(number) for number in re.findall(r"[\d.]+", line)] for line in printed.getvalue().splitlines()]
    for told, found in zip(rows("| people | 10 shared"), numbers, strict=True):
        assert [float(cell) for cell in told] == pytest.approx(found, abs=0.011)
