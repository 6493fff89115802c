"""Tests of predicted obstacle points: positions, removal, no effect without moving obstacles."""

import copy
import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.movers.prediction import HORIZON_S, STEP_S, Prediction
from applr_ros1.movers.tracker import Movers
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.check import check, complete
from applr_ros1.planner.parameters.layers import PREDICTED
from applr_ros1.robots import JACKAL
from tests.support.robots import ToyRobot, quick, ring

WALL = ring(0.0, 0.0, 4.0, posts=300, size=0.06)  # closed ring that every beam hits
LETHAL = 254  # cost of an occupied cell, as in costmap_2d


class Perfect:
    """Tracker stub that returns given rows of x, y, vx, vy, radius."""

    def __init__(self):
        self.rows = np.zeros((0, 5))

    def reset(self):
        """Forget all obstacles."""
        self.rows = np.zeros((0, 5))

    @property
    def movers(self):
        """Return the rows as tracked obstacles."""
        x, y, vx, vy, radius = np.array(self.rows, dtype=float).reshape(-1, 5).T
        covariance = np.zeros((len(x), 3))
        return Movers(np.arange(len(x)), x, y, vx, vy, radius, covariance, radius > 0.0)

    def update(self, scan):
        """Return the rows, whatever the scan."""
        return self.movers


@pytest.fixture
def stubbed():
    """Return a Prediction for the Jackal and its tracker stub."""
    tracker = Perfect()
    return Prediction(JACKAL, tracker), tracker


