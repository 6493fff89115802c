"""The layered costmap: whole drives byte for byte against the plain version, rolling, windows, versions, requests."""

import math
from dataclasses import replace

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.costmap.costmap import Costmap, LayerDescription
from applr_ros1.planner.costmap.inflation_layer import InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleParameters
from applr_ros1.planner.costmap.scan import PointCloud, Source, project
from tests.support import map_scenes
from tests.support.plain_maps import PlainCostmap
from tests.support.seeds import seeds

HERE = (0.0, 0.0, 0.0)


def local(**arguments):
    """The Jackal's local map."""
    return Costmap(
        10, 10, 0.05, rolling=True, footprint=map_scenes.JACKAL, inflation=InflationParameters(0.3), **arguments
    )


def fixed(n=80, **arguments):
    size = (n + 0.5) * 0.05
    arguments = dict(dict(footprint=map_scenes.JACKAL, inflation=InflationParameters(0.3)), **arguments)
    return Costmap(size, size, 0.05, (-n * 0.025, -n * 0.025), **arguments)


def hit(x, y):
    return PointCloud((0.0, 0.0, 0.0), np.array([[x, y, 0.0]], np.float32))


@seeds(16)
def test_drives_equal_the_plain_costmap(seed):
    """A random drive among cylinders with everything that can happen to a costmap, compared after every update."""
    rng = np.random.default_rng(seed)
    rolling, track_unknown = bool(seed % 2), seed % 5 == 4
    nx, ny = (int(v) for v in rng.integers(40, 100, 2))
    resolution = float(rng.choice((0.05, 0.05, 0.1, 0.037)))
    obstacles = ObstacleParameters(
        combination_method=int(rng.choice((0, 1, 1, 1, 2))),
        footprint_clearing_enabled=bool(rng.random() < 0.8),
        max_obstacle_height=float(rng.choice((1.0, 2.0, 2.0))),
    )
    source = Source(
        obstacle_range=float(rng.choice((2.5, 1.5))),
        raytrace_range=float(rng.choice((3.0, 1.2))),
        min_obstacle_height=float(rng.choice((0.0, 0.0, 0.5))),
        max_obstacle_height=float(rng.choice((1.5, 2.0, 2.0))),
        marking=seed % 5 != 2,
        clearing=seed % 4 != 3,
    )
    inflation = InflationParameters(
        float(rng.choice((0.3, 0.28, 0.6))), float(rng.choice((10.0, 3.0, 0.0))), True, bool(rng.random() < 0.3)
    )
    footprint = map_scenes.JACKAL * rng.choice((1.0, 1.0, 0.4, 1.6))
    if seed % 7 == 6:
        footprint = footprint[:2]
    origin = (0.0, 0.0) if rolling else (-nx * resolution / 2, -ny * resolution / 2)
    fast = Costmap(
        (nx + 0.5) * resolution,
        (ny + 0.5) * resolution,
        resolution,
        origin,
        rolling,
        footprint,
        track_unknown,
        layers=(LayerDescription("seen", obstacles, (source,)), LayerDescription("inflated", inflation)),
    )
    plain = PlainCostmap(
        nx, ny, resolution, origin, rolling, footprint, 255 if track_unknown else 0, obstacles, source, inflation
    )
    circles = map_scenes.cylinders(rng, float(rng.choice((4.0, 8.0))), float(rng.uniform(0.1, 0.45)))
    for pose in map_scenes.drive(rng, 25, step=float(rng.choice((0.08, 0.3)))):
        seen = None
        if rng.random() < 0.85:
            sensor = (pose[0] + 0.12 * math.cos(pose[2]), pose[1] + 0.12 * math.sin(pose[2]), pose[2])
            if rng.random() < 0.05:  # a sensor off the map
                sensor = (pose[0] - 9.0, *sensor[1:])
            height = float(rng.choice((0.0, 0.5, 1.0, 1.5, 2.0, 2.5), p=(0.1, 0.3, 0.3, 0.1, 0.1, 0.1)))
            seen = project(map_scenes.laser(circles, sensor, rng, height=height), bool(rng.integers(2)))
        event = rng.random()
        if event < 0.08:
            inflation = replace(inflation, inflation_radius=float(rng.choice((0.0, 0.1, 0.35, 0.6, 1.4))))
        elif event < 0.11:
            inflation = replace(inflation, enabled=not inflation.enabled)
        elif event < 0.14:
            fast.clear_outside(pose, 1.5)
            plain.clear_outside(pose, 1.5)
        elif event < 0.17:
            fast.clear()
            plain.clear()
        elif event < 0.20:
            obstacles = replace(obstacles, enabled=not obstacles.enabled)
            fast.configure(fast.obstacles.name, enabled=obstacles.enabled)
            plain.obstacles = obstacles
        elif event < 0.25:
            mx, my = fast.world_to_map(*pose[:2])
            if mx >= 0:
                fast.set_free(mx, my, mx + 1, my + 1)
                plain.master[my, mx] = 0
        if inflation != fast.inflation.parameters:
            fast.configure(fast.inflation.name, **vars(inflation))
            plain.set_inflation(inflation)
        version, cells, origin = fast.version, fast.cells.copy(), fast.origin.copy()
        fast.update(pose, seen)
        plain.update(pose, seen)
        np.testing.assert_array_equal(fast.cells, plain.master)
        np.testing.assert_array_equal(fast.obstacles.cells, plain.layer)
        assert list(fast.origin) == plain.origin
        differs, rect = cells != fast.cells, fast.changed_since(version)
        if rect is None:
            assert fast.version == version
            assert not differs.any()
            assert (origin == fast.origin).all()
        else:
            differs[rect[1] : rect[3], rect[0] : rect[2]] = False
            assert not differs.any()


