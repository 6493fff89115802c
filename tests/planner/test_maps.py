"""Tests of static maps, layers in any order, several sources, and localisation that drifts."""

import copy
import itertools
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from applr_ros1.common.angles import compose, inverse, transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import (
    LaserScan,
    ObservationBuffer,
    PointCloud,
    SensorCloud,
    Source,
    moved,
    observe,
    project,
)
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.inflation_layer import InflationLayer, InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleLayer, ObstacleParameters
from applr_ros1.planner.costmap.static_layer import (
    StaticLayer,
    StaticMap,
    StaticParameters,
    interpretation,
)
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.observation_router import ObservationRouter
from tests.support.refusals import refused
from tests.support.robots import DWA_PARAMETERS, JACKAL_FOOTPRINT, ToyRobot, quick
from tests.support.scenes import inflate, see, wall_with_a_door

# Pose of the robot, or of a sensor, at the origin.
HERE = (0.0, 0.0, 0.0)
N = 40  # cells along each side of the costmaps
CELL_M = 0.1  # edge of a cell [m]
CORNER = (-2.0, -2.0)  # lower left corner of the costmaps [m]
LETHAL = 254  # cost of an occupied cell, as in costmap_2d
STATIC_LAYER = {"name": "static", "type": "costmap_2d::StaticLayer"}


def make_costmap(*layers, rolling=False, track_unknown=False):
    """Return a costmap of 40 x 40 cells of 0.1 m, centred at the origin."""
    # Half a cell more, because the size is divided by the resolution and rounded down.
    side = (N + 0.5) * CELL_M
    return Costmap(
        side,
        side,
        CELL_M,
        CORNER,
        rolling,
        JACKAL_FOOTPRINT,
        track_unknown,
        layers=layers,
    )


def grid(rng, share=0.03):
    """Return a map of random cells, a share of them occupied and some unknown."""
    is_occupied = rng.random((N, N)) < share
    is_unknown = rng.random((N, N)) < 0.05
    cells = np.where(is_occupied, 100, 0)
    cells[is_unknown] = -1
    return StaticMap(cells.astype(np.int8), CELL_M, CORNER, "map")


def free_map(rows, columns, resolution, corner, frame="map"):
    """Return a map without obstacles."""
    return StaticMap(np.zeros((rows, columns), np.int8), resolution, corner, frame)


# -- interpretation of maps ------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("parameters", "costs"),
    [  # costs of the occupancies 0, 1, 50, 64, 65, 99, 100, 127, -1
        ({}, (0, 0, 0, 0, 0, 0, 254, 254, 255)),
        ({"track_unknown_space": False}, (0, 0, 0, 0, 0, 0, 254, 254, 0)),
        ({"lethal_cost_threshold": 65}, (0, 0, 0, 0, 254, 254, 254, 254, 255)),
        ({"lethal_cost_threshold": 400}, (0, 0, 0, 0, 0, 0, 254, 254, 255)),
        ({"lethal_cost_threshold": -3}, (254, 254, 254, 254, 254, 254, 254, 254, 255)),
        ({"unknown_cost_value": 50}, (0, 0, 255, 0, 0, 0, 254, 254, 254)),
        ({"trinary_costmap": False}, (0, 2, 127, 162, 165, 251, 254, 254, 255)),
        (
            {"trinary_costmap": False, "lethal_cost_threshold": 65},
            (0, 3, 195, 250, 254, 254, 254, 254, 255),
        ),
    ],
)
def test_costs_of_occupancies(parameters, costs):
    table = interpretation(StaticParameters(**parameters))
    # The byte 255 is -1.
    occupancies = np.array([0, 1, 50, 64, 65, 99, 100, 127, 255])
    assert tuple(table[occupancies].tolist()) == costs


def test_a_fixed_costmap_takes_size_and_origin_of_the_map_and_a_rolling_costmap_does_not():
    fixed = make_costmap(StaticLayer("static", StaticParameters()))
    rolling = make_costmap(StaticLayer("static", StaticParameters()), rolling=True)
    # OccupancyGrid has its resolution as float32.
    occupied_map = StaticMap(
        np.full((30, 70), 100, np.int8),
        float(np.float32(0.05)),
        (-1.0, 3.0),
    )
    for costmap in (fixed, rolling):
        # A map on a topic that no layer reads
        costmap.set_map("elsewhere", occupied_map)
        assert costmap.size == (N, N)
        costmap.set_map("map", occupied_map)
        costmap.update_costs(HERE)

    assert fixed.size == (70, 30)
    assert fixed.resolution == occupied_map.resolution
    assert fixed.origin.tolist() == [-1.0, 3.0]
    assert (fixed.cells == 254).all()
    assert rolling.size == (N, N)
    assert rolling.resolution == 0.1
    # The map determines the size.
    fixed.resize(5.0, 5.0, 0.05, (0.0, 0.0))
    assert fixed.size == (70, 30)


