"""Small worlds and drives for tests of simulators."""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np

from sim_bridge import RobotState, Simulator
from worlds import Course, Mover, World

STEP = 0.05  # simulated time between commands [s]


def small_world(
    cylinders: Sequence[Sequence[float]] = (),
    boxes: Sequence[Sequence[float]] = (),
    movers: Sequence[Mover] = (),
    start: Tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> World:
    """Return a world of cylinders (x, y, radius), boxes (x, y, yaw, size_x, size_y) and moving obstacles [m, rad]."""
    path = np.array([start[:2], (start[0] + 1.0, start[1])])
    return World(
        name="scene",
        cylinders=np.array(cylinders, dtype=np.float64).reshape(-1, 3),
        boxes=np.array(boxes, dtype=np.float64).reshape(-1, 5),
        movers=tuple(movers),
        course=Course(start=start, goal=start, finish_y=None, goal_tolerance=0.4, path=path),
    )


def drive(
    simulator: Simulator, v: float, w: float, seconds: float, step: float = STEP
) -> RobotState:
    """Repeat the command (v, w) [m/s, rad/s] for some simulated seconds, and return the last state."""
    for _ in range(int(round(seconds / step))):
        simulator.command(v, w)
        simulator.advance(step)
    return simulator.state
