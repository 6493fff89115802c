"""Machine code that is kept between processes: compiled anew after any change, private, filled by several at once.

Each case runs in processes of its own, on a copy of the decorator's file with a package of two kernels.
"""

import os
import resource
import shutil
import subprocess
import sys

import pytest

from applr_ros1.common import kernels
from tests.support import HANGS

OUTER = """
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.inner import offset

@kernel
def outer(x):
    return offset(x)
"""
INNER = """
from applr_ros1.common.kernels import kernel
OFFSET = 1

@kernel(error_model="numpy")
def offset(x):
    return x + OFFSET
"""
RUN = """
from applr_ros1.planner.outer import outer
print(outer(5), outer(5.5), sum(outer.stats.cache_misses.values()))
"""


@pytest.fixture
def start(tmp_path):
    """A function that starts a process on a version of the small package, which it writes if the folder is new."""

    def start(folder, **options):
        planner, common = (tmp_path / folder / "applr_ros1" / name for name in ("planner", "common"))
        if not planner.exists():
            planner.mkdir(parents=True)
            common.mkdir()
            shutil.copy(kernels.__file__, common)
            (planner / "outer.py").write_text(OUTER)
            (planner / "inner.py").write_text(INNER)
        folders = {"PYTHONPATH": tmp_path / folder, "XDG_CACHE_HOME": tmp_path / "cache", "TMPDIR": tmp_path}
        environment = dict(os.environ, **{name: str(path) for name, path in folders.items()})
        environment.pop("NUMBA_CACHE_DIR", None)
        command = [sys.executable, "-B", "-c", RUN]
        return subprocess.Popen(command, env=environment, cwd=tmp_path, stdout=subprocess.PIPE, text=True, **options)

    return start


def result(process):
    """What `outer` returned for 5 and for 5.5, and how many of the two had to be compiled."""
    out = process.communicate(timeout=HANGS)[0]
    assert process.returncode == 0
    return [float(word) for word in out.split()]


def test_a_change_in_another_file_is_noticed_and_versions_lie_side_by_side(start, tmp_path):
    assert result(start("old")) == [6, 6.5, 2]
    (tmp_path / "link").symlink_to("old")
    assert result(start("link")) == [6, 6.5, 0]
    assert result(start("new")) == [6, 6.5, 2]
    (tmp_path / "new" / "applr_ros1" / "planner" / "inner.py").write_text(INNER.replace("OFFSET = 1", "OFFSET = 2"))
    assert result(start("new")) == [7, 7.5, 2]
    assert result(start("new")) == [7, 7.5, 0]
    monitor = tmp_path / "old" / "applr_ros1" / "monitor"
    monitor.mkdir()
    (monitor / "other.py").write_text("A = 1")
    assert result(start("old")) == [6, 6.5, 0]  # neither version nor another package counts


def test_processes_fill_one_folder_together_and_one_open_to_others_is_not_used(start, tmp_path):
    together = [start("code") for _ in range(4)]
    assert [result(process)[:2] for process in together] == [[6, 6.5]] * 4
    assert result(start("code")) == [6, 6.5, 0]
    (tmp_path / "cache" / "applr_ros1").chmod(0o777)  # anybody could have put machine code there
    assert [result(start("code")) for _ in range(2)] == [[6, 6.5, 2], [6, 6.5, 0]]
    assert len(list(tmp_path.glob("applr_ros1-*/*"))) == 1


def test_a_full_disk_costs_the_cache_alone(start, tmp_path):
    def no_byte_more():
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    process = start("code", preexec_fn=no_byte_more, stderr=subprocess.PIPE)
    out, said = process.communicate(timeout=HANGS)
    assert out.split() == ["6", "6.5", "2"]
    assert f"{tmp_path}/cache/applr_ros1/" in said
    assert "every start compiles anew" in said
    assert [result(start("code")) for _ in range(2)] == [[6, 6.5, 2], [6, 6.5, 0]]


def test_a_user_without_a_home_gets_no_folder_in_the_current_one(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(kernels.os.path, "expanduser", lambda path: path)  # as where the user has no entry either
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    folder = kernels.cache_folder.__wrapped__(kernels.PACKAGES[0])
    assert os.path.dirname(folder) == str(tmp_path / "tmp" / f"applr_ros1-{os.getuid()}")
    assert os.listdir(tmp_path) == ["tmp"]


def test_folders_of_old_versions_are_removed(monkeypatch, tmp_path):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    folders = [tmp_path / "applr_ros1" / f"{number:016}" for number in range(40)]
    for number, folder in enumerate(folders):
        folder.mkdir(parents=True)
        os.utime(folder, (number, number))
    made = kernels.cache_folder.__wrapped__(kernels.PACKAGES[0])
    left = {str(path) for path in (tmp_path / "applr_ros1").iterdir()}
    assert left == {made, *map(str, folders[17:])}
