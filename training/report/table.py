"""A table that can be written as CSV, LaTeX, Markdown and HTML. tables.py fills them, page.py writes them."""

from __future__ import annotations

import csv
import html
import io
from dataclasses import dataclass, field
from typing import Dict, List, Sequence

import numpy as np

NONE = "–"


@dataclass
class Table:
    """name: of its files; rows of strings as long as columns; notes: sentences under it."""

    name: str
    title: str
    columns: List[str]
    rows: List[List[str]] = field(default_factory=list)
    notes: List[str] = field(default_factory=list)

    @classmethod
    def of(cls, name: str, title: str, rows: Sequence[Dict[str, str]], *notes: str) -> Table:
        """A table of rows that name their columns, all the same ones in the same order."""
        return cls(name, title, list(rows[0]) if rows else [], [list(row.values()) for row in rows], list(notes))

    def csv(self) -> str:
        """The table as CSV with a header line."""
        buffer = io.StringIO()
        csv.writer(buffer, lineterminator="\n").writerows([self.columns] + self.rows)
        return buffer.getvalue()

    def markdown(self) -> str:
        """The table in Markdown, its notes below."""

        def line(cells):
            return "| %s |\n" % " | ".join(c.replace("|", "\\|") for c in cells)

        rule = "|%s|\n" % "|".join(["---"] + ["---:"] * (len(self.columns) - 1))
        notes = "".join("\n%s\n" % n for n in self.notes)
        return "### %s\n\n%s%s%s%s" % (self.title, line(self.columns), rule, "".join(map(line, self.rows)), notes)

    def html(self) -> str:
        """The table in HTML, its title above and its notes below."""

        def cells(tag, row):
            return "<tr>%s</tr>" % "".join("<%s>%s</%s>" % (tag, html.escape(c), tag) for c in row)

        notes = "".join("<p class=note>%s</p>" % html.escape(n) for n in self.notes)
        return "<h2 id=%s>%s</h2><table><thead>%s</thead><tbody>%s</tbody></table>%s" % (
            self.name,
            html.escape(self.title),
            cells("th", self.columns),
            "".join(cells("td", r) for r in self.rows),
            notes,
        )

    def latex(self) -> str:
        """The table as a LaTeX tabular, its notes below."""

        def line(cells):
            return "%s \\\\\n" % " & ".join(map(_latex, cells))

        notes = "".join("\n\\par\\footnotesize %s" % _latex(n) for n in self.notes)
        return "".join(
            [
                "\\begin{table}\n\\centering\n\\caption{%s}\n" % _latex(self.title),
                "\\begin{tabular}{l%s}\n\\toprule\n" % ("r" * (len(self.columns) - 1)),
                line(self.columns),
                "\\midrule\n",
                "".join(map(line, self.rows)),
                "\\bottomrule\n\\end{tabular}",
                notes,
                "\n\\end{table}\n",
            ]
        )


_MATH = {"±": r"\pm", "θ": r"\theta", "<": "<", ">": ">", "×": r"\times", "²": "^2", "³": "^3"}
_LATEX = {
    **{c: "\\" + c for c in "&%#_${}"},
    **{c: "$%s$" % code for c, code in _MATH.items()},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "–": "--"},
}


def _latex(text: str) -> str:
    return "".join(_LATEX.get(c, c) for c in text)


def number(value: float, digits: int = 2) -> str:
    """A number with so many decimals, NONE where there is none."""
    return "%.*f" % (digits, value) if np.isfinite(value) else NONE


def span(low: float, high: float, digits: int = 2) -> str:
    """An interval with so many decimals, NONE where there is none."""
    return "%.*f to %.*f" % (digits, low, digits, high) if np.isfinite(low) else NONE


def share(n: int, total: int) -> str:
    """How many of all, also in percent; NONE of nothing."""
    return "%d (%.0f %%)" % (n, 100.0 * n / total) if total else NONE