def test_sizes():
    assert (Costmap(10, 10, 0.05).size, Costmap(40, 20, 0.05).cells.shape) == ((200, 200), (400, 800))


def test_a_pose_that_is_none():
    for pose in ((math.nan, 0.0, 0.0), (0.0, math.inf, 0.0)):
        with pytest.raises(ApplrError, match="finite"):
            local().update(pose)


def test_a_far_jump_empties_the_map():
    costmap = local()
    costmap.update(HERE, hit(1.0, 0.0))
    assert (costmap.cells == 254).any()
    costmap.update((100.0, 100.0, 0.0))
    assert not costmap.cells.any()
    assert not costmap.obstacles.cells.any()


def test_window_and_version():
    costmap = fixed(footprint=map_scenes.JACKAL)
    costmap.update(HERE, hit(1.02, 0.02))
    assert costmap.window == (0, 0, 80, 80)  # the first pass is a full one
    version = costmap.version
    costmap.update(HERE)
    x0, y0, xn, yn = costmap.window
    assert (x0, xn) == (int((-0.31 - 0.3 + 2) / 0.05), int((1.02 + 0.3 + 2) / 0.05) + 1)
    assert costmap.version == version
    assert costmap.changed_since(version) is None
    costmap.update(HERE, hit(1.07, 0.02))
    assert costmap.version > version
    assert costmap.changed_since(version) is not None
    assert costmap.changed_since(-1) == (0, 0, 80, 80) == costmap.changed_since(version + 99)


def test_changes_are_remembered_for_a_while():
    costmap, versions = fixed(), []
    for i in range(100):
        versions.append(costmap.version)
        costmap.cells[5, 5 + i % 3] = 7
        costmap.set_free(5 + i % 3, 5, 6 + i % 3, 6)
    assert costmap.changed_since(versions[-1]) == (5, 5, 6, 6)
    assert costmap.changed_since(versions[-3]) == (5, 5, 8, 6)
    assert costmap.changed_since(versions[0]) == (0, 0, 80, 80)
    costmap.set_free(5, 5, 8, 6)  # nothing there any more
    assert costmap.changed_since(versions[-1]) == (5, 5, 6, 6)


def test_without_bounds_nothing_happens():
    costmap = fixed(obstacles=ObstacleParameters(footprint_clearing_enabled=False))
    costmap.update(HERE)
    costmap.cells[3, 3] = 9
    costmap.update(HERE)
    assert costmap.window is None
    assert costmap.cells[3, 3] == 9
