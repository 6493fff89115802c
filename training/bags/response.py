"""The simulated base under the commands of a recorded drive."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from applr_ros1.common.angles import normalize_angle
from applr_ros1.robots import Robot
from sim_bridge.kinematic_simulator import KinematicSimulator
from training.bags import SECOND
from training.bags.bag import Poses
from worlds import World
from worlds.dynabarn import arena_course

PLANE = World("plane", np.empty((0, 3)), np.empty((0, 5)), arena_course())


def second_on(robot: Robot, at: np.ndarray, commands: np.ndarray, odometry: Poses) -> np.ndarray:
    """Return the means of how far [m] and how much turned [rad] the simulated base is off after a second.

    Args:
        robot: Whose base it is. Commands count as they reach it.
        at: (n,) times of the commands [ns].
        commands: (n, 2) [m/s, rad/s].
        odometry: Where the robot was; every half second the simulated base begins there, with its motion.
    """
    simulation = robot.simulation.model_copy(update={"command_delay": 0.0})
    simulator, off = KinematicSimulator(replace(robot, simulation=simulation)), []
    t, pose = odometry.stamp / SECOND, odometry.pose
    given = commands[np.maximum(np.searchsorted(at, odometry.stamp, side="right") - 1, 0)]
    for start in np.arange(t[0], t[-1] - 1.0, 0.5):
        begin, end = np.searchsorted(t, (start, start + 1.0))
        if t[begin] > start + 0.5:  # nothing was recorded then
            continue
        simulator.reset(PLANE, 0, pose[begin].tolist())
        v, w = odometry.twist[begin].tolist()
        simulator.set_motion((v, 0.0, w), (v, w), (0.0, 0.0))
        for k in range(begin, end):
            simulator.command(*given[k])
            state = simulator.advance(max(t[k + 1] - t[k], 1e-4))
        x, y, yaw = np.array(state.pose) - pose[end]
        off.append((math.hypot(x, y), abs(normalize_angle(yaw))))
    return np.mean(off, axis=0)
