"""Restart of the collision monitor, which begins its frame of matched poses anew.

A monitor that starts again knows nothing of the corrections before: in its new frame, goal and maps
of a move_base are off by all that the odometry has drifted. The odometry itself goes on, so that it
tells how the old frame lies in the new one.
"""

import math
from typing import NamedTuple, Optional

from applr_ros1.common.angles import Pose, compose, inverse, normalize_angle
from applr_ros1.senses.standing import SILENT_S

# Largest change of the correction while a robot stands without poses
SHIFT_M = 0.05
TURN_RAD = 0.02


class LastCorrection(NamedTuple):
    """Pose of the odometry's frame in that of the matched poses, and its time [s]."""

    time: float
    odometry: Pose


class FrameRestart:
    """Detects a restart of the collision monitor by the jump of its frame."""

    def __init__(self) -> None:
        self.forget()

    def forget(self) -> None:
        """Forget the frame after the clock jumped back."""
        self._last: Optional[LastCorrection] = None

    def jump(self, now: float, odometry: Pose) -> Optional[Pose]:
        """Return the pose of the previous frame in the new one, or None if it is the same.

        Args:
            now: Time of a cycle in which the robot's pose is known [s].
            odometry: Pose (x, y, yaw) of the odometry's frame in that of the matched poses.
        """
        last = self._last
        self._last = LastCorrection(now, odometry)
        if last is None or now - last.time < SILENT_S:
            return None
        shift_x, shift_y, turn = compose(odometry, inverse(last.odometry))
        is_same = math.hypot(shift_x, shift_y) <= SHIFT_M and abs(normalize_angle(turn)) <= TURN_RAD
        return None if is_same else (shift_x, shift_y, turn)
