"""Tests of predicted obstacle points: positions, removal, and no effect without moving
obstacles.
"""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.movers.prediction import HORIZON_S, STEP_S, Prediction
from applr_ros1.movers.tracker import Movers, MoverTracker
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.check import check, complete
from applr_ros1.planner.parameters.layers import PREDICTED
from applr_ros1.robots import JACKAL
from tests.support.robots import ToyRobot, quick, ring, run

WALL = ring(0.0, 0.0, 4.0, posts=300, size=0.06)  # closed ring that every beam hits
LETHAL = 254


class Perfect:
    """Tracker stub that returns given rows of x, y, vx, vy, radius."""

    def __init__(self):
        self.rows = np.zeros((0, 5))

    def reset(self):
        self.rows = np.zeros((0, 5))

    def update(self, scan):
        x, y, vx, vy, radius = np.array(self.rows, dtype=float).reshape(-1, 5).T
        return Movers(np.arange(len(x)), x, y, vx, vy, radius)


@pytest.fixture
def stubbed(monkeypatch):
    """Return a Prediction for the Jackal and its tracker stub."""
    tracker = Perfect()
    monkeypatch.setattr(MoverTracker, "of", lambda robot: tracker)
    return Prediction(JACKAL), tracker


def test_predicted_points_lie_on_the_visible_sides_of_the_future_discs(stubbed):
    prediction, tracker = stubbed
    robot = ToyRobot((0.3, -0.2, 0.4), [*WALL, (1.8, -0.4, 0.3)])
    tracker.rows = [(1.8, -0.4, -0.2, 1.2, 0.3)]
    cloud = prediction.add_scan(replace(robot.scan(), sensor_height=0.4))
    points = prediction.points.astype(float)
    times = STEP_S * np.arange(1, 1 + HORIZON_S // STEP_S)
    off = np.array(
        [
            np.hypot(points[:, 0] - 1.8 + 0.2 * time, points[:, 1] + 0.4 - 1.2 * time) - 0.3
            for time in times
        ]
    )
    assert np.abs(off).min(axis=0).max() < 1e-4, "each on the edge of a disc"
    assert (np.abs(off) < 1e-4).sum(axis=1).min() > 10, "each disc is seen"
    assert times[-1] == pytest.approx(0.9)
    place = np.array(robot.sensor_pose()[:2])
    assert cloud.origin == (*place, 0.4)
    assert np.array_equal(cloud.points, prediction.points), "every beam has a return"
    towards = points[:, :2] - place
    far = np.hypot(*(points[:, :2] - place).T)
    bearings = np.arctan2(towards[:, 1], towards[:, 0]) - robot.pose[2]
    beams = robot.scan().angle_min + robot.scan().angle_increment * np.arange(720)
    for bearing, distance in zip(bearings, far):
        assert distance < robot.ranges()[np.abs(beams - bearing).argmin()], (
            "in front of the current range"
        )
    # Always behind the robot.
    tracker.rows.append((*(2.0 * place - tracker.rows[0][:2]), 0.2, -1.2, 0.3))
    prediction.add_scan(robot.scan())
    assert np.array_equal(prediction.points[:, :2], points[:, :2].astype(np.float32))


def test_nothing_is_predicted_out_of_the_lasers_sight(stubbed):
    prediction, tracker = stubbed
    tracker.rows = [(2.0, 0.0, 0.0, 0.4, 0.3)]
    scan = ToyRobot(circles=WALL).scan()
    for ranges, marked in (
        (np.nan, False),
        (-np.inf, False),
        (1.2, False),
        (1.9, True),
        (np.inf, True),
    ):
        prediction.add_scan(replace(scan, ranges=np.full(720, ranges, np.float32)))
        assert (len(prediction.points) > 50) == marked, ranges


@pytest.mark.parametrize(
    ("name", "room"), [("jackal", 0.45), ("husky", 0.81), ("turtlebot3_burger", 0.21)]
)
def test_no_disc_is_predicted_on_the_robot(name, room, monkeypatch):
    tracker = Perfect()
    robot = robots.load(name)
    monkeypatch.setattr(MoverTracker, "of", lambda robot: tracker)
    prediction = Prediction(robot)
    # Measured (docs/explanation/movers.md)
    assert prediction.room == pytest.approx(room, abs=0.005)
    scan = replace(ToyRobot(circles=WALL).scan(), sensor_pose=robot.laser.pose)
    tracker.rows = [(1.6, 0.0, -2.0, 0.0, 0.2)]  # path through the robot
    prediction.add_scan(scan)
    assert len(prediction.points) > 10
    assert np.hypot(*prediction.points[:, :2].T).min() >= prediction.room


@pytest.mark.parametrize("walls", [WALL, []], ids=["walls", "beams without return"])
def test_predicted_points_are_cleared_with_the_next_scan(stubbed, walls):
    prediction, tracker = stubbed
    with_marks = MoveBase(quick(applr={"movers": True}))
    without = MoveBase(quick())
    robot = ToyRobot()
    lethal = []
    for k in range(60):  # An obstacle crosses from right to left, 1.6 m ahead, and vanishes.
        y = -2.0 + 0.08 * k
        there = k < 50
        robot.circles = np.array([*walls, (1.6, y, 0.25)] if there else walls).reshape(-1, 3)
        tracker.rows = [(1.6, y, 0.0, 1.6, 0.25)] if there else []
        scan = robot.scan()
        for made, sensed in (
            (with_marks, {"front/scan": scan, PREDICTED: prediction.add_scan(scan)}),
            (without, scan),
        ):
            made.step(robot.time, robot.pose, robot.twist, sensed)
        robot.time += 0.05
        lethal.append(
            [(made.local_costmap.cells == LETHAL).sum() for made in (with_marks, without)]
        )
        if k == 25:
            # Position .9 s ahead.
            x, y = with_marks.local_costmap.world_to_map(1.6 - 0.25, 0.9)
            ahead = slice(y - 2, y + 3), slice(x - 1, x + 2)
            assert (
                with_marks.local_costmap.cells[ahead].max()
                == LETHAL
                > without.local_costmap.cells[ahead].max()
            )
    # Without returns from walls, the planner without predictions does not clear the cells that the
    # obstacle has left.
    assert lethal[25][0] > lethal[25][1] + 20 or not walls
    for name in ("local_costmap", "global_costmap"):
        here, there = (made.costmaps[name].cells for made in (with_marks, without))
        assert np.array_equal(here, there) if walls else not here.any(), name
    for seconds, clears in ((2.4, not walls), (2.6, False)):  # last detected 0.5 s ago
        points = prediction.add_scan(replace(robot.scan(), stamp=robot.time + seconds)).points
        assert np.allclose(np.hypot(*points[:, :2].T), 100.0, atol=1.0), (
            "beyond every obstacle_range"
        )
        assert (len(points) > 0) == clears


def test_predicted_points_are_cleared_if_their_source_dies(stubbed):
    """The movers node has died while predicted points surround the robot."""
    prediction, tracker = stubbed
    with_marks = MoveBase(quick(applr={"movers": True}))
    without = MoveBase(quick())
    robot = ToyRobot(circles=WALL)
    around = [(1.2 * math.cos(a), 1.2 * math.sin(a)) for a in np.linspace(-1.8, 1.8, 8)]
    tracker.rows = [(x, y, 0.01, 0.0, 0.3) for x, y in around]
    lethal = []
    for k in range(40):
        scan = robot.scan()
        with_points = {
            "front/scan": scan,
            **({PREDICTED: prediction.add_scan(scan)} if k < 5 else {}),
        }
        for made, sensed in ((with_marks, with_points), (without, scan)):
            made.step(robot.time, robot.pose, robot.twist, sensed)
        robot.time += 0.05
        lethal.append(
            [(made.local_costmap.cells == LETHAL).sum() for made in (with_marks, without)]
        )
    assert lethal[4][0] > lethal[4][1] + 20
    assert lethal[20][0] > lethal[20][1] + 20, "the points stay until the source counts as silent"
    assert lethal[-1][0] == lethal[-1][1]


def test_without_moving_obstacles_planners_are_bit_identical(stubbed):
    prediction, _ = stubbed
    drives = []
    for movers in (False, True):
        move_base = MoveBase(quick(applr={"movers": movers}))
        robot = ToyRobot(circles=[(1.5, 0.5, 0.15)])
        step = move_base.step

        def step_with_points(now, pose, twist, scan, step=step):
            return step(
                now, pose, twist, {"front/scan": scan, PREDICTED: prediction.add_scan(scan)}
            )

        move_base.step = step_with_points if movers else step
        run(move_base, robot, 0.1)
        move_base.set_goal((3.0, 0.0, 0.0), robot.time)
        cycles = []
        run(move_base, robot, 6.0, cycles=cycles)
        assert robot.pose[0] > 1.5
        drives.append(([c.command for _, c in cycles], move_base.local_costmap.cells.tobytes()))
    assert drives[0] == drives[1]


# -- observation source of the costmaps ------------------------------------------------------------
@pytest.mark.parametrize("name", robots.NAMES)
def test_each_layer_with_a_laser_gets_the_source_and_no_robot_file_changes(name):
    tree = robots.load(name).parameters()
    assert PREDICTED not in MoveBase(tree).sources
    move_base = MoveBase(dict(tree, applr={"movers": True}))
    assert move_base.sources[PREDICTED] == "PointCloud2"
    for costmap in move_base.costmaps.values():
        (layer,) = costmap.obstacle_layers
        laser, marks = (buffer.source for buffer in layer.buffers)
        assert (marks.marking, marks.clearing, marks.observation_persistence) == (True, True, 0.0)
        assert marks.obstacle_range == laser.obstacle_range < laser.raytrace_range
        # Without it, ranges would count from the origin of the odometry.
        assert marks.sensor_frame


def test_the_parameters_for_a_cpp_costmap_mean_the_same_here():
    tree = copy.deepcopy(robots.load("jackal").parameters())
    for costmap in ("local_costmap", "global_costmap"):
        predicted = dict(
            data_type="PointCloud2", topic="/applr/predicted", sensor_frame="front_laser"
        )
        predicted.update(marking=True, clearing=True)
        tree[costmap]["obstacles_layer"].update(
            observation_sources="scan predicted", predicted=predicted
        )
    assert check(tree) == []
    for movers in (False, True):
        sources = MoveBase(dict(tree, applr={"movers": movers})).sources
        assert [topic.lstrip("/") for topic in sources] == ["front/scan", PREDICTED]
    twice = complete(complete(dict(robots.load("jackal").parameters(), applr={"movers": True})))
    assert (
        twice["local_costmap"]["obstacles_layer"]["observation_sources"] == "scan applr_predicted"
    )
