"""The rows of faults, the tests that they name, and the tables of README.md and docs/faults.md belong together."""

import ast
import json

from tests.faults import soak, table
from tests.faults.rows import ROWS

NAMED = {"tests/" + test for row in ROWS for test in row.tests}


def functions_of(path):
    """The test functions of a file as tests/file.py::function."""
    nodes = ast.parse(path.read_text(encoding="utf-8")).body
    names = [node.name for node in nodes if isinstance(node, ast.FunctionDef) and node.name.startswith("test_")]
    return {"%s::%s" % (path.relative_to(table.ROOT).as_posix(), name) for name in names}


def test_every_fault_has_a_test_and_every_test_a_fault():
    assert {str(number) for number in range(1, 26)} <= {row.number for row in ROWS}
    assert len({row.number for row in ROWS}) == len(ROWS)
    there = {
        function for file in {test.partition("::")[0] for test in NAMED} for function in functions_of(table.ROOT / file)
    }
    assert there >= NAMED
    own = [path for path in table.HERE.glob("test_*.py") if path.name != "test_table.py"]
    assert {function for path in own for function in functions_of(path)} <= NAMED


def test_figures_are_of_these_tests():
    measured = json.loads(table.MEASURED.read_text(encoding="utf-8"))
    assert set(measured) <= NAMED
    without = [
        row.number
        for row in ROWS
        if any(test.startswith("faults/") for test in row.tests) and not table.figures(row, measured)
    ]
    assert without == ["6"]  # what a person changed is there or not


def test_the_pages_show_the_table():
    for page, text in table.pages().items():
        assert text == (table.ROOT / page).read_text(encoding="utf-8"), "%s: run python -m tests.faults.table" % page


def test_the_soak_finds_a_leak_and_a_restart():
    rows = [(60.0 * n, 30.0 * n, "leaking", 7, 100.0 + n / 6.0, 20 + n // 30, 5) for n in range(61)]
    rows += [(60.0 * n, 30.0 * n, "steady", 8 + (n > 40), 50.0, 10, 5) for n in range(61)]
    table_of = soak.summary(rows)
    assert table_of["leaking"]["mb_per_hour"] == 10.0
    assert table_of["leaking"]["descriptors"] == [20, 22]
    assert table_of["leaking"]["opening"]
    assert not table_of["steady"]["opening"]
    assert (table_of["steady"]["mb_per_hour"], table_of["steady"]["restarts"]) == (0.0, 1)
