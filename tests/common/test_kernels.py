"""Machine code that is kept between processes: found by what is compiled alone, private, filled by several at once.

Whole cases run in processes of their own, on a copy of the decorator's file with a package of two kernels.
"""

import itertools
import os
import re
import resource
import shutil
import subprocess
import sys
import time
import types
from collections import namedtuple

import numba
import pytest
from numba.core.registry import cpu_target

from applr_ros1.common import kernels
from applr_ros1.nodes.tools import compile_kernels
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


def test_a_copy_starts_warm_and_a_change_in_another_file_is_noticed(start, tmp_path):
    assert result(start("old")) == [6, 6.5, 2]
    (tmp_path / "link").symlink_to("old")
    assert result(start("link")) == [6, 6.5, 0]
    assert result(start("new")) == [6, 6.5, 0]
    inner = tmp_path / "new" / "applr_ros1" / "planner" / "inner.py"
    inner.write_text(f'"""A sentence."""\n{INNER}')
    assert result(start("new")) == [6, 6.5, 0]
    inner.write_text(INNER.replace("OFFSET = 1", "OFFSET = 2"))
    assert result(start("new")) == [7, 7.5, 2]
    assert [result(start(name)) for name in ("new", "old")] == [[7, 7.5, 0], [6, 6.5, 0]]  # both are kept


def test_processes_fill_one_folder_together_and_one_open_to_others_is_not_used(start, tmp_path):
    together = [result(process) for process in [start("code") for _ in range(4)]]
    assert [values[:2] for values in together] == [[6, 6.5]] * 4
    assert sum(values[2] for values in together) == 2  # each is compiled by one of them
    assert result(start("code")) == [6, 6.5, 0]
    (tmp_path / "cache" / "applr_ros1").chmod(0o777)  # anybody could have put machine code there
    assert [result(start("code")) for _ in range(2)] == [[6, 6.5, 2], [6, 6.5, 0]]
    files = list(tmp_path.glob("applr_ros1-*/applr_ros1.*"))
    assert len(files) == 4  # two kernels for two types
    for file in files:
        file.write_bytes(file.read_bytes()[:99])  # as a crash of the machine leaves it
    assert [result(start("code")) for _ in range(2)] == [[6, 6.5, 2], [6, 6.5, 0]]


def test_a_full_disk_costs_the_cache_alone(start, tmp_path):
    def no_byte_more():
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))

    process = start("code", preexec_fn=no_byte_more, stderr=subprocess.PIPE)
    out, said = process.communicate(timeout=HANGS)
    assert out.split() == ["6", "6.5", "2"]
    assert f"{tmp_path}/cache/applr_ros1: cannot keep" in said
    assert said.count("every start compiles anew") == 1
    assert os.listdir(tmp_path / "cache" / "applr_ros1") == ["lock"]
    assert [result(start("code")) for _ in range(2)] == [[6, 6.5, 2], [6, 6.5, 0]]


OTHER = """
import numpy as np
from collections import namedtuple
from applr_ros1.common.kernels import kernel
LIMIT = 3
UNUSED = 4

def turned(x):
    return -x
"""
CODE = """
import math
from applr_ros1.common.kernels import kernel
FACTOR = 2
ROW = (1, 2)
TABLE = np.array([1.0, 2.0])
Pair = namedtuple("Pair", "a b")
POINT = Pair(1, 2)

@kernel
def deep(x):
    return x * FACTOR

@kernel
def near(x, most=9):
    if x > most:
        return near(x - 1)
    return deep(x) + other.LIMIT

def local(scale):
    @kernel
    def scaled(x):
        return x * scale
    return scaled

third = local(3)

@kernel(error_model="numpy")
def top(x):
    "Return something."
    return near(x) + ROW[0] + TABLE[1] + POINT.a + Pair(1, 2).b + int(math.sqrt(x)) + third(x)
"""


def text(code=CODE, other=OTHER):
    """All that `top` depends on."""
    modules = [types.ModuleType(name) for name in ("other", "code")]
    for module, source in zip(modules, (other, other + code)):
        vars(module).update(other=modules[0])
        exec(source, vars(module))
    return modules[1].top._cache._content


@pytest.mark.parametrize(
    "change",
    [
        ("FACTOR = 2", "FACTOR = 3"),
        ("FACTOR = 2", "FACTOR = 2.0"),
        ("FACTOR = 2", "FACTOR = np.float32(2)"),
        ("ROW = (1, 2)", "ROW = (1, 3)"),
        ("ROW = (1, 2)", "ROW = (1, 2.0)"),
        ("([1.0, 2.0])", "([1.0, 2.5])"),
        ("([1.0, 2.0])", "([1.0, 2.0], np.float32)"),
        ("([1.0, 2.0])", "([[1.0, 2.0]])"),
        ('"a b"', '"b a"'),
        ("Pair(1, 2)\n", "Pair(2, 1)\n"),
        ("x * FACTOR", "x + FACTOR"),
        ("x - 1", "x - 2"),
        ("most=9", "most=8"),
        ("local(3)", "local(4)"),
        ("math.sqrt", "math.exp"),
        ('error_model="numpy"', 'error_model="numpy", fastmath=True'),
        ("@kernel\ndef deep", '@kernel(inline="always")\ndef deep'),
    ],
    ids="{0[0]!r} to {0[1]!r}".format,
)
def test_what_is_compiled_counts(change):
    assert change[0] in CODE
    assert text(CODE.replace(*change)) != text()


