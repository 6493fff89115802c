"""Makes the tables of faults in README.md and docs/faults.md from rows.py and measured.json.

    ./applr exec python -m tests.faults.table              # writes both tables
    ./applr exec python -m tests.faults.table --check      # exit status 1 if they are not those

measured.json comes from `./applr test --faults-table tests/faults/measured.json`.
"""

import argparse
import json
import sys
from pathlib import Path

from tests.faults.rows import ROWS, SECTIONS

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
MEASURED = HERE / "measured.json"
PASSES = "passes"  # a row whose tests measure nothing
BEGIN, END = "<!-- the table of faults: made by python -m tests.faults.table -->", "<!-- end of the table -->"


def figures(row, measured):
    """The measured figures of a row in words; those of several tests with one name as from the least to the most."""
    found = {}
    for test in row.tests:
        for what, (value, unit) in measured.get("tests/" + test, {}).items():
            if not row.figures or what in row.figures:
                found.setdefault((what, unit), []).append(value)
    texts = []
    for (what, unit), values in found.items():
        low, high = min(values), max(values)
        amount = "%.3g" % high if low == high else "%.3g to %.3g" % (low, high)
        texts.append(("%s: %s %s" % (what, amount, unit)).rstrip())
    return "; ".join(texts)


def short(measured):
    """README's table: fault, what happens, figures."""
    lines = ["| | fault | what happens | measured |", "|---|---|---|---|"]
    lines += [
        "| %s | %s | %s | %s |" % (row.number, row.fault, row.outcome, figures(row, measured) or PASSES) for row in ROWS
    ]
    return "\n".join(lines)


def long(measured):
    """The table of docs/faults.md: the same by sections, with the tests."""
    lines = []
    for title, rows in SECTIONS.items():
        lines += ["## " + title, "", "| | fault | what happens | measured | tests |", "|---|---|---|---|---|"]
        for row in rows:
            tests = ", ".join("`tests/%s`" % test.partition("::")[0] for test in row.tests)
            tests = ", ".join(dict.fromkeys(tests.split(", ")))
            lines.append(
                "| %s | %s | %s | %s | %s |"
                % (row.number, row.fault, row.outcome, figures(row, measured) or PASSES, tests)
            )
        lines.append("")
    return "\n".join(lines).rstrip()


def pages():
    """{page: its text with the table that rows and figures make}."""
    measured = json.loads(MEASURED.read_text(encoding="utf-8"))
    texts = {}
    for name, table in (("README.md", short(measured)), ("docs/faults.md", long(measured))):
        text = (ROOT / name).read_text(encoding="utf-8")
        before, _, rest = text.partition(BEGIN)
        texts[name] = before + BEGIN + "\n\n" + table + "\n\n" + END + rest.partition(END)[2]
    return texts


def main(arguments=None):
    """The command. Returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="Write nothing; say whether the tables are up to date.")
    check = parser.parse_args(arguments).check
    old = [name for name, text in pages().items() if text != (ROOT / name).read_text(encoding="utf-8")]
    for name in old:
        if check:
            print("%s: its table of faults is out of date: run python -m tests.faults.table" % name, file=sys.stderr)
        else:
            (ROOT / name).write_text(pages()[name], encoding="utf-8")
    return 1 if check and old else 0


if __name__ == "__main__":
    sys.exit(main())