@pytest.mark.parametrize(
    ("shape", "resolution", "origin"),
    [
        ((0, 3), 0.1, (0, 0)),
        ((3, 3), math.nan, (0, 0)),
        ((3, 3), 0.0, (0, 0)),
        ((3, 3), 0.1, (math.nan, 0)),
        ((3, 3), 0.1, (0, math.inf)),
    ],
)
def test_a_map_without_cells_resolution_or_origin_is_refused(shape, resolution, origin):
    invalid_map = StaticMap(np.zeros(shape), resolution, origin)
    with pytest.raises(ApplrError, match="map has"):
        MoveBase(quick()).set_map(invalid_map)


def test_a_map_is_written_again_after_the_map_of_a_disabled_layer_has_resized_the_costmap():
    # C++ resizes the costmap even for the map of a layer that is switched off.
    first_layer = StaticLayer("first", StaticParameters())
    second_layer = StaticLayer("second", StaticParameters(map_topic="other", enabled=False))
    costmap = make_costmap(first_layer, second_layer)
    costmap.set_map("map", map_of(100))
    costmap.update_costs(HERE)
    costmap.set_map("other", map_of(0, side=N + 5))
    costmap.update_costs(HERE)
    assert costmap.size == (N + 5, N + 5)
    assert (costmap.cells[:N, :N] == 254).all()


def test_a_map_that_is_switched_on_again_is_written_as_a_whole():
    # Given: an occupied map below a layer that lets only the robot's surroundings be written
    seen = ObstacleLayer("seen", ObstacleParameters(), (Source(),), 0)
    costmap = make_costmap(StaticLayer("static", StaticParameters()), seen)
    costmap.set_map("map", map_of(100))
    costmap.update_costs(HERE)
    assert (costmap.cells == LETHAL).all()

    # When: the map is off for a while
    costmap.configure("static", enabled=False)
    costmap.update_costs(HERE)
    assert 0 < np.count_nonzero(costmap.cells == 0) < 100
    costmap.configure("static", enabled=True)

    # Then: it comes back where the robot was, too
    costmap.update_costs((1.5, 1.5, 0.0))
    assert (costmap.cells == LETHAL).all()


def map_of(value, side=N):
    """Return a map whose cells all have one occupancy, of the size of the costmaps by default."""
    return StaticMap(np.full((side, side), value, np.int8), 0.1, (-2.0, -2.0))


UNKNOWN_CELLS = np.full((2, 4), -1, np.int8)
FREE_CELL = np.zeros((1, 1), np.int8)


def test_first_map_only_ignores_later_maps():
    costmap = make_costmap(StaticLayer("static", StaticParameters(first_map_only=True)))
    costmap.set_map("map", map_of(0))
    # Each of these would leave a mark.
    costmap.set_map("map", map_of(100))
    costmap.update_map("map", 3, 5, UNKNOWN_CELLS)
    costmap.update_costs(HERE)
    assert not costmap.cells.any()


def test_updates_of_a_map_are_applied():
    costmap = make_costmap(StaticLayer("static", StaticParameters(subscribe_to_updates=True)))
    costmap.set_map("map", map_of(0))
    costmap.set_map("map", map_of(100))
    costmap.update_map("map", 3, 5, UNKNOWN_CELLS)
    costmap.update_costs(HERE)
    expected = np.full((N, N), 254)
    expected[5:7, 3:7] = 255
    np.testing.assert_array_equal(costmap.cells, expected)

    # Two map updates may precede the costmap's update.
    costmap.update_map("map", 0, 0, FREE_CELL)
    costmap.update_map("map", 39, 39, FREE_CELL)
    costmap.update_costs(HERE)
    assert costmap.cells[0, 0] == 0
    assert costmap.cells[39, 39] == 0

    # They outlive a reset of the costmap.
    costmap.reset_layers()
    costmap.update_costs(HERE)
    assert costmap.cells[6, 6] == 255
    # Columns 38 to 40, of which the last is not on the map.
    row_beyond = np.zeros((1, 3), np.int8)
    refused(lambda: costmap.update_map("map", 38, 0, row_beyond), "not on the map")


@pytest.mark.parametrize(("x", "y"), [(-1, 0), (0, -1), (N, 0), (0, N)])
def test_an_update_of_a_cell_beside_the_map_is_refused(x, y):
    costmap = make_costmap(StaticLayer("static", StaticParameters(subscribe_to_updates=True)))
    costmap.set_map("map", map_of(100))
    refused(lambda: costmap.update_map("map", x, y, FREE_CELL), "not on the map")
    costmap.update_costs(HERE)
    assert (costmap.cells == LETHAL).all()


