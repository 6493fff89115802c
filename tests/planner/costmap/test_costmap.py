"""Tests of the layered costmap: recorded drives byte for byte, rolling, windows and versions."""

import json
import math
import zlib

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import LaserScan, PointCloud, Source, project
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.inflation_layer import InflationLayer, InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleLayer, ObstacleParameters
from tests.support import ROOT
from tests.support.scenes import laser_costmap, see

DRAWN = ROOT / "tests" / "golden_drawn"
HERE = (0.0, 0.0, 0.0)


def local(**arguments):
    """Return the Jackal's local costmap."""
    return laser_costmap(
        10, 10, 0.05, rolling=True, inflation=InflationParameters(0.3), **arguments
    )


def fixed(n=80, **arguments):
    """Return a fixed costmap of n x n cells, centred at the origin."""
    # Half a cell more, because the size is divided by the resolution and rounded down.
    size = (n + 0.5) * 0.05
    origin = (-n * 0.025, -n * 0.025)
    usual_arguments = {"inflation": InflationParameters(0.3)}
    return laser_costmap(size, size, 0.05, origin, **{**usual_arguments, **arguments})


def hit(x, y):
    """Return a cloud of one point [m], seen from the origin."""
    return PointCloud((0.0, 0.0, 0.0), np.array([[x, y, 0.0]], np.float32))


@pytest.mark.parametrize("drive", json.loads((DRAWN / "drives.json").read_text()))
def test_drives_equal_the_recorded_ones(drive):
    """Each step leads to the recorded cells and origin. tests/golden/FORMAT.md describes the
    recorded events.
    """
    ranges = np.load(DRAWN / "drives.npz")["ranges"]
    obstacles = ObstacleParameters(**drive["obstacles"])
    default = 255 if drive["track_unknown"] else 0
    inflation = InflationParameters(**drive["inflation"])
    layers = (
        ObstacleLayer("seen", obstacles, (Source(**drive["source"]),), default),
        InflationLayer("inflated", inflation),
    )
    costmap = Costmap(
        *drive["size"],
        drive["resolution"],
        drive["origin"],
        drive["rolling"],
        np.array(drive["footprint"]),
        drive["track_unknown"],
        layers,
    )
    for step in drive["steps"]:
        cloud = None
        if "scan" in step:
            number, sensor_pose, sensor_height, inf_is_valid = step["scan"]
            scan = LaserScan(
                stamp=0.0,
                angle_min=-0.75 * math.pi,
                angle_increment=1.5 * math.pi / 179,
                range_min=0.1,
                range_max=30.0,
                ranges=ranges[number],
                sensor_pose=sensor_pose,
                sensor_height=sensor_height,
            )
            cloud = project(scan, inf_is_valid)
        for call, arguments, values in step["events"]:
            getattr(costmap, call)(*arguments, **values)
        version = costmap.version
        cells = costmap.cells.copy()
        origin = costmap.origin.copy()
        if cloud is None:
            costmap.update_costs(step["pose"])
        else:
            see(costmap, step["pose"], cloud)
        master_checksum = zlib.crc32(costmap.cells.tobytes())
        obstacle_checksum = zlib.crc32(costmap.obstacle_layers[0].cells.tobytes())
        recorded = [master_checksum, obstacle_checksum, costmap.origin.tolist()]
        assert recorded == step["expected"]

        # The reported rectangle contains all changes; None means that there are none.
        differs = cells != costmap.cells
        window = costmap.changed_since(version)
        if window is None:
            assert costmap.version == version
            assert not differs.any()
            assert (origin == costmap.origin).all()
        else:
            left, bottom, right, top = window
            differs[bottom:top, left:right] = False
            assert not differs.any()


def test_a_pose_that_is_not_finite_is_rejected():
    for pose in ((math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)):
        with pytest.raises(ApplrError, match="finite"):
            local().update_costs(pose)


