"""Time of recorded messages by the robot's clock, which is that of their stamps.

A recorder has a clock of its own. Beside `rosbag play -r 0.5`, or beside a slow Gazebo without
/use_sim_time, a drive takes twice its time by it. It tells only in which order messages came.
"""

from __future__ import annotations

from typing import Any, Callable, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.drives.columns import SECOND

# Usual difference between stamp and recording time up to which both clocks are one [s]
AGREE_S = 0.5
# Interval between the messages that set the robot's time [s]: over a shorter one, the delays of
# single messages would count.
STEP_S = 1.0
SAME_LENGTH = 1.05  # ratio of two durations up to which they are not told apart

RecordedStamp = Tuple[int, int]  # recording time and stamp of a message [ns]


class RobotTime:
    """Converts recording times to the robot's time.

    Recording times stay as they are if one sensor's stamps agree with them.

    Args:
        sensors: Messages of each sensor in order of recording, those with a stamp. The first sensor
            with some sets the time.

    Attributes:
        note: One line if the recording took longer or shorter than the drive, else "".
    """

    def __init__(self, sensors: Sequence[Sequence[RecordedStamp]]):
        self.note = ""
        self._first: RecordedStamp = (0, 0)  # message from which times are counted
        self._elapsed: Optional[Callable[[int], Any]] = None  # stamp of a recording time since then
        sensors_with_stamps = [messages for messages in sensors if messages]
        if not sensors_with_stamps or any(map(_agrees, sensors_with_stamps)):
            return
        # The import takes half a second, and only bags with two clocks need it.
        from scipy.interpolate import interp1d

        first_sensor = sensors_with_stamps[0]
        steps = _steps(first_sensor)
        self._first = steps[0]
        # Differences to the first one, because float64 does not hold all nanoseconds since 1970
        recorded, stamps = (np.array(steps, np.int64) - self._first).T
        if len(steps) == 1:
            recorded, stamps = np.array([(0, SECOND), (0, SECOND)])
        # The time goes on as at the begin, and as at the end.
        self._elapsed = interp1d(recorded, stamps, fill_value="extrapolate")
        self.note = _note(first_sensor)

    def of(self, recording_time: int) -> int:
        """Return the robot's time [ns] of a recording time [ns]."""
        if self._elapsed is None:
            return recording_time
        first_recorded, first_stamp = self._first
        return first_stamp + round(float(self._elapsed(recording_time - first_recorded)))


def _agrees(messages: Sequence[RecordedStamp]) -> bool:
    """Return whether stamps and recording times are usually of one clock."""
    recorded, stamps = np.array(messages, np.int64).T
    usual_difference = float(np.median(np.abs(stamps - recorded)))
    return usual_difference <= AGREE_S * SECOND


def _steps(messages: Sequence[RecordedStamp]) -> List[RecordedStamp]:
    """Return the first message, and each that is stamped STEP_S later than the one before.

    Times after a jump back are not known: they go on as before it.
    """
    steps = [messages[0]]
    for recorded, stamp in messages:
        last_recorded, last_stamp = steps[-1]
        if stamp >= last_stamp + STEP_S * SECOND and recorded > last_recorded:
            steps.append((recorded, stamp))
    return steps


def _note(messages: Sequence[RecordedStamp]) -> str:
    """Return that recording and drive took different times, or ""."""
    first_recorded, first_stamp = messages[0]
    last_recorded, last_stamp = messages[-1]
    recorded_s = (last_recorded - first_recorded) / SECOND
    driven_s = (last_stamp - first_stamp) / SECOND
    longer = max(recorded_s, driven_s)
    shorter = min(recorded_s, driven_s)
    if longer <= SAME_LENGTH * shorter + AGREE_S:
        return ""
    return (
        f"the recording took {recorded_s:.1f} s, the drive {driven_s:.1f} s by its stamps: "
        "times are those of the stamps"
    )