def test_a_rolling_costmap_shows_the_part_of_the_map_below_it():
    # Given: a map in a frame of its own, and a costmap around the robot
    static_map = grid(np.random.default_rng(3), 0.3)
    placement = (0.4, -0.3, 0.5)
    costmap = make_costmap(StaticLayer("static", StaticParameters()), rolling=True)
    costmap.set_map("map", static_map)
    costmap.static_layers[0].placement = placement
    costmap.update_costs((0.7, 0.5, 1.0))

    # Then: each cell has the cost of the map's cell at its centre, and 0 beyond the map
    costs = interpretation(StaticParameters())[static_map.cells.view(np.uint8)]
    count_on_map = 0
    origin_x, origin_y = costmap.origin
    for row, column in itertools.product(range(N), range(N)):
        centre_x = origin_x + (column + 0.5) * 0.1
        centre_y = origin_y + (row + 0.5) * 0.1
        x, y = transform_point(placement, centre_x, centre_y)
        map_column = math.floor((x + 2.0) / 0.1)
        map_row = math.floor((y + 2.0) / 0.1)
        cost = 0
        if 0 <= map_column < N and 0 <= map_row < N:
            cost = costs[map_row, map_column]
            count_on_map += 1
        assert costmap.cells[row, column] == cost
    assert 500 < count_on_map < N * N


# -- layers and sources ----------------------------------------------------------------------------
def test_layers_in_any_order_equal_the_plain_ones():
    """Letters: s static, m static with use_maximum, o obstacles, i inflation. The whole map is
    updated twice.
    """
    # Layers twice, some alone, and none.
    orders = [
        *itertools.permutations("som"),
        "ois",
        "sioi",
        "iso",
        "so",
        "s",
        "smoi",
        "oio",
        "",
    ]
    for order, track_unknown in itertools.product(orders, (False, True)):
        compare_layers(order, track_unknown)


def layer_of(letter, number, default):
    """Return the layer of a letter. Obstacle layers overwrite in places 0, 2, ..., else take the
    maximum.
    """
    name = f"{letter}{number}"
    if letter == "s":
        return StaticLayer(name, StaticParameters())
    if letter == "m":
        return StaticLayer(name, StaticParameters(use_maximum=True, trinary_costmap=False))
    if letter == "i":
        return InflationLayer(name, InflationParameters(0.3 + 0.1 * number, 3.0))
    parameters = ObstacleParameters(combination_method=number % 2)
    sources = (Source(raytrace_range=1.5),)
    return ObstacleLayer(name, parameters, sources, 255 if number else default)


def compare_layers(order, track_unknown):
    # Given: layers in some order, a map and a cloud, all updated twice
    rng = np.random.default_rng(len(order) + track_unknown)
    default = 255 if track_unknown else 0
    layers = [layer_of(letter, number, default) for number, letter in enumerate(order)]
    costmap = make_costmap(*layers, track_unknown=track_unknown)
    is_occupied = rng.random((N, N)) < 0.02
    occupancies = rng.integers(-1, 60, (N, N))
    cells = np.where(is_occupied, 100, occupancies).astype(np.int8)
    static_map = StaticMap(cells, 0.1, (-2, -2))
    costmap.set_map("map", static_map)
    costmap.update_costs(HERE)
    points = rng.uniform(-1.8, 1.8, (40, 3)).astype(np.float32)
    for layer in costmap.obstacle_layers:
        layer.buffers[0].add_cloud(PointCloud((0.1, 0.0, 0.2), points), 0.0)
    costmap.set_map("map", static_map)
    # A new footprint forces an update of the whole map.
    costmap.set_footprint(costmap.footprint)
    costmap.update_costs(HERE)

    # Then: the master is what its layers make of each other's cells, one after the other
    master = np.full((N, N), 255 if track_unknown else 0, np.uint8)
    for number, layer in enumerate(costmap.layers):
        letter = order[number]
        if letter == "i":
            inflate(master, (0, 0, N, N), 0.1, costmap.inscribed_radius, layer.parameters)
            continue
        is_written = layer.cells != 255
        overwrites = letter == "o" and number % 2 == 0
        if letter == "s":
            is_written[:] = True
        elif not overwrites:
            is_written &= (master == 255) | (master < layer.cells)
        master = np.where(is_written, layer.cells, master)
    if set("smi") & set(order):
        np.testing.assert_array_equal(costmap.cells, master, f"layers {order}")
    assert not order or costmap.cells.any(), order


