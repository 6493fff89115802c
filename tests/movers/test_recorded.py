"""The tracker on scenes that tests/benchmarks/movers.py drove through, kept as files beside this one.

limits: first angle, increment, range_min, range_max. times (n,), poses (n, 3) of the laser by the odometry. steps
(n, beams): each range less that of the beam before [5 mm]; ranges of -1 are +inf, 0 is too near to tell. truth
(n, 8, 5): x, y, radius, vx, vy of the nearest movers in the odometry's frame.
"""

from pathlib import Path

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.planner.costmap.scan import LaserScan
from tests.benchmarks.movers import Judge


def judged(robot, name):
    """The Judge of a recorded scene."""
    judge = Judge(robots.load(robot))
    judge.begin()
    with np.load(Path(__file__).parent / f"{name}.npz") as scene:
        for stamp, pose, steps, truth in zip(*(scene[key] for key in ("times", "poses", "steps", "truth"))):
            ranges = np.cumsum(steps).astype(np.float32)
            ranges = np.where(ranges < 0, np.float32(np.inf), np.float32(0.005) * ranges)
            judge.see(LaserScan(float(stamp), *scene["limits"].tolist(), ranges, tuple(pose.tolist())), truth)
    return judge


def test_a_base_whose_wheels_slip_sees_no_movers():
    """The Jackal pushes backwards against a post, among others; half of its beams."""
    judge = judged("jackal", "jackal_slips")
    assert judge.seconds > 1.5
    assert judge.marks == 0


@pytest.mark.parametrize(
    ("robot", "scene"), [("jackal", "jackal_among_movers"), ("turtlebot3_burger", "burger_among_movers")]
)
def test_movers_of_a_room_are_known(robot, scene):
    """They cross before and behind each other; DynaBARN's kinds, medium and fast."""
    judge = judged(robot, scene)
    assert judge.in_view > 4.0
    assert judge.known / judge.in_view > 0.7
    assert np.median(judge.position) < 0.06
    assert np.median(judge.velocity) < 0.15
    assert judge.wrong < 0.05 * judge.marks
    print(judge.line())
