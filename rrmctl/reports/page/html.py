"""HTML, escaped unless it is HTML already."""

from __future__ import annotations

import html
from collections.abc import Iterable

_VOID = ("img", "meta", "br")


class Html(str):
    """Text that is HTML. Every other text is escaped where it is put into an element."""

    __slots__ = ()


def element(name: str, /, *children: str | None, **attributes: str | float | bool | None) -> Html:
    """An element with its content; None is no child.

    Args:
        attributes: an underscore stands for a dash, one at the end for nothing (`class_`); True is an attribute without
            a value, None and False are no attribute.
    """
    told = "".join(
        f" {key.rstrip('_').replace('_', '-')}" + ("" if value is True else f'="{html.escape(str(value))}"')
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    return Html(f"<{name}{told}>" if name in _VOID else f"<{name}{told}>{joined(children)}</{name}>")


def folded(summary: str, *children: str | None) -> Html:
    """What is shown when its summary is pressed."""
    return element("details", element("summary", summary), *children)


def joined(children: Iterable[str | None]) -> Html:
    """Pieces one after the other."""
    return Html("".join(map(escape, filter(None, children))))


def escape(text: str) -> Html:
    """The text as HTML that shows it."""
    return text if isinstance(text, Html) else Html(html.escape(text))


def identifier(*words: str) -> str:
    """An id from words, to be used after a number sign: letters, digits and dashes. Other signs become their code."""
    return "-".join("".join(map(_plain, word)) for word in words)


def _plain(sign: str) -> str:
    if sign.isalnum() and sign.isascii():
        return sign
    return "-" if sign in " -_." else f"-{ord(sign):x}-"
