"""Time of recorded messages by the robot's clock, which is that of their stamps.

A recorder has a clock of its own. Beside `rosbag play -r 0.5`, or beside a slow Gazebo without
/use_sim_time, a drive takes twice its time by it. It tells only in which order messages came.
"""

from __future__ import annotations

from typing import Sequence, Tuple

import numpy as np

from applr_ros1.drives.columns import SECOND

# Usual difference between stamp and recording time up to which both clocks are one [s]
AGREE_S = 0.5
# Interval between the messages that set the robot's time [s]: over a shorter one, the delays of
# single messages would count.
STEP_S = 1.0
SAME_LENGTH = 1.05  # ratio of two durations up to which they are not told apart
BEYOND_NS = 10_000 * SECOND  # time before and after these messages in which others may lie [ns]

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
        self._recorded = np.zeros(0, np.int64)
        self._stamps = np.zeros(0, np.int64)
        sensors_with_stamps = [messages for messages in sensors if messages]
        if not sensors_with_stamps or any(map(_agrees, sensors_with_stamps)):
            return
        first_sensor = sensors_with_stamps[0]
        recorded, stamps = np.array(_steps(first_sensor), np.int64).T
        # The time goes on as at the begin, and as at the end.
        first_rate = 1.0
        last_rate = 1.0
        if len(stamps) > 1:
            rates = np.diff(stamps) / np.diff(recorded)
            first_rate = float(rates[0])
            last_rate = float(rates[-1])
        before = recorded[0] - BEYOND_NS, stamps[0] - round(first_rate * BEYOND_NS)
        after = recorded[-1] + BEYOND_NS, stamps[-1] + round(last_rate * BEYOND_NS)
        self._recorded = np.concatenate([[before[0]], recorded, [after[0]]])
        self._stamps = np.concatenate([[before[1]], stamps, [after[1]]])
        self.note = _note(first_sensor)

    def of(self, recording_time: int) -> int:
        """Return the robot's time [ns] of a recording time [ns]."""
        if not len(self._stamps):
            return recording_time
        # Differences to the first one, because float64 does not hold all nanoseconds since 1970
        elapsed = np.interp(
            float(recording_time - self._recorded[0]),
            (self._recorded - self._recorded[0]).astype(np.float64),
            (self._stamps - self._stamps[0]).astype(np.float64),
        )
        return int(self._stamps[0]) + round(float(elapsed))


def _agrees(messages: Sequence[RecordedStamp]) -> bool:
    """Return whether stamps and recording times are usually of one clock."""
    recorded, stamps = np.array(messages, np.int64).T
    usual_difference = float(np.median(np.abs(stamps - recorded)))
    return usual_difference <= AGREE_S * SECOND


def _steps(messages: Sequence[RecordedStamp]) -> Sequence[RecordedStamp]:
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
