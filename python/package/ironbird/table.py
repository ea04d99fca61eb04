"""Tables: rows with named columns, and frames of pandas and Polars."""

from __future__ import annotations

import html
import importlib
from collections.abc import Iterator, Mapping, Sequence
from itertools import accumulate
from typing import Any, overload

SHOWN_ROWS = 20
SHOWN_CHARACTERS = 110


def library(name: str, what: str, otherwise: str = "") -> Any:
    """A package that this module does not require."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise ImportError(f"{what} needs {name.split('.')[0]}: pip install {name.split('.')[0]}{otherwise}") from error


def pandas(columns: Mapping[str, Any]) -> Any:
    """A DataFrame of pandas."""
    return library("pandas", "to_pandas()", ", or use to_polars()").DataFrame(dict(columns))


def polars(columns: Mapping[str, Any]) -> Any:
    """A DataFrame of Polars."""
    return library("polars", "to_polars()", ", or use to_pandas()").DataFrame(dict(columns))


class Table(Sequence[dict[str, Any]]):
    """Rows, each a dict by the names of the columns; None where there is no value."""

    def __init__(self, rows: Sequence[dict[str, Any]], document: Mapping[str, Any] | None = None) -> None:
        self.columns = list(dict.fromkeys(name for row in rows for name in row))
        self._rows = [{name: row.get(name) for name in self.columns} for row in rows]
        self.document = document or {}
        """All that the command reports, as with `--format json`."""

    @overload
    def __getitem__(self, index: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, index: slice) -> list[dict[str, Any]]: ...
    def __getitem__(self, index: int | slice) -> dict[str, Any] | list[dict[str, Any]]:
        return self._rows[index]

    def __len__(self) -> int:
        return len(self._rows)

    def __iter__(self) -> Iterator[dict[str, Any]]:
        return iter(self._rows)

    def column(self, name: str) -> list[Any]:
        """The values of a column."""
        if name not in self.columns:
            raise KeyError(f"there is no column {name!r}; there are {', '.join(self.columns)}")
        return [row[name] for row in self._rows]

    def to_pandas(self) -> Any:
        """The rows as a DataFrame of pandas."""
        return pandas({name: self.column(name) for name in self.columns})

    def to_polars(self) -> Any:
        """The rows as a DataFrame of Polars."""
        return polars({name: self.column(name) for name in self.columns})

    def _shown(self) -> list[list[str]]:
        def text(value: Any) -> str:
            return "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)

        rows = [[text(value) for value in row.values()] for row in self._rows[:SHOWN_ROWS]]
        return [self.columns, *rows]

    def _rest(self) -> str:
        return f"{len(self)} rows, {len(self.columns)} columns: {', '.join(self.columns)}"

    def __repr__(self) -> str:
        shown = self._shown()
        widths = [max(map(len, cells)) for cells in zip(*shown, strict=True)]
        fitting = sum(end <= SHOWN_CHARACTERS for end in accumulate(width + 2 for width in widths))
        lines = ("  ".join(map(str.ljust, cells[:fitting], widths)).rstrip() for cells in shown)
        return "\n".join([*lines, f"[{self._rest()}]"])

    def _repr_html_(self) -> str:
        head, *rows = self._shown()

        def line(cells: list[str], tag: str) -> str:
            return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

        body = "".join(line(row, "td") for row in rows)
        return f"<table><thead>{line(head, 'th')}</thead><tbody>{body}</tbody></table><p>{html.escape(self._rest())}</p>"


def flat(values: Mapping[str, Any], path: str = "") -> dict[str, Any]:
    """The values of nested mappings by their paths, as in `error.rms_m`."""
    result: dict[str, Any] = {}
    for name, value in values.items():
        result |= flat(value, f"{path}{name}.") if isinstance(value, Mapping) else {f"{path}{name}": value}
    return result
