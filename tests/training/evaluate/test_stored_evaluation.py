"""Test that the report of the evaluation in tests/golden/evaluation equals the stored report letter
by letter.

The trials were driven by evaluate.py: worlds generated:0 to 11 and physical_course, methods dwa,
static and applr, two trials each in PyBullet; evaluation.json has all settings. report.txt is what
the report said of them when a person read it; test_training_report.py compares its statistics with
scipy's. After a deliberate change, `python -m tests.training.evaluate.test_stored_evaluation`
rewrites report.txt.
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
    evaluation = Path(shutil.copytree(STORED, folder / "evaluation"))
    write(evaluation)
    paragraphs = [*summary(Results(evaluation))]
    for table_file in sorted((evaluation / "report").glob("*.csv")):
        paragraphs.append(f"\n{table_file.name}\n{table_file.read_text()}")
    return "\n".join(paragraphs)


def test_the_report_of_a_stored_evaluation_is_the_stored_one(tmp_path):
    assert report(tmp_path).splitlines() == (STORED / "report.txt").read_text().splitlines()


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        (STORED / "report.txt").write_text(report(Path(folder)))
