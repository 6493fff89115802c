"""Tests of ./applr barn with a stand-in for the BARN Challenge's runner in a fake checkout."""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import psutil
import pytest
import rospkg  # noqa: F401 - skips this file without ROS, which the runner needs
import rospy  # noqa: F401

from applr_ros1.nodes.tools import barn
from tests.support import HANGS, ROOT
from tests.support.refusals import refused
from tests.support.scenes import as_barn, moving, sdf
from worlds import dynabarn, load
from worlds.barn import fields

pytestmark = pytest.mark.ros


@pytest.fixture
def checkout(tmp_path):
    """Provide run.py and jackal_helper as in the Challenge's repository, with worlds 2 (BARN) and
    300 (DynaBARN).
    """
    root = tmp_path / "checkout"
    helper = root / "jackal_helper"
    barn_worlds = helper / "worlds" / "BARN"
    dynabarn_worlds = helper / "worlds" / "DynaBARN"
    for folder in (
        barn_worlds / "path_files",
        dynabarn_worlds,
        helper / "launch",
        helper / "plugins",
    ):
        folder.mkdir(parents=True)

    # The programs
    shutil.copy(ROOT / "tests" / "support" / "gazebo.py", root / "run.py")
    shutil.copy(ROOT / "compat" / "jackal_helper" / "package.xml", helper)
    shutil.copy(ROOT / "compat/jackal_helper/launch/move_base_DWA.launch", helper / "launch")
    # The real one starts Gazebo, which ./applr barn must not use.
    gazebo_launch = helper / "launch" / "gazebo_launch.launch"
    gazebo_launch.write_text("<launch><!-- starts Gazebo --></launch>")

    # The worlds. The runner's world 300 is DynaBARN's world 0, whose obstacle moves by a table.
    (barn_worlds / "world_2.world").write_text(as_barn(load("generated:2")))
    np.save(barn_worlds / "path_files" / "path_2.npy", fields()[2][1])
    (dynabarn_worlds / "world_0.world").write_text(sdf(moving("easylibobs_1"), ""))
    motion_rows = (
        dynabarn.COLUMNS,
        ("easylibobs_1", "10", "1", "0", "-5", "7"),
        ("easylibobs_1", "10", "1", "10", "5", "7"),
    )
    (dynabarn_worlds / dynabarn.NAME).write_text("\n".join(map(",".join, motion_rows)))
    return root


def command(*arguments, **environment):
    """Run ./applr barn in a process of its own, and return it once it has ended."""
    python_path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, "-m", "applr_ros1.scripts", "barn", *map(str, arguments)],
        env=dict(os.environ, PYTHONPATH=python_path, **environment),
        capture_output=True,
        text=True,
        timeout=HANGS,
    )


def left_over(word):
    """Return the command lines of running processes that contain a word."""
    command_lines = []
    for process in psutil.process_iter(["cmdline"]):
        command_line = " ".join(process.info["cmdline"] or ())
        if word in command_line:
            command_lines.append(command_line)
    return command_lines


class RunResult(NamedTuple):
    """Columns of a line of the runner's results."""

    world: str
    success: str
    collided: str
    timeout: str
    time: str
    metric: str


@pytest.mark.slow
@pytest.mark.parametrize("world", [2, 300])
def test_runs_the_runner_in_a_world(checkout, tmp_path, world):
    results_folder = tmp_path / "results"
    controller = ROOT / "applr_ros1" / "launch" / "barn_controller.launch"
    options = ["--out", results_folder, "--controller", controller, "--worlds", str(world)]
    # Twice as fast as real time, so that the test takes half as long
    finished = command(checkout, *options, APPLR_SIMULATOR="kinematic", APPLR_REAL_TIME_FACTOR="2")
    assert finished.returncode == 0, finished.stdout + finished.stderr

    (result_line,) = (results_folder / "out.txt").read_text().splitlines()
    run_result = RunResult(*result_line.split())
    assert int(run_result.world) == world
    assert run_result.success == "1", result_line
    assert 0.1 < float(run_result.metric) <= 0.5, result_line
    assert not left_over(str(checkout))
    refused(lambda: barn_main(checkout, *options), r"out\.txt exists already: give another --out")


def test_a_user_defined_controller_and_a_runner_that_fails(checkout, tmp_path):
    # The controller replaces the checkout's, in a package that links to all its other files.
    own_launch = tmp_path / "mine.launch"
    own_launch.write_text("<launch/>")
    package = tmp_path / "package"
    barn.link_package(checkout, package, own_launch)
    linked_launch = package / "jackal_helper" / "launch" / "move_base_DWA.launch"
    assert linked_launch.resolve() == own_launch
    world_file = Path("jackal_helper", "worlds", "BARN", "world_2.world")
    assert (package / world_file).resolve() == checkout / world_file

    (checkout / "run.py").write_text("raise SystemExit('no gazebo here')")
    finished = command(checkout, "--worlds", "2,300", "--out", tmp_path / "results")
    assert finished.returncode == 1
    assert "no gazebo here" in (tmp_path / "results" / "logs" / "world_2_trial_0.log").read_text()
    assert "2 of 2 runs have no result" in finished.stderr


def test_a_runner_that_has_ended_is_not_waited_for():
    runner = subprocess.Popen([sys.executable, "-c", ""], start_new_session=True)
    began = time.monotonic()
    barn.end(runner)
    assert runner.returncode is not None
    assert time.monotonic() - began < barn.INTERRUPT_S / 2


def barn_main(*arguments):
    """Run ./applr barn in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["barn", *map(str, arguments)])
        barn.main()


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (["--worlds", "nine"], "give numbers and ranges such as 0-49,300"),
        (["--worlds", "7"], "no world 7"),
        (["--controller", "none.launch"], r"none\.launch does not exist"),
    ],
)
def test_mistakes_are_one_line(checkout, tmp_path, arguments, problem):
    refused(lambda: barn_main(checkout, "--out", tmp_path / "results", *arguments), problem)
