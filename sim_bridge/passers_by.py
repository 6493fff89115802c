"""Moving obstacles of one drive, of which those that look get out of the way of a robot.

Who sees the robot in the way stands, and steps aside until the way is free. So a robot that drives
on is waited for, and one that stands is passed. Whoever has passed returns to the path. All others
follow their animations, whatever the robot does.
"""

from __future__ import annotations

import numpy as np

from applr_ros1.common.angles import Pose
from applr_ros1.common.arrays import Array
from worlds import World

SIGHT_M = 1.0  # gap to a robot below which it is seen [m]
SIDE_GAP_M = 0.1  # gap to a robot at which somebody walks past it [m]
ASIDE_M_S = 0.5  # speed of steps aside [m/s]
RETURN_S = 2.0  # time constant of the return to the path [s]
X_AND_Y = (1.0, 1j, 0.0)  # factors that make x + i y of a circle
HEADING_S = 0.01  # time ahead on an animation that gives the direction of the way [s]


class PassersBy:
    """Moving obstacles of a world from time 0 on.

    Args:
        world: World with the obstacles.
        robot_radius: Radius of a circle around the robot [m].
    """

    def __init__(self, world: World, robot_radius: float) -> None:
        self._world = world
        self._robot_radius = robot_radius
        self._looks = np.array([mover.looks for mover in world.movers], dtype=bool)
        self._somebody_looks = bool(self._looks.any())
        # Delay [s] and shift along x and y [m] of each at the last look, and changes per second
        self._look_time = 0.0
        self._detours = np.zeros((len(world.movers), 3))
        self._changes = np.zeros_like(self._detours)

    def circles(self, time: float) -> Array:
        """Return the circles (k, 3) x, y, radius [m] at a time until the next look [s]."""
        if not self._somebody_looks:
            return self._world.mover_circles(time)
        detours = self._detours + (time - self._look_time) * self._changes
        circles = self._world.mover_circles(time - detours[:, 0])
        circles[:, :2] += detours[:, 1:]
        return circles

    def look(self, time: float, robot_pose: Pose) -> None:
        """See a robot at a pose in the world frame, at a time that never decreases [s]."""
        if not self._somebody_looks:
            return
        self._detours += (time - self._look_time) * self._changes
        self._look_time = time
        self._changes = np.zeros_like(self._detours)

        # Place of the robot as each of them sees it: real part ahead, imaginary part to the left
        circles = self.circles(time)
        places = circles @ X_AND_Y
        heading = np.exp(1j * np.angle(self.circles(time + HEADING_S) @ X_AND_Y - places))
        robot = (complex(*robot_pose[:2]) - places) / heading
        reach = circles[:, 2] + self._robot_radius
        is_seen = self._looks & (np.abs(robot) < reach + SIGHT_M)
        is_blocked = is_seen & (robot.real > 0.0) & (np.abs(robot.imag) < reach + SIDE_GAP_M)

        # Away from the robot, or back to the path
        step = -1j * np.copysign(ASIDE_M_S, robot.imag) * heading
        back = self._detours @ (0.0, 1.0, 1j) / -RETURN_S
        walk = is_blocked * step + ~is_seen * back
        self._changes = np.column_stack([is_blocked, walk.real, walk.imag])
