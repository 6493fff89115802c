"""Tests of common: errors in one line, atomic files, angles and boxes, progress messages."""

import builtins
import math
import os
import re
import signal
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1.common import angles, files
from applr_ros1.common.arguments import boolean, number_within, pose
from applr_ros1.common.errors import ApplrError, one_line, run_main
from applr_ros1.common.extras import EXTRAS
from applr_ros1.common.progress import announced
from applr_ros1.planner.parameters.trees import branch
from applr_ros1.policy.methods import load_module
from tests.support import HANGS, ROOT
from tests.support.refusals import refused
from tests.support.ros import wait_for


@pytest.mark.parametrize(
    ("outcome", "status", "line"),
    [
        (None, 0, ""),
        (3, 3, ""),
        (ApplrError("speed is 9: give 0 to 2"), 1, "p: speed is 9: give 0 to 2\n"),
        (
            KeyboardInterrupt("stopped; go on with --resume"),
            130,
            "p: stopped; go on with --resume\n",
        ),
        (KeyboardInterrupt(), 130, "p: stopped\n"),
        (FileNotFoundError(2, "No such file", "none"), 1, "p: [Errno 2] No such file: 'none'\n"),
    ],
)
def test_a_command_ends_in_one_line_and_a_status(capsys, outcome, status, line):
    def command():
        if isinstance(outcome, BaseException):
            raise outcome
        return outcome

    assert run_main(command, "p") == status
    assert capsys.readouterr().err == line


def test_output_that_nobody_reads_any_more_ends_in_silence(tmp_path, capsys, monkeypatch):
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as output:
        monkeypatch.setattr(sys, "stdout", output)
        assert run_main(lambda: print("a line"), "p") == 128 + signal.SIGPIPE
        # What is left of it goes nowhere when Python ends.
        print("another line", flush=True)
    assert capsys.readouterr().err == ""


