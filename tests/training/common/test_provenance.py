"""Tests of the provenance of results."""

import subprocess
import sys

from tests.support import ROOT


def test_the_commit_is_found_through_a_catkin_workspaces_link(tmp_path):
    """rosrun imports the package through the symbolic link in the workspace."""
    (tmp_path / "applr_ros1").symlink_to(ROOT)

    def commit(path):
        """Return the commit that a process names which imports the package from this path."""
        script = (
            "import sys; sys.path.insert(0, %r); "
            "from training.common import provenance; print(provenance.commit())"
        )
        finished = subprocess.run(
            [sys.executable, "-c", script % str(path)],
            # Outside the repository, so that it is not found by the folder of the process.
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        return finished.stdout.strip()

    assert commit(tmp_path / "applr_ros1") == commit(ROOT)