def test_all_sources_clear_before_any_marks():
    sources = (
        Source(topic="a", clearing=False),
        Source(topic="b", marking=False, clearing=True),
    )
    costmap = make_costmap(ObstacleLayer("seen", ObstacleParameters(), sources, 0))
    marking_buffer, clearing_buffer = costmap.obstacle_layers[0].buffers
    near_point = np.array([[1.05, 0.05, 0.0]], np.float32)
    far_point = np.array([[1.75, 0.05, 0.0]], np.float32)
    marking_buffer.add_cloud(PointCloud(HERE, near_point), 0.0)
    clearing_buffer.add_cloud(PointCloud(HERE, far_point), 0.0)
    costmap.update_costs(HERE)
    assert costmap.cells[20, 30] == 254
    # The second source does not mark.
    assert costmap.cells[20, 37] == 0

    # Now only the ray to (1.75, 0.05) passes the marked cell.
    marking_buffer.clouds = []
    costmap.update_costs(HERE)
    assert costmap.cells[20, 30] == 0


def stamps(buffer):
    """Return the stamps [s] of the observations that a buffer keeps, in its order."""
    return [cloud.stamp for cloud in buffer.clouds]


def test_observation_persistence_and_silence_of_a_source():
    buffer = ObservationBuffer(Source(observation_persistence=1.0, expected_update_rate=0.5))
    assert not buffer.is_current(0.0)
    no_points = np.zeros((0, 3), np.float32)
    for stamp in (0.0, 0.4, 0.8, 1.2, 1.6, 2.0):
        buffer.add_cloud(PointCloud(HERE, no_points, stamp), stamp)
    # Up to one second old; the latest first.
    assert stamps(buffer) == [2.0, 1.6, 1.2]
    assert buffer.is_current(2.5)
    assert not buffer.is_current(2.51)
    assert ObservationBuffer(Source()).is_current(99.0)


def router_of(*buffers, global_buffers=(), enabled=True, scan_timeout=0.5):
    """Return a router to the buffers of one obstacle layer of the local costmap, and of one of the
    global costmap, with a patience of 0.5 s.
    """
    parameters = SimpleNamespace(enabled=enabled)
    local_layer = SimpleNamespace(parameters=parameters, buffers=list(buffers))
    global_layer = SimpleNamespace(parameters=parameters, buffers=list(global_buffers))
    local_costmap = SimpleNamespace(obstacle_layers=[local_layer])
    global_costmap = SimpleNamespace(obstacle_layers=[global_layer])
    return ObservationRouter(local_costmap, global_costmap, scan_timeout)


# One beam
SCAN = LaserScan(
    stamp=0.0,
    angle_min=0.0,
    angle_increment=0.2,
    range_min=0.1,
    range_max=10.0,
    ranges=np.array([1.0], np.float32),
    sensor_pose=HERE,
)


def test_lasers_of_one_topic_may_have_different_delays():
    buffer = ObservationBuffer(Source(expected_update_rate=0.5, observation_persistence=9.0))
    router = router_of(buffer)
    for cycle in range(3):
        now = 10.0 + 0.05 * cycle
        router.route({"scan": replace(SCAN, stamp=now - 0.02, frame="front")}, now, None)
        router.route({"scan": replace(SCAN, stamp=now - 0.11, frame="rear")}, now, None)
        # An old scan of the same laser is none.
        router.route({"scan": replace(SCAN, stamp=now - 0.2, frame="front")}, now, None)
    expected = [10.08, 10.03, 9.99, 9.98, 9.94, 9.89]
    assert sorted(stamps(buffer), reverse=True) == pytest.approx(expected)


def test_the_first_source_on_a_topic_determines_its_type_and_the_origin_of_its_rays():
    scan = ObservationBuffer(Source(topic="scan"))
    in_message_frame = ObservationBuffer(Source(topic="points", data_type="PointCloud2"))
    of_mast = ObservationBuffer(Source(topic="points", data_type="PointCloud", sensor_frame="mast"))
    of_rear = ObservationBuffer(Source(topic="points", data_type="PointCloud", sensor_frame="rear"))
    router = router_of(scan, in_message_frame, global_buffers=(of_mast, of_rear))
    # The topics of the local costmap come first: an observation without a topic is of the first.
    assert list(router.data_types.items()) == [("scan", "LaserScan"), ("points", "PointCloud2")]
    # A source without a sensor_frame leaves the choice to the others.
    assert router.ray_origins == {"points": "mast"}


