"""Tests of the disk cache of machine code: its keys, privacy, and use by several processes at once.

The tests start new processes that use a copy of kernels.py and kernel_cache.py in a temporary
package with two kernels.
"""

import os
import pickle
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numba
import pytest

from applr_ros1.common import kernel_cache, kernels
from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes.tools import compile_kernels
from applr_ros1.planner.navfn.window import set_fence
from tests.support import HANGS, ROOT

# Modules of the temporary package: a kernel that calls three kernels of another file, one of them
# inlined and one with a record of its own file, and one call of it each with an integer and a float
OUTER = """
from typing import NamedTuple
from applr_ros1.common.kernels import kernel
from applr_ros1.planner import (  # The names of a long import stand on lines of their own.
    inner,
)

class Limits(NamedTuple):
    lowest: int
    highest: int

@kernel
def outer(x):
    return inner.offset(inner.same(x)) + inner.lowest_of(Limits(0, 9))
"""
INNER = """
from applr_ros1.common.kernels import kernel
OFFSET = 1

@kernel(error_model="numpy")
def offset(x):
    return x + OFFSET

@kernel(inline="always")
def same(x):
    return x

@kernel
def lowest_of(limits):
    return limits.lowest
"""
CALLS = """
import sys
from applr_ros1.planner.outer import outer
assert "numba" not in sys.modules, "the import of a kernel waits for numba"
print(outer(5), outer(5.5), sum(outer.dispatcher.stats.cache_misses.values()))
"""
# Program that compiles what the set-up compiles, drives, and prints which kernels got new
# signatures
DRIVE = """
import sys
from applr_ros1.common.kernels import Kernel
from applr_ros1.nodes.tools.compile_kernels import DRIVES, PARTS
from training.env.settings import TrialSettings
from training.evaluate.runner import TrialRunner
from training.evaluate.trial import plan_trials

for _, compile_part in (*PARTS, *DRIVES):
    compile_part()

def kernels():
    modules = [module for name, module in sys.modules.items() if name.startswith(OURS)]
    found = {}
    for module in modules:
        for value in vars(module).values():
            if isinstance(value, Kernel):
                found[f"{value.__module__}.{value.__name__}"] = value.dispatcher
    return found

OURS = "applr_ros1", "sim_bridge", "worlds"
before = {name: len(dispatcher.signatures) for name, dispatcher in kernels().items()}
rules = {"robot": sys.argv[1], "monitor": True, "movers": True, "time_limit": 15.0}
(trial,) = plan_trials([("dynamic:0", "dynamic:0")], [("random", "random")], 1, seed=0)
result = TrialRunner(TrialSettings(simulator="pybullet", **rules)).run(trial)
assert result.path_length_m > 1.0, result
after = {name: len(dispatcher.signatures) for name, dispatcher in kernels().items()}
print([name for name, count in after.items() if count != before.get(name)])
"""