def test_predicted_points_lie_on_the_visible_sides_of_the_future_discs(stubbed):
    prediction, tracker = stubbed
    robot = ToyRobot((0.3, -0.2, 0.4), [*WALL, (1.8, -0.4, 0.3)])
    tracker.rows = [(1.8, -0.4, -0.2, 1.2, 0.3)]
    cloud = prediction.add_scan(replace(robot.scan(), sensor_height=0.4))
    point_places = prediction.points[:, :2].copy()
    x, y = point_places.astype(float).T

    # Rows are times, columns points.
    times = STEP_S * np.arange(1, 1 + HORIZON_S // STEP_S)
    assert times[-1] == pytest.approx(0.9)
    disc_x = 1.8 - 0.2 * times[:, np.newaxis]
    disc_y = -0.4 + 1.2 * times[:, np.newaxis]
    from_centre = np.hypot(x - disc_x, y - disc_y)
    from_edge = np.abs(from_centre - 0.3)
    assert from_edge.min(axis=0).max() < 1e-4, "each on the edge of a disc"
    assert (from_edge < 1e-4).sum(axis=1).min() > 10, "each disc is seen"

    laser_x, laser_y, _ = robot.sensor_pose()
    assert cloud.origin == (laser_x, laser_y, 0.4)
    assert np.array_equal(cloud.points, prediction.points), "every beam has a return"
    _, _, robot_yaw = robot.pose
    bearings = np.arctan2(y - laser_y, x - laser_x) - robot_yaw
    distances = np.hypot(x - laser_x, y - laser_y)
    scan = robot.scan()
    beams = scan.angle_min + scan.angle_increment * np.arange(720)
    for bearing, distance in zip(bearings, distances):
        beam = np.abs(beams - bearing).argmin()
        assert distance < robot.ranges()[beam], "in front of the current range"

    # The second obstacle is the first one mirrored at the laser, where no beam points.
    behind = (2.0 * laser_x - 1.8, 2.0 * laser_y + 0.4, 0.2, -1.2, 0.3)
    tracker.rows.append(behind)
    prediction.add_scan(robot.scan())
    assert np.array_equal(prediction.points[:, :2], point_places), "always behind the robot"


@pytest.mark.parametrize(
    ("measured", "is_marked"),
    [
        (np.nan, False),
        (-np.inf, False),
        (1.2, False),
        (1.9, True),
        (np.inf, True),
    ],
)
def test_nothing_is_predicted_out_of_the_lasers_sight(stubbed, measured, is_marked):
    prediction, tracker = stubbed
    # The near edge of the obstacle is at 1.7 m: a range of 1.2 m hides it, one of 1.9 m does not.
    tracker.rows = [(2.0, 0.0, 0.0, 0.4, 0.3)]
    scan = ToyRobot(circles=WALL).scan()
    ranges = np.full(720, measured, np.float32)
    prediction.add_scan(replace(scan, ranges=ranges))
    assert (len(prediction.points) > 50) == is_marked


@pytest.mark.parametrize(
    ("name", "room"),
    [
        ("jackal", 0.45),
        ("husky", 0.81),
        ("turtlebot3_burger", 0.21),
    ],
)
def test_no_disc_is_predicted_on_the_robot(name, room):
    tracker = Perfect()
    robot = robots.load(name)
    prediction = Prediction(robot, tracker)
    # The radii are those of docs/explanation/movers.md.
    assert prediction.room == pytest.approx(room, abs=0.005)

    scan = replace(ToyRobot(circles=WALL).scan(), sensor_pose=robot.laser.pose)
    # The predicted path leads through the robot.
    tracker.rows = [(1.6, 0.0, -2.0, 0.0, 0.2)]
    prediction.add_scan(scan)

    assert len(prediction.points) > 10
    x, y, _ = prediction.points.T
    assert np.hypot(x, y).min() >= prediction.room


class Planners:
    """Two planners of a robot that see the same scans, one of them predicted points as well."""

    def __init__(self, prediction, robot):
        self.prediction = prediction
        self.robot = robot
        self.with_points = MoveBase(quick(applr={"movers": True}))
        self.without_points = MoveBase(quick())

    def step(self, predicts=True):
        """Make one step of 0.05 s. `predicts` is whether predicted points arrive."""
        robot = self.robot
        scan = robot.scan()
        sensed = {"front/scan": scan}
        if predicts:
            sensed[PREDICTED] = self.prediction.add_scan(scan)
        self.with_points.step(robot.time, robot.pose, robot.twist, sensed)
        self.without_points.step(robot.time, robot.pose, robot.twist, scan)
        robot.time += 0.05

    def marked_more(self):
        """Return how many lethal cells of the local costmap come from predicted points."""
        lethal = self.with_points.local_costmap.cells == LETHAL
        lethal_without = self.without_points.local_costmap.cells == LETHAL
        return int(lethal.sum()) - int(lethal_without.sum())


@pytest.mark.parametrize("walls", [WALL, []], ids=["walls", "beams without return"])
def test_predicted_points_are_cleared_with_the_next_scan(stubbed, walls):
    prediction, tracker = stubbed
    robot = ToyRobot()
    planners = Planners(prediction, robot)

    # An obstacle crosses from right to left, 1.6 m ahead.
    for y in np.arange(-2.0, 1.99, 0.08):
        robot.circles = np.array([*walls, (1.6, y, 0.25)])
        tracker.rows = [(1.6, y, 0.0, 1.6, 0.25)]
        planners.step()
        if y == pytest.approx(0.0):
            assert_marked_ahead(planners)
            # Without returns from walls, the planner without predictions does not clear the cells
            # behind the obstacle.
            assert planners.marked_more() > 20 or not walls

    # It vanishes.
    robot.circles = np.array(walls).reshape(-1, 3)
    tracker.rows = []
    for _ in range(10):
        planners.step()
    for name in ("local_costmap", "global_costmap"):
        cells = planners.with_points.costmaps[name].cells
        if walls:
            assert np.array_equal(cells, planners.without_points.costmaps[name].cells), name
        else:
            assert not cells.any(), name
    # Clearing points follow for 3 s after the last detection, which was 0.5 s ago.
    for seconds, clears in ((2.4, not walls), (2.6, False)):
        later_scan = replace(robot.scan(), stamp=robot.time + seconds)
        points = prediction.add_scan(later_scan).points
        x, y, _ = points.T
        assert np.allclose(np.hypot(x, y), 100.0, atol=1.0), "beyond every obstacle_range"
        assert (len(points) > 0) == clears


def assert_marked_ahead(planners):
    """The place of the obstacle in .9 s is lethal only with predicted points."""
    costmap = planners.with_points.local_costmap
    costmap_without = planners.without_points.local_costmap
    column, row = costmap.world_to_map(1.6 - 0.25, 0.9)
    rows = slice(row - 2, row + 3)
    columns = slice(column - 1, column + 2)
    assert costmap.cells[rows, columns].max() == LETHAL
    assert costmap_without.cells[rows, columns].max() < LETHAL


def test_predicted_points_are_cleared_if_their_source_dies(stubbed):
    """The movers node has died while predicted points surround the robot."""
    prediction, tracker = stubbed
    planners = Planners(prediction, ToyRobot(circles=WALL))
    tracker.rows = []
    for angle in np.linspace(-1.8, 1.8, 8):
        x = 1.2 * math.cos(angle)
        y = 1.2 * math.sin(angle)
        tracker.rows.append((x, y, 0.01, 0.0, 0.3))

    for _ in range(5):
        planners.step()
    assert planners.marked_more() > 20

    # The source counts as silent after a second. These steps take 0.8 s.
    for _ in range(16):
        planners.step(predicts=False)
    assert planners.marked_more() > 20, "the points stay until the source counts as silent"

    for _ in range(19):
        planners.step(predicts=False)
    assert planners.marked_more() == 0


def test_without_moving_obstacles_planners_are_bit_identical(stubbed):
    prediction, _ = stubbed
    outcomes = []
    for movers in (True, False):
        move_base = MoveBase(quick(applr={"movers": movers}))
        robot = ToyRobot(circles=[(1.5, 0.5, 0.15)])
        outcome = []
        for step in range(120):
            if step == 2:
                move_base.set_goal((3.0, 0.0, 0.0), robot.time)
            scan = robot.scan()
            sensed = {"front/scan": scan, PREDICTED: prediction.add_scan(scan)}
            cycle = move_base.step(robot.time, robot.pose, robot.twist, sensed if movers else scan)
            robot.drive(cycle.command, 0.05)
            outcome.append(cycle.command)
        assert robot.pose[0] > 1.5
        outcomes.append((outcome, move_base.local_costmap.cells.tobytes()))
    assert outcomes[0] == outcomes[1]


# -- observation source of the costmaps ------------------------------------------------------------
@pytest.mark.parametrize("name", robots.NAMES)
def test_each_layer_with_a_laser_gets_the_source_and_no_robot_file_changes(name):
    tree = robots.load(name).parameters()
    assert PREDICTED not in MoveBase(tree).sources
    move_base = MoveBase(dict(tree, applr={"movers": True}))
    assert move_base.sources[PREDICTED] == "PointCloud2"
    for costmap in move_base.costmaps.values():
        (layer,) = costmap.obstacle_layers
        laser_buffer, predicted_buffer = layer.buffers
        laser = laser_buffer.source
        predicted = predicted_buffer.source
        assert predicted.marking
        assert predicted.clearing
        assert predicted.observation_persistence == 0.0
        assert predicted.obstacle_range == laser.obstacle_range < laser.raytrace_range
        # Without it, ranges would count from the origin of the odometry.
        assert predicted.sensor_frame


@pytest.mark.parametrize("movers", [False, True])
def test_the_parameters_for_a_cpp_costmap_mean_the_same_here(movers):
    tree = copy.deepcopy(robots.load("jackal").parameters())
    predicted = {
        "data_type": "PointCloud2",
        "topic": "/applr/predicted",
        "sensor_frame": "front_laser",
        "marking": True,
        "clearing": True,
    }
    changes = {"observation_sources": "scan predicted", "predicted": predicted}
    for costmap in ("local_costmap", "global_costmap"):
        tree[costmap]["obstacles_layer"].update(changes)
    assert check(tree) == []
    # With movers on, the package adds no second source of the same topic.
    sources = MoveBase(dict(tree, applr={"movers": movers})).sources
    assert [topic.lstrip("/") for topic in sources] == ["front/scan", PREDICTED]


def test_the_source_is_added_once():
    tree = dict(robots.load("jackal").parameters(), applr={"movers": True})
    twice = complete(complete(tree))
    layer = twice["local_costmap"]["obstacles_layer"]
    assert layer["observation_sources"] == "scan applr_predicted"
