"""The table of commanded against driven speeds: `python -m training.tracking_table [--robot husky]`.

The tests read `measure` and `cases`. Driven means: true motion of base_link, averaged over some seconds once it is
steady.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from math import cos, hypot, pi, sin
from typing import Iterable, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.common.errors import run_main
from applr_ros1.robots import Robot
from sim_bridge import NAMES, make
from sim_bridge.scenes import STEP, drive, small_world
from sim_bridge.simulator import Simulator

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


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Print the table. Exit status 0 where all speeds are driven within five percent."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--simulator", default="pybullet", help="Simulator to measure: %s. Default: pybullet." % " or ".join(NAMES)
    )
    parser.add_argument("--robot", default="jackal", help="Robot to measure: a name or a folder. Default: %(default)s.")
    parser.add_argument("--even", action="store_true", help="Measure on even ground, without random slip.")
    parser.add_argument("--seeds", type=int, default=4, help="Number of runs that are averaged. Default: %(default)s.")
    return run_main(lambda: _print_table(parser.parse_args(argv)), "tracking_table")


def _print_table(arguments: argparse.Namespace) -> int:
    simulator = make(arguments.simulator, robot=arguments.robot, slip=0.0 if arguments.even else 1.0)
    print("commanded        driven           error   drift of a turn in place")
    worst = 0.0
    for v, w in cases(simulator.robot):
        m = measure(simulator, v, w, seeds=range(1 if arguments.even else arguments.seeds))
        worst = max(worst, m.error)
        print(
            "%5.2f m/s %6.3f  %6.3f m/s %6.3f  %4.1f %%%s"
            % (v, w, m.driven_v, m.driven_w, 100 * m.error, "   %.3f m" % m.drift if v == 0.0 else "")
        )
    print("largest error %.1f %%" % (100 * worst))
    return 0 if worst <= 0.05 else 1


if __name__ == "__main__":
    sys.exit(main())