@pytest.mark.parametrize("step_back", [0.05, 0.45, 30.0])
def test_a_clock_that_steps_back_neither_refuses_new_scans_nor_trusts_old_ones(step_back):
    buffer = ObservationBuffer(Source(expected_update_rate=0.5, observation_persistence=9.0))
    router = router_of(buffer)
    scan = replace(SCAN, stamp=100.0)
    router.route({"scan": scan}, 100.0, None)
    assert router.silent(100.4) is None

    # The source counts as silent for a step back of any size.
    earlier_time = 100.4 - step_back
    assert router.silent(earlier_time) == ("scan", 0.5)

    # Its next scan is taken.
    router.route({"scan": replace(scan, stamp=earlier_time)}, earlier_time, None)
    assert stamps(buffer) == [earlier_time]
    assert router.silent(earlier_time) is None


def test_an_observation_older_than_the_latest_on_its_topic_is_dropped():
    of_scan = ObservationBuffer(Source(topic="scan", observation_persistence=9.0))
    of_other = ObservationBuffer(Source(topic="other", observation_persistence=9.0))
    router = router_of(of_scan, of_other)
    scan = replace(SCAN, stamp=100.0)
    older_scan = replace(scan, stamp=99.9)
    newer_scan = replace(scan, stamp=100.1)
    for sensed in (
        {"scan": scan},
        {"scan": older_scan, "other": older_scan},
        {"scan": newer_scan},
    ):
        router.route(sensed, 100.1, None)
    assert stamps(of_scan) == [100.1, 100.0]
    assert stamps(of_other) == [99.9]
    assert router.silent(100.41) == ("other", 0.5)


@pytest.mark.parametrize(
    ("data_type", "clearing", "must_speak"),
    [
        ("LaserScan", False, True),
        ("PointCloud2", True, True),
        ("PointCloud2", False, False),  # a bumper, which reports only contacts
    ],
)
def test_lasers_and_sources_that_clear_must_speak_unless_scan_timeout_is_0(
    data_type, clearing, must_speak
):
    source = Source(topic="front", data_type=data_type, clearing=clearing)
    expected = ("front", 0.5) if must_speak else None
    assert router_of(ObservationBuffer(source)).silent(1.0) == expected
    assert router_of(ObservationBuffer(source), scan_timeout=0.0).silent(1.0) is None


@pytest.mark.parametrize("enabled", [True, False])
def test_a_layer_that_is_switched_off_has_no_expected_rate_but_its_laser_must_speak(enabled):
    buffer = ObservationBuffer(Source(expected_update_rate=0.2))
    router = router_of(buffer, enabled=enabled)
    router.route({"scan": replace(SCAN, stamp=10.0)}, 10.0, None)
    # Later than the expected rate, and then later than the router's patience
    assert router.silent(10.3) == (("scan", 0.2) if enabled else None)
    assert router.silent(10.6) == ("scan", 0.2 if enabled else 0.5)


# Of half the yaw of LEVEL, for quaternions
SINE = math.sin(0.15)
COSINE = math.cos(0.15)
LEVEL = LaserScan(
    stamp=0.0,
    angle_min=0.2,
    angle_increment=0.5,
    range_min=0.1,
    range_max=10.0,
    ranges=np.array([1.0, 2.0, math.inf], np.float32),
    sensor_pose=(1.0, 2.0, 0.3),
    sensor_height=0.4,
)
# Rolled by pi, at the yaw of LEVEL
HANGING = replace(
    LEVEL,
    sensor_pose=(1.0, 2.0, 0.0),
    rotation=(COSINE, SINE, 0.0, 0.0),
)
# Pitched by 0.4 rad
CAMERA = SensorCloud(
    0.0,
    np.array(
        [
            [1.0, 0.0, 0.5],
            [math.nan, 0.0, 0.0],
        ],
        np.float32,
    ),
    (0.1, 0.2, 0.3),
    (0.0, math.sin(0.2), 0.0, math.cos(0.2)),
    (0.0, 0.0, 1.0),
)


def test_points_of_tilted_sensors_are_exact():
    # A rotation by the yaw alone gives the same points as the pose of a level sensor.
    flat_scan = replace(
        LEVEL,
        sensor_pose=(1.0, 2.0, 9.9),
        rotation=(0.0, 0.0, SINE, COSINE),
    )
    np.testing.assert_allclose(project(flat_scan).points, project(LEVEL).points, atol=1e-6)

    # A sensor that hangs upside down sees its beams clockwise.
    distances = LEVEL.ranges[:2]
    angles = 0.3 - np.array([0.2, 0.7])
    x = 1.0 + distances * np.cos(angles)
    y = 2.0 + distances * np.sin(angles)
    expected_points = np.column_stack([x, y, [0.4, 0.4]])
    np.testing.assert_allclose(project(HANGING).points, expected_points, atol=1e-6)

    # The camera's first point is 1 m ahead of it and 0.5 m above.
    x, _, z = observe(CAMERA).points[0] - CAMERA.position
    assert x == pytest.approx(math.cos(0.4) + 0.5 * math.sin(0.4), abs=1e-6)
    assert z == pytest.approx(0.5 * math.cos(0.4) - math.sin(0.4), abs=1e-6)


