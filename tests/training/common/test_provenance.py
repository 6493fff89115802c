"""Tests of the provenance of results."""

import subprocess
import sys

from tests.support import ROOT


def test_the_commit_is_found_through_a_catkin_workspaces_link(tmp_path):
    """rosrun imports the package through the symbolic link in the workspace."""
    (tmp_path / "applr_ros1").symlink_to(ROOT)

    def commit(path):
        script = (
            "import sys; sys.path.insert(0, %r); "
            "from training.common import provenance; print(provenance.commit())"
        )
        done = subprocess.run(
            [sys.executable, "-c", script % str(path)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout.strip()

    assert commit(tmp_path / "applr_ros1") == commit(ROOT)
