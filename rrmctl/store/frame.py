"""DataFrames whose columns have the same types whatever rows there are, in every version of pandas."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

#: Types of columns. Text is pandas' own `str` (pandas 2.3 knows it as well), missing where there is none.
TEXT, WHOLE, NUMBER = "str", "int64", "float64"
#: A whole number, or missing.
MAYBE_WHOLE = "Int64"


def frame(rows: Iterable[Any], kinds: Mapping[str, str]) -> pd.DataFrame:
    """Rows, as dicts or tuples, with these columns and types."""
    import pandas as pd

    return typed(pd.DataFrame(list(rows), columns=list(kinds)), kinds)


def typed(table: pd.DataFrame, kinds: Mapping[str, str] | None = None) -> pd.DataFrame:
    """The table with these types; other columns of Python's objects become text."""
    import pandas as pd

    text = pd.StringDtype(na_value=float("nan"))
    types = {str(name): TEXT for name in table.columns if table[name].dtype == object} | dict(kinds or {})
    return table.astype({name: text if kind == TEXT else kind for name, kind in types.items()})
