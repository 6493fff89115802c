"""Commanded against driven speeds: the true motion of base_link, averaged over some seconds once it is steady."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, hypot, pi, sin
from typing import Iterable, List, Tuple

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.robots import Robot
from sim_bridge.simulator import Simulator
from tests.support.scenes import STEP, drive, small_world

# shares of the robot's largest speed and turn
SPEEDS = (0.05, 0.1, 0.25, 0.5, 0.75, 1.0, -0.05, -0.25)
TURNS = (0.0785, 0.15, 0.25, 0.3925, 0.5, 0.625, 0.785, -0.0785, -0.3925, -0.785)
CURVES = ((0.05, 0.125, 0.25, 0.5, 0.75, 1.0), (0.05, 0.15, -0.25, 0.3925, 0.785))


def cases(robot: Robot) -> List[Tuple[float, float]]:
    """(v, w) over what planners command [m/s, rad/s]; curves up to what the tyres hold (v w <= grip_limit)."""
    v, w = robot.base.max_speed, robot.base.max_yaw_rate
    curves = [(v * a, w * b) for a in CURVES[0] for b in CURVES[1]]
    held = [curve for curve in curves if abs(curve[0] * curve[1]) <= robot.simulation.grip_limit]
    return [(v * a, 0.0) for a in SPEEDS] + [(0.0, w * b) for b in TURNS] + held


@dataclass
class Measurement:
    """Means over the steady part of a drive.

    v, w were commanded and driven_v, driven_w driven [m/s, rad/s]; drift is how far base_link strays while the heading
    turns once round in place [m].
    """

    v: float
    w: float
    driven_v: float
    driven_w: float
    drift: float

    @property
    def error(self) -> float:
        """Largest relative error of the speeds asked for."""
        return max(
            abs(driven / asked - 1.0) for asked, driven in ((self.v, self.driven_v), (self.w, self.driven_w)) if asked
        )


OPEN_PLANE = small_world()  # a world with nothing in it


def measure(
    simulator: Simulator, v: float, w: float, seconds: float = 6.0, seeds: Iterable[int] = range(1)
) -> Measurement:
    """Drive (v, w) from a stand, once per seed, and average; the first second does not count."""
    runs = [_measure(simulator, v, w, seconds, seed) for seed in seeds]
    return Measurement(v, w, *np.mean(runs, axis=0).tolist())


def _measure(simulator, v, w, seconds, seed):
    simulator.reset(OPEN_PLANE, seed)
    state = drive(simulator, v, w, 1.0)
    ahead = turned = 0.0
    track = [state.pose[:2]]
    for _ in range(int(round(seconds / STEP))):
        last = state
        state = drive(simulator, v, w, STEP)
        turn = normalize_angle_modulo(state.pose[2] - last.pose[2])
        middle = last.pose[2] + turn / 2
        dx, dy = state.pose[0] - last.pose[0], state.pose[1] - last.pose[1]
        # the chord of the arc, made as long as the arc
        ahead += (dx * cos(middle) + dy * sin(middle)) * (turn / 2 / sin(turn / 2) if turn else 1.0)
        turned += turn
        if abs(turned) <= 2 * pi:
            track.append(state.pose[:2])
    return ahead / seconds, turned / seconds, max(hypot(x - track[0][0], y - track[0][1]) for x, y in track)
