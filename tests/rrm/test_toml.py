"""TOML of anybody's: what takes `tomllib` minutes is refused, what looks like it is not."""

from __future__ import annotations

import re

import pytest

from rrm.toml import DEEPEST, loads

LONG = 36_000
BOMBS = {
    "a key": "a." * LONG + "a = 1",
    "quoted parts": r'"\"".' * LONG + "a = 1",
    "other quotes": "'.'." * LONG + "a = 1",
    "spaces": "a . \t" * LONG + "a = 1",
    "a table": f"x = 1\n[{'a.' * LONG}a]",
    "a table in a list": f"[[{'a.' * LONG}a]]",
    "an inline table": f"x = {{ {'a.' * LONG}a = 1 }}",
    "lists": f"x = {'[' * 100_000}",
    "tables": "x = " + "{a=" * LONG,
    "digits": "x = " + "1" * 250_000,
    "a quote without end": '"' + r"\"" * 100_000,
    "words without end": ("a" * 100 + " ") * 2000,
    "quotes": "\"'" * 100_000,
}  # fmt: skip


@pytest.mark.parametrize("text", BOMBS.values(), ids=BOMBS)
def test_what_nests_without_end_is_refused(text: str) -> None:
    """At once: a square of any of these lengths would be minutes and gigabytes."""
    with pytest.raises(ValueError, match=r"nested too deeply|not valid TOML"):
        loads(text)


def test_the_line_is_named() -> None:
    """A key of too many parts is said to be one, and where."""
    with pytest.raises(ValueError, match=re.escape("a key of more than 20 parts in line 2")):
        loads("x = 1\n" + "a." * DEEPEST + "a = 1")


def test_dots_that_part_no_key() -> None:
    """Numbers, texts and paths may have any number of dots, and a key twenty parts."""
    key = "a." * (DEEPEST - 1) + "a"
    read = loads(f"{key} = 1\nnumbers = {[0.5] * 100}\nprose = '{'And so on... ' * 100}'\npath = '{'../' * 100}x.py'")
    assert {*read} == {"a", "numbers", "prose", "path"}
