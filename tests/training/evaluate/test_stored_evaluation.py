"""Test that the report of the evaluation in tests/golden/evaluation equals the stored report letter
by letter.

After a deliberate change, `python -m tests.training.evaluate.test_stored_evaluation` rewrites
report.txt.
"""

import shutil
import tempfile
from pathlib import Path

from tests.support import ROOT
from training.evaluate.report import summary, write
from training.evaluate.stored import Results

STORED = ROOT / "tests" / "golden" / "evaluation"


def report(folder):
    """Return the sentences above the tables, and the tables, as text."""
    copy = Path(shutil.copytree(STORED, folder / "evaluation"))
    write(copy)
    parts = [*summary(Results(copy))]
    for table in sorted((copy / "report").glob("*.csv")):
        parts.append(f"\n{table.name}\n{table.read_text()}")
    return "\n".join(parts)


def test_the_report_of_a_stored_evaluation_is_the_stored_one(tmp_path):
    assert report(tmp_path).splitlines() == (STORED / "report.txt").read_text().splitlines()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        (STORED / "report.txt").write_text(report(Path(place)))