# one robot for each local planner
@pytest.mark.parametrize(
    "robot", ["jackal", pytest.param("turtlebot3_waffle_pi", marks=pytest.mark.slow)]
)
def test_after_the_setup_a_drive_compiles_nothing(robot):
    """The first drive would otherwise stand still for each kernel that it needs, .4 s and more."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", DRIVE, robot]
    driven = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=HANGS)
    assert driven.stdout.strip() == "[]", driven.stdout + driven.stderr


@pytest.fixture
def start(tmp_path):
    """Return start(folder), which starts a process with the package in `folder`.

    The package is written if it is missing.
    """

    def start(folder, **options):
        planner = tmp_path / folder / "applr_ros1" / "planner"
        common = tmp_path / folder / "applr_ros1" / "common"
        if not planner.exists():
            planner.mkdir(parents=True)
            common.mkdir()
            shutil.copy(kernels.__file__, common)
            shutil.copy(kernel_cache.__file__, common)
            (planner / "outer.py").write_text(OUTER)
            (planner / "inner.py").write_text(INNER)
        environment = dict(
            os.environ,
            PYTHONPATH=str(tmp_path / folder),
            XDG_CACHE_HOME=str(tmp_path / "cache"),
            TMPDIR=str(tmp_path),
        )
        # The cache's own folder is under test.
        environment.pop("NUMBA_CACHE_DIR", None)
        # -B: bytecode is no part of the test, and would be written into the package.
        command = [sys.executable, "-B", "-c", CALLS]
        return subprocess.Popen(
            command, env=environment, cwd=tmp_path, stdout=subprocess.PIPE, text=True, **options
        )

    return start


def result(process):
    """Return the results of `outer` for 5 and 5.5, and how many of the two calls had to compile."""
    output, _ = process.communicate(timeout=HANGS)
    assert process.returncode == 0
    return [float(number) for number in output.split()]


def test_a_copy_starts_warm_and_a_change_in_another_file_is_noticed(start, tmp_path):
    assert result(start("old")) == [6, 6.5, 2]
    assert result(start("new")) == [6, 6.5, 0]
    inner_file = tmp_path / "new" / "applr_ros1" / "planner" / "inner.py"
    inner_file.write_text(INNER.replace("OFFSET = 1", "OFFSET = 2"))
    assert result(start("new")) == [7, 7.5, 2]
    # Both are in the cache.
    assert result(start("new")) == [7, 7.5, 0]
    assert result(start("old")) == [6, 6.5, 0]


def test_a_change_of_the_options_of_all_kernels_is_noticed(start, tmp_path):
    assert result(start("code")) == [6, 6.5, 2]
    kernels_file = tmp_path / "code" / "applr_ros1" / "common" / "kernels.py"
    kernels_file.write_text(kernels_file.read_text() + "# Kernels get other options.\n")
    assert result(start("code")) == [6, 6.5, 2]


def test_a_change_of_the_order_of_fields_is_noticed_by_a_kernel_that_takes_any_record(
    start, tmp_path
):
    assert result(start("code")) == [6, 6.5, 2]
    outer_file = tmp_path / "code" / "applr_ros1" / "planner" / "outer.py"
    other_order = OUTER.replace("lowest: int\n    highest: int", "highest: int\n    lowest: int")
    outer_file.write_text(other_order.replace("Limits(0, 9)", "Limits(9, 0)"))
    assert result(start("code")) == [6, 6.5, 2]


def test_threads_that_call_a_kernel_first_together_make_one_dispatcher(monkeypatch):
    njit = numba.njit

    def slow_njit(**options):
        time.sleep(0.1)
        return njit(**options)

    monkeypatch.setattr(numba, "njit", slow_njit)
    new_kernel = kernels.Kernel(set_fence.py_func, {})
    # Until Python 3.11 cached_property itself has a lock, so its function is called.
    make_dispatcher = kernels.Kernel.dispatcher.func
    with ThreadPoolExecutor() as pool:
        first_dispatcher, second_dispatcher = pool.map(make_dispatcher, [new_kernel] * 2)
    assert first_dispatcher is second_dispatcher


@pytest.mark.slow
def test_processes_fill_one_folder_together_and_one_open_to_others_is_not_used(start, tmp_path):
    processes = [start("code") for _ in range(2)]
    for process in processes:
        assert result(process)[:2] == [6, 6.5]
    assert result(start("code")) == [6, 6.5, 0]

    # Anybody could have put machine code there, so another folder is filled.
    (tmp_path / "cache" / "applr_ros1").chmod(0o777)
    assert result(start("code")) == [6, 6.5, 2]
    assert result(start("code")) == [6, 6.5, 0]
    # Two kernels for two types, and one. The inlined one has no machine code of its own.
    assert len(list(tmp_path.glob("applr_ros1-*/applr_ros1.*"))) == 5


def test_a_kernel_is_pickled_by_name():
    assert pickle.loads(pickle.dumps(set_fence)) is set_fence


def test_a_part_that_fails_is_one_line(monkeypatch, capsys):
    def fails():
        raise ApplrError("the world is flat")

    monkeypatch.setattr(compile_kernels, "PARTS", (("one", lambda: None), ("two", fails)))
    assert compile_kernels.main() == 1
    assert capsys.readouterr().err == "applr: the world is flat\n"
