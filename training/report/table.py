"""A table that can be written as CSV and HTML. tables.py and tables_more.py fill them, page.py writes them."""

from __future__ import annotations

import csv
import html
import io
from dataclasses import dataclass
from typing import Dict, List, Sequence

import numpy as np

NONE = "–"


@dataclass
class Table:
    """name: of its file and in the page; rows of strings as long as columns; notes: sentences under it."""

    name: str
    title: str
    columns: List[str]
    rows: List[List[str]]
    notes: Sequence[str] = ()

    @classmethod
    def of(
        cls, name: str, title: str, rows: Sequence[Dict[str, str]], *notes: str, of_paper: Sequence[str] = ()
    ) -> Table:
        """A table of rows that name their columns, all the same ones in the same order.

        Columns whose names begin with "paper", and the notes `of_paper`, are left out where no row has a value in them.
        """
        cited = [c for c in (rows[0] if rows else ()) if c.startswith("paper") and any(row[c] != NONE for row in rows)]
        columns = [c for c in (rows[0] if rows else ()) if c in cited or not c.startswith("paper")]
        shown = [[row[column] for column in columns] for row in rows]
        return cls(name, title, columns, shown, [*notes, *(of_paper if cited else ())])

    def csv(self) -> str:
        """The table as CSV with a header line."""
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([self.columns, *self.rows])
        return buffer.getvalue()

    def html(self) -> str:
        """The table in HTML, its title above and its notes below; a wide one scrolls in its own box."""

        def line(tag: str, row: Sequence[str]) -> str:
            return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in row)}</tr>"

        head, body = line("th", self.columns), "".join(line("td", row) for row in self.rows)
        notes = "".join(f"<p class=note>{html.escape(note)}</p>" for note in self.notes)
        title = f"<h2 id={self.name}>{html.escape(self.title)}</h2>"
        table = f"<table><thead>{head}</thead><tbody>{body}</tbody></table>"
        return f"{title}<div class=wide>{table}</div>{notes}"


def number(value: float, digits: int = 2) -> str:
    """A number with so many decimals, NONE where there is none."""
    return f"{value:.{digits}f}" if np.isfinite(value) else NONE


def span(low: float, high: float, digits: int = 2) -> str:
    """An interval with so many decimals, NONE where there is none."""
    return f"{low:.{digits}f} to {high:.{digits}f}" if np.isfinite(low) else NONE


def share(n: int, total: int) -> str:
    """How many of all, also in percent; NONE of nothing."""
    return f"{n} ({n / total:.0%})".replace("%", " %") if total else NONE