def test_a_far_jump_empties_the_map():
    costmap = local()
    see(costmap, HERE, hit(1.0, 0.0))
    assert (costmap.cells == 254).any()
    costmap.update_costs((100.0, 100.0, 0.0))
    assert not costmap.cells.any()
    assert not costmap.obstacle_layers[0].cells.any()


def test_windows_and_versions_report_changes():
    costmap = fixed()
    see(costmap, HERE, hit(1.02, 0.02))
    assert costmap.window == (0, 0, 80, 80)  # The first pass is a full one.
    version = costmap.version
    costmap.update_costs(HERE)
    # From the rear of the padded footprint to the obstacle, each with the inflation radius
    left, _, right, _ = costmap.window
    assert left == int((-0.31 - 0.3 + 2) / 0.05)
    assert right == int((1.02 + 0.3 + 2) / 0.05) + 1
    assert costmap.version == version
    assert costmap.changed_since(version) is None
    see(costmap, HERE, hit(1.07, 0.02))
    assert costmap.version > version
    assert costmap.changed_since(version) is not None
    # Of versions that it never had, the costmap only knows that everything may differ.
    assert costmap.changed_since(-1) == (0, 0, 80, 80)
    assert costmap.changed_since(version + 99) == (0, 0, 80, 80)


def test_changes_are_remembered_for_a_while():
    costmap = fixed()
    versions = []
    # One of three cells in a row changes at a time.
    for index in range(100):
        versions.append(costmap.version)
        column = 5 + index % 3
        costmap.cells[5, column] = 7
        costmap.set_free(column, 5, column + 1, 6)
    assert costmap.changed_since(versions[-1]) == (5, 5, 6, 6)
    assert costmap.changed_since(versions[-3]) == (5, 5, 8, 6)
    # The earliest changes are forgotten: the whole map may differ.
    assert costmap.changed_since(versions[0]) == (0, 0, 80, 80)
    costmap.set_free(5, 5, 8, 6)  # All of these cells are free already.
    assert costmap.changed_since(versions[-1]) == (5, 5, 6, 6)


def test_without_bounds_nothing_happens():
    costmap = fixed(obstacles=ObstacleParameters(footprint_clearing_enabled=False))
    costmap.update_costs(HERE)
    # No layer has anything to change, so that even a cell that somebody else changed stays.
    costmap.cells[3, 3] = 9
    costmap.update_costs(HERE)
    assert costmap.window is None
    assert costmap.cells[3, 3] == 9


def test_a_snapshot_restores_place_and_obstacles_after_the_map_has_moved():
    costmap = local()
    unmoved_costmap = local()
    for new_costmap in (costmap, unmoved_costmap):
        see(new_costmap, HERE, hit(1.02, 0.02))
    snapshot = costmap.snapshot()
    see(costmap, (1.0, 0.5, 0.0), hit(2.02, 0.52))
    version = costmap.version
    costmap.restore(snapshot)
    assert costmap.version > version
    assert costmap.origin.tolist() == unmoved_costmap.origin.tolist()
    assert costmap.obstacle_layers[0].origin.tolist() == unmoved_costmap.origin.tolist()
    assert (costmap.cells == unmoved_costmap.cells).all()
    assert (costmap.obstacle_layers[0].cells == unmoved_costmap.obstacle_layers[0].cells).all()


@pytest.mark.parametrize(("pose", "radius"), [(None, 0.3), (HERE, 0.2)])
def test_a_snapshot_is_inflated_by_the_current_parameters_if_the_pose_is_given(pose, radius):
    # Given: a snapshot with an inflation radius of 0.3 m, and 0.2 m since then
    costmap = fixed()
    see(costmap, HERE, hit(1.02, 0.02))
    snapshot = costmap.snapshot()
    costmap.configure("inflater_layer", inflation_radius=0.2)
    see(costmap, HERE, hit(0.02, 1.02))

    costmap.restore(snapshot, pose)

    expected_costmap = fixed(inflation=InflationParameters(radius))
    see(expected_costmap, HERE, hit(1.02, 0.02))
    assert (costmap.cells == expected_costmap.cells).all()