@pytest.mark.parametrize(
    "sensed",
    [
        pytest.param(LEVEL, id="level"),
        pytest.param(HANGING, id="hanging"),
        pytest.param(CAMERA, id="camera"),
    ],
)
def test_observations_can_be_moved_to_another_frame(sensed):
    frame = (5.0, -1.0, 1.1)
    in_sensor_frame = observe(sensed)
    in_other_frame = observe(moved(sensed, frame))
    assert len(in_other_frame.points) == len(in_sensor_frame.points) > 0
    x, y, _ = in_sensor_frame.points.T
    moved_x, moved_y, _ = in_other_frame.points.T
    np.testing.assert_allclose((moved_x, moved_y), transform_point(frame, x, y), atol=1e-5)
    x, y, z = in_sensor_frame.origin
    expected_origin = (*transform_point(frame, x, y), z)
    np.testing.assert_allclose(in_other_frame.origin, expected_origin, atol=1e-12)


def test_obstacles_under_the_robot_are_also_cleared_with_a_map():
    seen = ObstacleLayer("seen", ObstacleParameters(), (Source(),), 0)
    costmap = make_costmap(StaticLayer("static", StaticParameters()), seen)
    costmap.set_map("map", map_of(0))
    under_the_robot = (0.05, 0.05, 0.0)
    beside = (1.05, 0.05, 0.0)
    points = np.array([under_the_robot, beside], np.float32)
    # The sensor is elsewhere, so that no ray clears the cell under the robot.
    see(costmap, HERE, PointCloud((1.5, 1.5, 0.3), points, 0.0))
    assert costmap.cells[20, 20] == 0
    assert costmap.cells[20, 30] == LETHAL


# -- move_base on a map ----------------------------------------------------------------------------
def on_a_map(planner, **changes):
    """Return MoveBase with small costmaps, the global one with a static layer in the frame map."""
    tree = copy.deepcopy(quick(**changes))
    tree["global_costmap"]["global_frame"] = "map"
    tree["global_costmap"]["plugins"].insert(0, STATIC_LAYER)
    if planner == "DWAPlannerROS":
        tree["base_local_planner"] = "dwa_local_planner/DWAPlannerROS"
        tree["DWAPlannerROS"] = DWA_PARAMETERS
    return MoveBase(tree)


@pytest.mark.parametrize("planner", ["TrajectoryPlannerROS", "DWAPlannerROS"])
def test_a_goal_in_the_map_while_localisation_drifts(planner):
    """The odometry frame rotates and drifts in the map. A post on the way is missing in the map."""
    move_base = on_a_map(planner)
    goal = (4.0, 0.0, 0.0)
    posts = [(0.6, 0.3, 0.15)]
    for y in np.arange(-2.5, 3.0, 0.1):
        is_door = 0.9 < y < 2.1
        if not is_door:
            posts.append((2.1, y, 0.05))
    post_x, post_y, radius = np.transpose(posts)
    robot = ToyRobot(HERE, posts)
    move_base.set_map(wall_with_a_door())
    move_base.set_goal(goal, 0.0)
    # 80 s in cycles of 0.05 s; scans come in every second one.
    for step in range(1600):
        time = robot.time
        odom_in_map = (
            1.0 + 0.01 * time,
            -2.0 - 0.006 * time,
            0.7 + 0.004 * time,
        )
        map_in_odom = inverse(odom_in_map)
        odom_pose = compose(map_in_odom, robot.pose)
        scan = None
        if step % 2 == 0:
            scan = moved(robot.scan(), map_in_odom)
        cycle = move_base.step(time, odom_pose, robot.twist, scan, odom_in_map)
        robot.drive(cycle.command, 0.05)
        x, y, _ = robot.pose
        distances = np.hypot(post_x - x, post_y - y) - radius
        assert distances.min() > 0.15
        if cycle.result:
            break
    assert cycle.result == ("succeeded", "Goal reached.")
    away_x, away_y, away_yaw = compose(inverse(goal), robot.pose)
    assert math.hypot(away_x, away_y) < 0.4
    assert abs(math.remainder(away_yaw, 2 * math.pi)) < 0.3
    assert move_base.global_costmap.size == (200, 120)
    assert move_base.local_costmap.size == (120, 120)


