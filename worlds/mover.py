"""A moving obstacle and where it is at any time, interpolated as Gazebo interpolates a PoseAnimation's key frames.

`world.World` holds movers; both simulators and the pictures ask them for positions.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass, field
from typing import List, Tuple

KeyFrame = Tuple[float, float, float]
Point = Tuple[float, float]

SAME_POINT = 1e-3  # [m]; ignition::math::Vector3 compares with this tolerance


@dataclass(frozen=True)
class Mover:
    """A cylinder that moves as a Gazebo model with a PoseAnimation does (DynaBARN's obstacles).

    It passes its key frames at their times. Between two of them it follows ignition::math::Spline with tension 0
    (Catmull-Rom tangents, half the neighbours' chord; at the ends half the only chord; where the last point equals the
    first the curve is closed). Before the first key frame and after the last one it stands there.

    radius     [m]
    waypoints  the key frames, ((t, x, y), ...) with times that never fall, from 0 on [s, m, m]; at least two
    length     duration of the animation [s]; 0: the time of the last key frame
    repeat     whether the animation starts again after `length` seconds; otherwise the cylinder stays at its end
    """

    radius: float
    waypoints: Tuple[KeyFrame, ...]
    length: float = 0.0
    repeat: bool = True
    _times: List[float] = field(init=False, repr=False, compare=False)
    _tangents: List[Point] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        points = [(x, y) for _, x, y in self.waypoints]
        if not self.length:
            object.__setattr__(self, "length", self.waypoints[-1][0])
        object.__setattr__(self, "_times", [row[0] for row in self.waypoints])
        object.__setattr__(self, "_tangents", _tangents(points))

    def position(self, t: float) -> Point:
        """Centre at time t >= 0 [s]: (x, y) [m]. Steps as in gazebo::common::Animation::GetKeyFramesAtTime."""
        t = math.fmod(t, self.length) if self.repeat else min(t, self.length)
        times, points = self._times, self.waypoints
        second = bisect_left(times, t)
        if second == len(times):
            return points[-1][1:]
        if second == 0 or times[second] == t:
            return points[second][1:]
        first = second - 1
        u = (t - times[first]) / (times[second] - times[first])
        tangents = self._tangents
        return (
            _hermite(points[first][1], points[second][1], tangents[first][0], tangents[second][0], u),
            _hermite(points[first][2], points[second][2], tangents[first][1], tangents[second][1], u),
        )


def _tangents(points: List[Point]) -> List[Point]:
    """Tangents at all points, as ignition::math::Spline::RecalcTangents computes them with tension 0."""
    last = len(points) - 1
    closed = all(abs(a - b) <= SAME_POINT for a, b in zip(points[0], points[last]))
    before = [points[last - 1] if closed else points[0]] + points[:last]
    after = points[1:] + [points[1] if closed else points[last]]
    return [(0.5 * (b[0] - a[0]), 0.5 * (b[1] - a[1])) for a, b in zip(before, after)]


def _hermite(a: float, b: float, tangent_a: float, tangent_b: float, u: float) -> float:
    """The cubic from a (u = 0) to b (u = 1) with the given end tangents, one coordinate."""
    return (
        a
        + tangent_a * u
        + (3.0 * (b - a) - 2.0 * tangent_a - tangent_b) * u * u
        + (2.0 * (a - b) + tangent_a + tangent_b) * u * u * u
    )
