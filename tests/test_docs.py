"""Test of the documentation site, which builds without warnings such as those of broken links."""

import subprocess
import sys

import pytest

from tests.support import HANGS, ROOT


@pytest.mark.slow
@pytest.mark.skipif(
    sys.version_info < (3, 11), reason="requirements/docs.txt is for Python 3.11 and later"
)
def test_the_site_builds(tmp_path):
    # -W: warnings are errors; --keep-going shows all of them.
    options = ["-q", "-W", "--keep-going", "-d", tmp_path / "trees"]
    command = [sys.executable, "-m", "sphinx", *options, "docs", tmp_path]
    finished = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=HANGS
    )
    assert finished.returncode == 0, finished.stderr
    assert (tmp_path / "index.html").is_file()
