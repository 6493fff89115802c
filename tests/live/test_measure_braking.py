"""The command that measures how a robot brakes, on the simulated Jackal in the open."""

import re
import subprocess
import sys

import numpy as np
import pytest
import rospy

from tests.support import HANGS
from tests.support.ros_harness import session, slowness
from worlds import Course, World
from worlds.sdf_writer import write

pytestmark = pytest.mark.ros


def measure(*options):
    words = [sys.executable, "-m", "applr_ros1.scripts", "measure_braking", *options]
    return subprocess.run(words, env=session().env, capture_output=True, text=True, timeout=HANGS)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """The simulated Jackal in the open, on a plane that grips alike in all directions."""
    path = tmp_path_factory.mktemp("open") / "open.world"
    course = Course((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), None, 0.5, np.array([[0.0, 0.0], [10.0, 0.0]]))
    write(World("open", np.array([(15.0, 0.0, 0.1)]), np.empty((0, 5)), course), str(path))
    ros = session()
    rospy.set_param("/use_sim_time", True)
    options = "_simulator:=kinematic", "_world:=%s" % path, "_real_time_factor:=1"
    child = ros.node("sim_bridge", *options)
    child.until("ready")
    yield child
    rospy.set_param("/use_sim_time", False)
    child.end()


def test_it_drives_nowhere_unless_it_is_told_that_the_way_is_free(robot):
    for options, words in (((), "give --yes"), (("--yes", "--free", "1"), "--free 1 ")):
        run = measure("--free", "6", *options)
        assert run.returncode == 1
        assert words in run.stderr
        assert len(run.stderr.splitlines()) == 1


def test_what_it_prints_holds_for_every_run_and_for_what_the_simulated_jackal_does(robot):
    run = measure("--free", "4", "--yes", "--repeats", "1", "--odometry", "sim_bridge/ground_truth")
    assert run.returncode == 0, run.stderr
    *_, line = run.stdout.splitlines()
    reaction, brake, turn_brake = map(
        float, re.search("reaction_time: (.*), dec.*: (.*), yaw_dec.*: (.*)}", line).groups()
    )
    assert 0.10 < reaction < 0.35 * slowness()
    assert 0.5 < brake < 7.0  # locked wheels brake by the angles at which they stand
    assert turn_brake > 2.0
    runs = re.findall(r"([0-9.]+) driven, .* within ([0-9.]+) m$", run.stdout, re.M)
    assert len(runs) == 3
    for speed, way in ((float(a), float(b)) for a, b in runs):
        assert way <= speed * reaction + speed**2 / (2.0 * brake)