def test_any_other_error_is_one_line_with_a_traceback_on_request(capsys, monkeypatch):
    line = r"p: ZeroDivisionError: .* \(test_common.py, line \d+\)\n"
    assert run_main(lambda: 1 // 0, "p") == 1
    assert re.fullmatch(line, capsys.readouterr().err)
    monkeypatch.setenv("APPLR_DEBUG", "1")
    assert run_main(lambda: 1 // 0, "p") == 1
    assert re.match(r"Traceback[^$]*" + line, capsys.readouterr().err)


def test_files_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    json_file = tmp_path / "file.json"
    files.write_json(json_file, {"a": 1})
    assert files.read_json(json_file) == {"a": 1}

    # The disk is full before the new file has its name.
    def fills_the_disk(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fills_the_disk)
    with pytest.raises(ApplrError, match=r"file.json: .*No space left on device.* untouched"):
        files.write_bytes(json_file, b"other")
    assert files.read_json(json_file) == {"a": 1}
    assert os.listdir(tmp_path) == ["file.json"]
    # Of a file that is not there, nothing is untouched.
    with pytest.raises(ApplrError, match=r"new.json: cannot be written \(No space .* device\)$"):
        files.write_bytes(tmp_path / "new.json", b"other")


def test_a_folder_that_is_missing_is_not_writable(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert files.is_in_writable_folder("page.html")
    assert files.is_in_writable_folder(tmp_path / "page.html")
    assert not files.is_in_writable_folder(tmp_path / "none" / "page.html")
    (tmp_path / "file").touch()
    assert not files.is_in_writable_folder(tmp_path / "file" / "page.html")


@pytest.mark.fault("18c")
def test_only_regular_files_are_written_and_mistakes_are_one_line(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    for file_name in ("pipe", ".", "/dev/zero"):
        not_a_file = tmp_path / file_name
        refused(lambda path=not_a_file: files.write_bytes(path, b""), "a folder, pipe or device")
    # A file renamed to its name would have replaced the pipe.
    assert (tmp_path / "pipe").is_fifo()
    # What stands under the temporary name is removed, and neither opened nor followed.
    victim = tmp_path / "victim"
    victim.write_bytes(b"precious")
    partial_name = f"file.{os.getpid()}.partial"
    for plant in (os.mkfifo, partial(os.symlink, victim), Path.touch):
        plant(tmp_path / partial_name)
        files.write_bytes(tmp_path / "file", b"content")
        assert files.read_bytes(tmp_path / "file") == b"content"
    assert victim.read_bytes() == b"precious"
    (tmp_path / partial_name).mkdir()
    refused(lambda: files.write_bytes(tmp_path / "file", b""), "file: cannot be written")
    (tmp_path / "text").write_text("{")
    refused(lambda: files.read_json(tmp_path / "text"), "text: cannot be read .*line 1")
    refused(lambda: files.read_json(tmp_path / "none"), "none: .*No such file")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        ("a: [", "cannot be read .line 1, column 5"),
        ("a: 2001-99-99", "cannot be read"),
        ("a: !!python/object/apply:os.getcwd []", "cannot be read .line 1, column 4"),
        ("a:\n  b: 1\n\tc: 2", "a tab .line 3, column 1.: give blanks instead"),
    ],
)
def test_yaml_is_plain_values(tmp_path, content, problem):
    (tmp_path / "a.yaml").write_text(content)
    refused(lambda: files.read_yaml(tmp_path / "a.yaml"), f"a.yaml: .*{problem}")


def test_numbers_beyond_their_bounds_are_refused():
    assert number_within("speed", 2, 0.0, 2.0) == 2
    assert number_within("max_speed", math.inf, 0.2, math.inf) == math.inf
    for refused_value in (-0.1, 2.1, math.nan, math.inf, "1", True, None, [1]):
        with pytest.raises(ApplrError, match="speed is .*: give a number from 0 to 2"):
            number_within("speed", refused_value, 0.0, 2.0)


@pytest.mark.parametrize(
    ("text", "value"), [("True", True), ("1", True), ("false", False), ("0", False)]
)
def test_booleans_are_those_of_launch_files(text, value):
    assert boolean("record", text) is value
    refused(lambda: boolean("record", text + "s"), f"record is {text}s: give true or false")


def test_poses_are_three_finite_numbers():
    for text in ("1 -2.5 0.3", "1,-2.5,0.3", " 1, -2.5 , 3e-1 "):
        assert pose("goal", text) == (1.0, -2.5, 0.3)
    remedy = "give three numbers 'x y yaw' in metres and radians"
    for text in ("1 2", "1 2 3 4", "1 two 3", "1 2 inf", "nan 2 3"):
        refused(lambda text=text: pose("goal", text), f"^goal is {text}: {remedy}$")
    refused(lambda: pose("goal", ""), f"^goal is empty: {remedy}$")


@pytest.mark.parametrize("yaw", [0.0, 1.0, -3.0, 3.1415])
def test_quaternions_and_poses_agree_with_complex_numbers(yaw):
    # A quaternion's length does not matter.
    components = 3.0 * np.array(angles.quaternion_of(yaw))
    quaternion = SimpleNamespace(**dict(zip("xyzw", components)))
    assert angles.yaw_of(quaternion) == pytest.approx(yaw)

    # A product with a complex number of length 1 is a rotation.
    x, y, composed_yaw = angles.compose((1.0, 2.0, yaw), (2.0, 0.5, 3.0))
    rotation = complex(math.cos(yaw), math.sin(yaw))
    composed_position = complex(1.0, 2.0) + complex(2.0, 0.5) * rotation
    assert complex(x, y) == pytest.approx(composed_position)
    assert abs(composed_yaw) <= math.pi
    assert math.sin(composed_yaw) == pytest.approx(math.sin(yaw + 3.0))

    two_turns_on = np.array([yaw + 4 * math.pi])
    np.testing.assert_allclose(angles.normalize_angle_modulo(two_turns_on), [yaw], atol=1e-12)
    assert angles.normalize_angle(yaw - 2 * math.pi) == pytest.approx(yaw)


@pytest.mark.parametrize(
    ("along", "across", "distance"),
    [
        (0.9, -0.4, 0.0),
        (-1.5, 0.3, 0.5),
        (0.2, 0.6, 0.1),
        (1.3, -0.9, 0.5),  # from a corner
    ],
)
def test_a_distance_from_a_box_is_that_of_its_nearest_point(along, across, distance):
    # In the axes of a box of 2 x 1 m, which is turned by 0.7 rad
    point = complex(along, across) * complex(math.cos(0.7), math.sin(0.7))
    offsets = angles.outside_box(point.real, point.imag, 0.7, 2.0, 1.0)
    assert math.hypot(*offsets) == pytest.approx(distance, abs=1e-12)


def test_an_error_names_the_line_that_raised_it(tmp_path):
    (tmp_path / "theirs.py").write_text("a = {}\nb = a['v']\n")
    with pytest.raises(KeyError) as raised:
        load_module(str(tmp_path / "theirs.py"))
    assert one_line(raised.value) == "KeyError: 'v' (theirs.py, line 2)"
    assert one_line(ApplrError("9 is not 8")) == "9 is not 8"


def test_files_of_the_same_name_are_two_modules(tmp_path):
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mine.py").write_text(f"its_folder = {folder!r}\n")
        module = load_module(str(tmp_path / folder / "mine.py"))
        assert module.its_folder == folder


def test_failed_work_is_not_reported_as_done():
    lines = []
    with pytest.raises(IndexError), announced("compiling", lines.append, first=0.02):
        # It fails after the beginning has been announced.
        [][wait_for(lambda: len(lines), "a line")]
    assert lines == ["compiling"]


def test_long_work_is_announced_and_never_silent_for_long():
    lines = []
    has_three_lines = threading.Event()

    def take(line):
        lines.append(line)
        if len(lines) == 3:
            has_three_lines.set()

    with announced("compiling kernels (about a minute)", take, first=0.01, every=0.01):
        assert has_three_lines.wait(HANGS)
    # The beginning, the progress, and the end
    assert lines[0] == "compiling kernels (about a minute)"
    assert all(line.startswith("still compiling kernels: ") for line in lines[1:-1])
    assert re.fullmatch(r"done compiling kernels: took \d+ s", lines[-1])


@pytest.mark.ros
@pytest.mark.parametrize("raised", ["ROSException", "AttributeError"])
def test_publishing_to_a_closed_topic_at_shutdown_is_not_an_error(monkeypatch, raised):
    rospy = pytest.importorskip("rospy")
    from applr_ros1.common.ros_node import until_shutdown

    error_kind = getattr(rospy, raised, None) or getattr(builtins, raised)
    with pytest.raises(error_kind), until_shutdown():
        raise error_kind("publish() to a closed topic")
    monkeypatch.setattr(rospy.core, "is_shutdown_requested", lambda: True)
    with until_shutdown():
        raise error_kind("publish() to a closed topic")


def test_extras_are_those_of_pyproject():
    tomllib = pytest.importorskip("tomllib")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = {"lz4": "train"}  # rosbags brings it along.
    for extra, packages in project["optional-dependencies"].items():
        declared.update(dict.fromkeys(packages, extra))
    assert declared == EXTRAS


# Program that cannot import the extras' packages, although they are installed here: it drives, and
# then prints how each command of its arguments ends
WITHOUT_EXTRAS = """
import contextlib, io, runpy, sys
from importlib.machinery import PathFinder
import applr_ros1
libraries = {"numpy", "numba", "pydantic", "yaml"}
assert libraries.isdisjoint(sys.modules), "import applr_ros1 brings more than itself"
from applr_ros1.common.extras import EXTRAS
class NotInstalled(PathFinder):
    @staticmethod
    def find_spec(name, *more):
        return None if name.partition(".")[0] in EXTRAS else PathFinder.find_spec(name, *more)
sys.meta_path[sys.meta_path.index(PathFinder)] = NotInstalled
applr_ros1.load_policy("jackal")
from training.robot import check as check_robot
from training.evaluate import __main__ as evaluate
one_drive = "--worlds generated:7 --methods applr --trials 1 --simulator kinematic"
words = one_drive.split() + ["--workers", "0", "--out", "results"]
assert evaluate.main(words) == 0
for command in sys.argv[1:]:
    sys.argv[1:] = []
    with contextlib.redirect_stderr(io.StringIO()) as errors:
        try:
            runpy.run_module("training." + command, run_name="__main__")
        except SystemExit as end:
            print("ended with:", errors.getvalue().strip() or end)
"""


def test_without_extras_policies_and_evaluation_work_and_other_commands_end_in_one_line(tmp_path):
    pytest.importorskip("training.evaluate")
    commands = ("appld", "train.bags_to_dataset", "appld.demonstrate", "train")
    program = [sys.executable, "-c", WITHOUT_EXTRAS, *commands]
    environment = dict(os.environ, PYTHONPATH=str(ROOT))
    finished = subprocess.run(
        program, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=HANGS
    )
    assert finished.returncode == 0, finished.stderr
    printed_lines = finished.stdout.splitlines()
    assert (tmp_path / "results/report/table_1.csv").exists()
    # The evaluation prints lines before those of the commands.
    for command_line in printed_lines[-len(commands) :]:
        assert re.match("ended with: (./applr train: )?Python's ", command_line), command_line
        assert command_line.endswith("pip install '.[train]'"), command_line


def test_a_path_is_created_through_an_empty_section():
    tree = {"local_costmap": None}
    branch(tree, "local_costmap/inflation", create=True)["inflation_radius"] = 0.4
    assert tree == {"local_costmap": {"inflation": {"inflation_radius": 0.4}}}
    assert branch({"a": 1}, "a/b") == {}
    assert branch(tree, "global_costmap") == {}
    assert "global_costmap" not in tree, "a path that is only read was created"
