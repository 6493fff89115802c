"""Small scenes for tests of the planner: cellular worlds, one-off inflation, an open map, a static map."""

from types import SimpleNamespace

import numpy as np

from applr_ros1.planner.costmap import footprint as footprints
from applr_ros1.planner.costmap.inflation_layer import InflationLayer
from applr_ros1.planner.costmap.static_layer import StaticMap
from applr_ros1.planner.trajectory.sampling import fill_evenly, velocity_window

JACKAL = footprints.pad(
    footprints.parse("[[-0.21,-0.165],[-0.21,0.165],[0.21,0.165],[0.21,-0.165]]"), 0.1
)


def cellular(rng, ny, nx, fill, steps=3):
    """Return obstacles (ny, nx) bool of a cellular automaton as in BARN. A random share `fill` is occupied at first."""
    grid = rng.random((ny, nx)) < fill
    for _ in range(steps):
        around = sum(
            np.roll(np.roll(grid, dy, 0), dx, 1).astype(int)
            for dy in (-1, 0, 1)
            for dx in (-1, 0, 1)
            if dx or dy
        )
        grid = np.where(around >= 5, True, np.where(around <= 1, False, grid))
    return grid


def inflate(master, window, resolution, inscribed, parameters):
    """Inflate a window of the cells in place, with a new layer."""
    layer = InflationLayer(*master.shape[::-1], resolution, parameters)
    layer.set_inscribed_radius(inscribed)
    layer.update(master, master.copy(), window)


def open_map(nx=200, ny=200, resolution=0.05, origin=(-5.0, -5.0), foot=JACKAL):
    """Return an empty map with the costmap attributes that a local planner reads."""
    cells = np.zeros((ny, nx), np.uint8)
    return SimpleNamespace(cells=cells, origin=origin, resolution=resolution, footprint=foot)


def straight(length=3.0, yaw=0.0, step=0.05):
    """Return a plan (n, 3) along x from 0 to `length` that ends with the heading `yaw`."""
    x = np.arange(0.0, length + step / 2, step)
    plan = np.column_stack([x, 0 * x, 0 * x])
    plan[-1, 2] = yaw
    return plan


def wall_with_a_door():
    """Return a map of 10 x 6 m with a wall at x = 2 m, a door of 1.2 m at y = 1.5 m, and unknown space far away."""
    cells = np.zeros((120, 200), np.int8)
    cells[:, 100:103] = 100
    cells[78:102, 100:103] = 0
    cells[:10] = -1
    return StaticMap(cells, 0.05, (-3.0, -3.0), "map")


def paint(costmap, cells):
    """Write the non-zero cells (ny, nx) into a costmap's master grid, and inflate the whole map."""
    np.copyto(costmap._base, costmap.cells)
    np.copyto(costmap._base, cells, where=np.asarray(cells) != 0)
    for layer in costmap.inflation_layers:
        layer.update(costmap.cells, costmap._base, (0, 0) + costmap.size)
    costmap._changed((0, 0) + costmap.size)


def sampled_window(planner):
    """Return ranges and steps of a TrajectoryPlanner's last samples: {"min_vel_x", "max_vel_x", "dvx", ...}."""
    x0, x1, w0, w1 = velocity_window(planner._params[0], planner._plan, planner._scratch.start[0])
    dvx, dw = fill_evenly(x0, x1, planner._scratch.vs), fill_evenly(w0, w1, planner._scratch.ws)
    names = "min_vel_x", "max_vel_x", "dvx", "min_vel_theta", "max_vel_theta", "dvtheta"
    return dict(zip(names, (x0, x1, dvx, w0, w1, dw)))