def test_constants_and_functions_of_another_module_count_and_nothing_else_does():
    through = CODE.replace("+ other.LIMIT", "+ other.LIMIT + other.turned(x)")
    assert text(other=OTHER.replace("LIMIT = 3", "LIMIT = 4")) != text()
    assert text(through, OTHER.replace("-x", "+x")) != text(through)
    assert text(other=OTHER.replace("-x", "+x")) == text()
    assert text(other=OTHER.replace("UNUSED = 4", "UNUSED = 5\nMORE = 6")) == text()
    for words in (
        ("Return something.", "Return another thing."),
        ("\n\n", "\n\n# a comment\n\n\n"),
        ("(x):", "(x: 1):"),
    ):
        assert words[0] in CODE
        assert text(CODE.replace(*words)) == text()


def test_a_constant_on_which_nothing_is_known_is_refused():
    with pytest.raises(TypeError, match="takes {'a': 1}, a dict: give it a number"):
        text(CODE.replace("FACTOR = 2", "FACTOR = {'a': 1}"))


def test_fields_of_a_tuple_that_is_an_argument_count():
    codegen = cpu_target.target_context.codegen()
    tuples = [namedtuple("Pair", fields)(1, 2) for fields in ("a b", "b a", "a b")]
    arguments = [tuples[0], tuples[1], (1, 2), (1.0, 2.0), (tuples[0],), (tuples[1],), [tuples[0]], [tuples[1]], 1]
    made = kernels.kernel(lambda x: x)
    paths = [made._cache._path((numba.typeof(x),), codegen) for x in arguments]
    for one, other in itertools.combinations(paths, 2):
        assert one != other
    assert made._cache._path((numba.typeof(tuples[2]),), codegen) == paths[0]


@pytest.fixture
def place(monkeypatch, tmp_path):
    """The folder of machine code in a test's own."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    for function in (kernels.cache_folder, kernels._lock_file):
        function.cache_clear()
    yield tmp_path / "applr_ros1"
    monkeypatch.undo()
    for function in (kernels.cache_folder, kernels._lock_file):
        function.cache_clear()


@pytest.mark.parametrize("what", ["__version__", "codegen", "python"])
def test_numba_the_processor_and_python_count(monkeypatch, place, what):
    codegen = types.SimpleNamespace(magic_tuple=lambda: ("x86_64", "skylake", "+avx"))
    cache = kernels.kernel(lambda x: x)._cache
    before = cache._path((numba.int64,), codegen)
    assert os.path.dirname(before) == str(place)
    if what == "codegen":
        codegen.magic_tuple = lambda: ("x86_64", "znver4", "+avx")
    elif what == "python":
        monkeypatch.setattr(kernels.sys, "version_info", (3, 8, 1))
    else:
        monkeypatch.setattr(numba, "__version__", "0.1")
    assert cache._path((numba.int64,), codegen) != before


def test_a_user_without_a_home_gets_no_folder_in_the_current_one(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name in ("HOME", "XDG_CACHE_HOME", "NUMBA_CACHE_DIR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(kernels.os.path, "expanduser", lambda path: path)  # as where the user has no entry either
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    assert kernels.cache_folder.__wrapped__() == str(tmp_path / "tmp" / f"applr_ros1-{os.getuid()}")
    assert os.listdir(tmp_path) == ["tmp"]


def test_without_a_folder_nothing_is_loaded_from_the_current_one(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(kernels, "cache_folder", lambda: "")
    made = kernels.kernel(lambda x: x + 1)
    with open(made._cache._path((numba.int64,), cpu_target.target_context.codegen()), "wb") as file:
        file.write(b"not loaded")
    monkeypatch.setattr(kernels.pickle, "load", None)
    assert made(1) == 2
    assert len(os.listdir(tmp_path)) == 1


def test_what_was_unused_longest_is_removed(monkeypatch, place):
    made = kernels.kernel(lambda x: x + 1)
    made(1)
    (file,) = place.glob("*lambda*")
    (place / "lock").unlink()
    monkeypatch.setattr(kernels, "KEPT_FILES", 4)
    for number in range(6):
        (place / f"old{number}").touch()
        os.utime(place / f"old{number}", (number, number))
    kernels._remove_unused.__wrapped__()
    assert set(os.listdir(place)) == {"old3", "old4", "old5", file.name}
    os.utime(file, (0, 0))
    assert made._cache.load_overload((numba.int64,), cpu_target.target_context) is not None  # a use
    (place / "new").touch()
    kernels._remove_unused.__wrapped__()
    assert set(os.listdir(place)) == {"old4", "old5", "new", file.name}


def test_all_processors_compile_and_a_part_that_fails_is_named(monkeypatch, place, capfd):
    """The first two parts end only if they run at once."""
    reader, writer = os.pipe()
    parts = [("one", lambda: os.read(reader, 1)), ("two", lambda: os.write(writer, b"x") and (place / "a-b").touch())]
    monkeypatch.setattr(compile_kernels, "PARTS", (*parts, ("three", lambda: time.sleep(0.1))))
    monkeypatch.setattr(compile_kernels.os, "sched_getaffinity", lambda _: {0, 1})
    monkeypatch.setattr(compile_kernels, "QUIET_S", 0.0)
    monkeypatch.setattr(compile_kernels, "NEXT_LINE_S", 0.01)
    assert compile_kernels.main() == 0
    out, said = capfd.readouterr()
    assert out == f"{place}\n"
    assert re.search("applr: compiling kernels: 2 of 3 parts, 1 kernels in 0 s", said)
    monkeypatch.setattr(compile_kernels, "PARTS", (*parts[:1], ("that one", lambda: os._exit(7))))
    assert compile_kernels.main() == 1
    assert capfd.readouterr().err.endswith("applr: the kernels of that one could not be compiled (status 7)\n")
