"""The documentation site builds without a warning, and so with links that lead somewhere; promises name their tests."""

import re
import subprocess
import sys

import pytest

from tests.support import HANGS, ROOT


@pytest.mark.slow
@pytest.mark.skipif(sys.version_info < (3, 11), reason="requirements/docs.txt is for Python 3.11 and later")
def test_the_site_builds(tmp_path):
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", tmp_path / "trees", "docs", tmp_path]
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=HANGS)
    assert built.returncode == 0, built.stderr
    assert (tmp_path / "index.html").is_file()


def test_the_tests_that_show_the_monitors_promises_exist():
    page = (ROOT / "docs" / "explanation" / "collision_monitor.md").read_text(encoding="utf-8")
    folders = [path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")]
    names = re.findall(r"`(test_\w+)(?:\.\.\.)?`", page)
    assert len(names) > 8
    assert [name for name in names if not any("def " + name in text for text in folders)] == []
    table = (ROOT / "docs" / "results" / "faults.csv").read_text(encoding="utf-8")
    faults = re.findall(r"\b\d\d[a-e]?\b", " ".join(re.findall(r"\| .*faults? ([\d a-e,to]+)", page)))
    assert len(faults) > 5
    assert [number for number in faults if f",{number}," not in table] == []
