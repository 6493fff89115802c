"""The table of commanded against driven speeds: `python -m sim_bridge.tracking_table [--simulator kinematic]`.

The tests read `measure` and `CASES`. Driven means: true motion of base_link, averaged over some seconds once it is
steady.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from math import cos, hypot, pi, sin
from typing import Iterable, Optional, Sequence

import numpy as np

from applr_ros1.common.angles import wrapped_modulo
from applr_ros1.common.errors import run_main

from . import NAMES, jackal, make
from .scenes import STEP, drive, small_world
from .simulator import Simulator

# (v, w) over what the planner commands; curves up to what the tyres hold (v w <= GRIP_LIMIT)
CASES = (
    [(v, 0.0) for v in (0.1, 0.2, 0.5, 1.0, 1.5, 2.0, -0.1, -0.5)]
    + [(0.0, w) for w in (0.314, 0.6, 1.0, 1.57, 2.0, 2.5, 3.14, -0.314, -1.57, -3.14)]
    + [
        (v, w)
        for v in (0.1, 0.25, 0.5, 1.0, 1.5, 2.0)
        for w in (0.2, 0.6, -1.0, 1.57, 3.14)
        if abs(v * w) <= jackal.GRIP_LIMIT
    ]
)


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
        turn = wrapped_modulo(state.pose[2] - last.pose[2])
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
    parser.add_argument("--simulator", default="pybullet", help="Simulator to measure: %s." % " or ".join(NAMES))
    parser.add_argument("--even", action="store_true", help="Even ground: no random slip.")
    parser.add_argument("--seeds", type=int, default=4, help="Number of runs that are averaged.")
    return run_main(lambda: _print_table(parser.parse_args(argv)), "tracking_table")


def _print_table(arguments: argparse.Namespace) -> int:
    simulator = make(arguments.simulator, slip=0.0 if arguments.even else 1.0)
    print("commanded        driven           error   drift of a turn in place")
    worst = 0.0
    for v, w in CASES:
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
