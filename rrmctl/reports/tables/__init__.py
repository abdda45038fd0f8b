"""The tables: each module here is a `rrmctl report` command.

A module has

- a docstring, which is the command's help,
- `EXPERIMENTS`, those that are read where none is named; an empty tuple reads all,
- `EXPLAINED`, sentences that `rrmctl report explain` says; notes of a report are what is particular to it alone,
- `COLUMNS`, what the table consists of, raw and in words,
- `make(sections, settings) -> list[Report]`, the tables of these sections, or a `NoDataError` where there is none, and
- where it has options of its own, `OPTIONS`, a literal with their names in `rrmctl.cli.report`.
"""

from rrmctl.reports.plugins import Entry, entries


def kinds() -> dict[str, Entry]:
    """The tables, by name."""
    return entries(__file__, __name__)


def explained(table: str | None = None) -> dict[str, tuple[str, ...]]:
    """Sentences that hold of a table, or of every one, by its name, and those that hold of all."""
    from rrmctl.reports.report import EXPLAINED

    own = {name: entry.load().EXPLAINED for name, entry in kinds().items() if table in (None, "all", name)}
    return {title: sentences for title, sentences in (own | {"all tables": EXPLAINED}).items() if sentences}