def with_static_layer(costmap_name, costmap_values, **static_values):
    """Return MoveBase whose costmap of this name has other values, and a static layer. The global
    costmap is in the frame map, the local one in odom.
    """
    tree = copy.deepcopy(quick())
    tree["global_costmap"]["global_frame"] = "map"
    costmap = tree[costmap_name]
    costmap.update(costmap_values, static=static_values)
    costmap["plugins"].insert(0, STATIC_LAYER)
    return MoveBase(tree)


@pytest.mark.parametrize(
    ("costmap_name", "map_frame", "post", "expected"),
    [
        # The odometry's frame is at (2, 1) in the map's, turned to the left.
        ("local_costmap", "map", (2.0, 3.0), (2.0, 0.0)),
        ("global_costmap", "odom", (2.0, 0.0), (2.0, 3.0)),
        ("local_costmap", "odom", (2.0, 0.0), (2.0, 0.0)),
        ("global_costmap", "map", (2.0, 3.0), (2.0, 3.0)),
    ],
)
def test_a_rolling_costmap_shows_a_map_of_either_frame_in_its_own(
    costmap_name, map_frame, post, expected
):
    rolling = {"rolling_window": True, "width": 6, "height": 6}
    move_base = with_static_layer(costmap_name, rolling)
    static_map = free_map(100, 100, 0.1, (-5.0, -5.0), map_frame)
    column, row = (round((coordinate + 5.0) / 0.1) for coordinate in post)
    # 2 x 2 cells around the post
    static_map.cells[row - 1 : row + 1, column - 1 : column + 1] = 100
    move_base.set_map(static_map)
    move_base.step(0.0, HERE, (0.0, 0.0), local_origin=(2.0, 1.0, 0.5 * math.pi))
    costmap = move_base.costmaps[costmap_name]
    rows, columns = np.nonzero(costmap.cells == LETHAL)
    x = costmap.origin[0] + (columns.mean() + 0.5) * costmap.resolution
    y = costmap.origin[1] + (rows.mean() + 0.5) * costmap.resolution
    assert (x, y) == pytest.approx(expected, abs=costmap.resolution)


@pytest.mark.parametrize("subscribes", [(True, False), (False, True)])
def test_a_topic_has_updates_if_one_of_its_static_layers_takes_them(subscribes):
    tree = quick()
    for costmap_name, takes_updates in zip(("global_costmap", "local_costmap"), subscribes):
        costmap = tree[costmap_name]
        costmap["plugins"] = [STATIC_LAYER, *costmap["plugins"]]
        costmap["static"] = {"subscribe_to_updates": takes_updates}
    assert MoveBase(tree).map_topics == {"map": True}


def lethal_after_a_reset(move_base):
    """Return whether a cell of the global costmap is lethal after a reset."""
    move_base.reset(1.0)
    move_base.step(1.0, HERE, (0.0, 0.0))
    return bool((move_base.global_costmap.cells == LETHAL).any())


@pytest.mark.parametrize("subscribes", [True, False])
def test_a_reset_keeps_the_updates_of_a_map(subscribes):
    move_base = with_static_layer("global_costmap", {}, subscribe_to_updates=subscribes)
    move_base.set_map(free_map(100, 100, 0.1, (-5.0, -5.0)))
    move_base.update_map("map", 70, 50, np.full((2, 2), 100, np.int8))
    assert lethal_after_a_reset(move_base) is subscribes


@pytest.mark.parametrize("first_only", [True, False])
def test_a_reset_shows_the_map_that_was_in_use(first_only):
    move_base = with_static_layer("global_costmap", {}, first_map_only=first_only)
    assert move_base.missing_map == "map"
    move_base.set_map(free_map(40, 40, 0.1, (-2.0, -2.0)))
    move_base.set_map(map_of(100))
    assert lethal_after_a_reset(move_base) is not first_only
    assert move_base.missing_map == ""


@pytest.mark.parametrize("allowed", [True, False])
def test_unknown_space_blocks_plans_only_if_it_is_not_allowed(allowed):
    unknown_band = free_map(120, 200, 0.05, (-3.0, -3.0))
    unknown_band.cells[:, 100:103] = -1
    tree = on_a_map("TrajectoryPlannerROS", NavfnROS={"allow_unknown": allowed}).parameters
    # Otherwise free cells replace unknown.
    tree["global_costmap"]["track_unknown_space"] = True
    move_base = MoveBase(tree)
    move_base.set_map(unknown_band)
    move_base.step(0.0, HERE, (0.0, 0.0))
    plan = move_base.plan(HERE, (5.0, 0.0, 0.0))
    assert (len(plan) > 0) is allowed


