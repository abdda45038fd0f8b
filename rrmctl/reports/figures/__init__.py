"""The figures: each module here is drawn by `rrmctl plot` for every section that it suits.

A module has

- a docstring, whose first line `rrmctl plot --help` shows,
- `suits(section) -> bool`, whether the section has what the figure shows, and
- `draw(section, settings) -> Figure`, a matplotlib figure, as `rrmctl.reports.figure_layout.sheet` makes it of panels;
  what it needs of matplotlib comes from there, where it is imported out of reach of a `matplotlibrc`.
"""

from rrmctl.reports.plugins import Entry, entries


def figures() -> dict[str, Entry]:
    """The figures, by name."""
    return entries(__file__, __name__)
