"""Tests of the provenance of results."""

import subprocess
import sys

from tests.support import ROOT
from training.common import provenance


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


def test_the_hash_of_the_sources_changes_with_text_and_name(tmp_path, monkeypatch):
    monkeypatch.setattr(provenance, "ROOT", tmp_path)
    for package_name in provenance.OURS:
        (tmp_path / package_name).mkdir()
    source_file = tmp_path / "training" / "one.py"
    hashes = set()
    for text in ("A = 1", "A = 2"):
        source_file.write_text(text)
        hashes.add(provenance.source_hash())
        hashes.add(provenance.source_hash())
    source_file.rename(source_file.with_name("two.py"))
    hashes.add(provenance.source_hash())
    assert len(hashes) == 3
