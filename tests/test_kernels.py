"""The compile cache of numba kernels: never out of date, shared by versions side by side, safe among processes.

Each case runs in processes of its own, on a package of three files in which a kernel takes a function and a constant
from others.
"""

import importlib
import os
import pkgutil
import subprocess
import sys

import pytest
from numba.core.dispatcher import Dispatcher

from applr_ros1.common import kernels
from applr_ros1.common.kernel_digest import digest

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
FILES = {
    "outer.py": """
from applr_ros1.common.kernels import kernel
from inner import offset

@kernel
def outer(x):
    return offset(x) + later(x)

@kernel
def later(x):
    return 0 * x
""",
    "inner.py": """
import numbers_of_it
from applr_ros1.common.kernels import kernel

@kernel(error_model="numpy")
def offset(x):
    '''The sum of x and the constant.'''
    return x + numbers_of_it.OFFSET
""",
    "numbers_of_it.py": "OFFSET = 1\n",
}
RUN = """
import sys, outer
for word in sys.argv[1:]:
    print(outer.outer(eval(word, {})), end=" ")
print(sum(outer.outer.stats.cache_misses.values()))
"""


@pytest.fixture
def start(tmp_path):
    """A function that starts a process on a version of the small package, which it writes if the folder is new."""

    def start(folder, *arguments):
        place = tmp_path / folder
        if not place.exists():
            place.mkdir()
            for name, text in FILES.items():
                (place / name).write_text(text)
        environment = dict(os.environ, PYTHONPATH="%s:%s" % (ROOT, place), XDG_CACHE_HOME=str(tmp_path / "cache"))
        environment.pop("NUMBA_CACHE_DIR", None)
        environment["TMPDIR"] = str(tmp_path)
        return subprocess.Popen(
            [sys.executable, "-B", "-c", RUN, *arguments], env=environment, stdout=subprocess.PIPE, text=True
        )

    return start


def result(process):
    """What `outer` returned for each argument, and how many of its overloads had to be compiled."""
    out = process.communicate(timeout=120)[0]
    assert process.returncode == 0, out
    *values, compiled = out.split()
    return [float(value) for value in values], int(compiled)


def edit(path, old, new):
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_a_changed_callee_or_constant_is_noticed_and_a_docstring_is_not(start, tmp_path):
    assert result(start("code", "5")) == ([6], 1)
    edit(tmp_path / "code" / "inner.py", "The sum of x and the constant.", "x, and\n    one more")
    assert result(start("code", "5")) == ([6], 0)
    edit(tmp_path / "code" / "inner.py", "x + numbers", "10 * x + numbers")
    assert result(start("code", "5")) == ([51], 1)
    edit(tmp_path / "code" / "numbers_of_it.py", "1", "2")
    assert result(start("code", "5")) == ([52], 1)
    edit(tmp_path / "code" / "outer.py", "return 0 * x", "return 100 * x")  # defined below the kernel that calls it
    assert result(start("code", "5")) == ([552], 1)


def test_two_versions_side_by_side(start, tmp_path):
    assert result(start("old", "5")) == ([6], 1)
    assert result(start("new", "5")) == ([6], 0)  # the same source in another place is the same kernel
    edit(tmp_path / "new" / "numbers_of_it.py", "1", "2")
    assert result(start("new", "5")) == ([7], 1)
    assert result(start("old", "5")) == ([6], 0)  # neither replaces the other
    assert result(start("new", "5")) == ([7], 0)


def test_processes_fill_one_folder_together(start):
    arguments = ["5", "5.5", "True", "__import__('numpy').float32(5)"]
    expected = dict(zip(arguments, (6.0, 6.5, 2.0, 6.0)))
    together = [start("code", *(arguments[k:] + arguments[:k])) for k in range(4)]
    for k, process in enumerate(together):
        values, _ = result(process)
        assert values == [expected[word] for word in arguments[k:] + arguments[:k]]
    assert result(start("code", *arguments)) == ([expected[word] for word in arguments], 0)


def test_a_damaged_file_is_compiled_anew_and_a_folder_open_to_others_not_used(start, tmp_path):
    folder = tmp_path / "cache" / "applr_ros1" / "kernels"
    assert result(start("code", "5")) == ([6], 1)
    for path in folder.iterdir():
        path.write_bytes(path.read_bytes()[:100])
    assert result(start("code", "5")) == ([6], 1)
    assert result(start("code", "5")) == ([6], 0)
    folder.chmod(0o777)  # anybody could have put machine code there
    assert result(start("code", "5")) == ([6], 1)
    assert len(list(tmp_path.glob("applr_ros1-kernels-*/outer.outer-*"))) == 1


def test_a_user_without_a_home_gets_no_folder_in_the_current_one(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(kernels.os.path, "expanduser", lambda path: path)  # as where the user has no entry either
    monkeypatch.setattr(kernels.tempfile, "gettempdir", lambda: str(tmp_path / "tmp"))
    assert kernels.cache_folder.__wrapped__() == str(tmp_path / "tmp" / ("applr_ros1-kernels-%d" % os.getuid()))
    assert os.listdir(tmp_path) == ["tmp"]


def test_the_files_of_a_kernel_are_bounded(monkeypatch, tmp_path):
    monkeypatch.setattr(kernels, "cache_folder", lambda: str(tmp_path))

    @kernels.kernel
    def same(x):
        return x

    names = ["%s-%032d.nbc" % (same._cache._name, number) for number in range(40)]
    for number, name in enumerate(names):
        (tmp_path / name).write_bytes(b"")
        os.utime(tmp_path / name, (number, number))
    assert same(3) == 3
    left = {path.name for path in tmp_path.iterdir()}
    assert len(left) == kernels.KEPT
    assert len(left - set(names)) == 1  # the new one
    assert set(names[-kernels.KEPT + 1 :]) <= left


def test_every_kernel_of_the_package_can_be_kept():
    found = 0
    for package in ("applr_ros1.planner", "applr_ros1.policy", "sim_bridge", "worlds"):
        for module in pkgutil.walk_packages(importlib.import_module(package).__path__, package + "."):
            with open(module.module_finder.find_spec(module.name).origin, encoding="utf-8") as file:
                text = file.read()
            assert "njit" not in text, "%s: the decorator is applr_ros1.common.kernels.kernel" % module.name
            if "@kernel" not in text:
                continue
            for name, value in vars(importlib.import_module(module.name)).items():
                if isinstance(value, Dispatcher):
                    found += 1
                    assert digest(value), "%s.%s uses a global of an unknown kind" % (module.name, name)
    assert found > 90