def test_a_rolling_costmap_refuses_a_map_in_a_third_frame():
    tree = quick()
    tree["local_costmap"]["plugins"].insert(0, STATIC_LAYER)
    move_base = MoveBase(tree)
    refusal = "frame cellar, which the rolling local_costmap cannot use: publish it in"
    with pytest.raises(ApplrError, match=refusal):
        move_base.set_map(free_map(5, 5, 0.1, (0.0, 0.0), "cellar"))
    # The rejected map was not kept.
    move_base.reset(1.0)
    # The name of the rolling costmap's own frame; C++ takes the leading slash off.
    tree["local_costmap"]["global_frame"] = "/odom"
    MoveBase(tree).set_map(free_map(5, 5, 0.1, (0.0, 0.0), "odom"))


def test_observations_of_a_robot_without_a_pose_do_not_enter_the_map():
    move_base = on_a_map("TrajectoryPlannerROS")
    robot = ToyRobot(HERE, [(1.0, 0.0, 0.15)])
    move_base.set_map(free_map(120, 240, 0.05, (-3.0, -3.0)))
    # Pose of the odometry's frame in the map's
    origin = (5.0, 0.0, 0.0)
    # This scan has come before the place of the odometry in the map is known.
    move_base.step(0.0, None, (0.0, 0.0), robot.scan())
    move_base.step(0.1, HERE, (0.0, 0.0), local_origin=origin)
    assert (move_base.local_costmap.cells == LETHAL).any()
    assert not (move_base.global_costmap.cells == LETHAL).any()

    robot.time = 0.2
    move_base.step(0.2, HERE, (0.0, 0.0), robot.scan(), local_origin=origin)
    _, columns = np.nonzero(move_base.global_costmap.cells == LETHAL)
    x = columns * 0.05 - 3.0
    # The post 1 m ahead of the odometry's origin, which is at 5 m in the map.
    assert 5.7 < x.min() <= x.max() < 6.3


def test_an_unexpectedly_silent_source_stops_the_robot():
    tree = quick()
    layer = tree["local_costmap"]["obstacles_layer"]
    layer["observation_sources"] = "scan bump depth"
    # The bumper reports only contacts.
    layer["bump"] = {"data_type": "PointCloud2"}
    layer["depth"] = {
        "data_type": "PointCloud2",
        "topic": "points",
        "expected_update_rate": 0.32,
    }
    move_base = MoveBase(tree)
    robot = ToyRobot(HERE)
    assert move_base.sources == {
        "front/scan": "LaserScan",
        "bump": "PointCloud2",
        "points": "PointCloud2",
    }
    move_base.set_goal((3.0, 0.0, 0.0), 0.0)
    point = np.array([[1.0, 1.0, 0.3]], np.float32)
    depth_cloud = SensorCloud(0.0, point, HERE, (0.0, 0.0, 0.0, 1.0))
    sensed = {"front/scan": robot.scan(), "points": depth_cloud}
    cycle = move_base.step(0.0, robot.pose, robot.twist, sensed)
    assert not cycle.stale
    column, row = move_base.local_costmap.world_to_map(1.0, 1.0)
    assert move_base.local_costmap.cells[row, column] == LETHAL

    # The depth camera falls silent.
    for step in range(1, 12):
        robot.time = 0.05 * step
        sensed = {"front/scan": robot.scan()}
        cycle = move_base.step(robot.time, robot.pose, robot.twist, sensed)
        # Silent from 0.35 s on; the depth camera's expected_update_rate is 0.32 s.
        assert cycle.stale is (step > 6)
    assert cycle.silent == ("points", 0.32)
    assert cycle.command == (0.0, 0.0)


def test_the_latest_observation_of_each_sensor_on_a_topic_counts_between_two_updates():
    buffer = ObservationBuffer(Source())
    no_points = np.zeros((0, 3), np.float32)
    # Two sensors in turn, as drivers of two lasers publish on one topic
    for number in range(4):
        stamp = 0.2 * number
        buffer.add_cloud(PointCloud(HERE, no_points, stamp, frame="front"), stamp)
        stamp += 0.1
        buffer.add_cloud(PointCloud(HERE, no_points, stamp, frame="rear"), stamp)
    assert [cloud.frame for cloud in buffer.clouds] == ["rear", "front"]
    assert stamps(buffer) == pytest.approx([0.7, 0.6])
    buffer.add_cloud(PointCloud(HERE, no_points, 2.0, frame="rear"), 2.0)
    assert stamps(buffer) == [2.0], "the front sensor has fallen silent"


def test_an_observation_keeps_its_sensors_frame():
    scan = replace(SCAN, frame="rear")
    cloud = replace(CAMERA, frame="depth")
    assert observe(moved(scan, (1.0, 0.0, 0.0))).frame == "rear"
    assert observe(moved(cloud, (1.0, 0.0, 0.0))).frame == "depth"
