"""Reads the recorded drive of a bag for the replay."""

from __future__ import annotations

from pathlib import Path

from applr_ros1.drives.names import names_in
from applr_ros1.why.recorded import CHANNELS, recording_from
from applr_ros1.why.recording import Recording
from applr_ros1.why.rerun import RerunPlanner
from training.bags.options import BagOptions
from training.bags.read import read, refused, topics_in
from training.common.options import option


class RecordedOptions(BagOptions):
    """Options of a recorded drive."""

    move_base: str = option("", "Namespace of move_base in the bag. Default: that of its plans.")


def recording_of(path: Path, options: RecordedOptions, planner: RerunPlanner) -> Recording:
    """Read the drive in a bag, with columns that fit on each other.

    Args:
        path: The bag.
        options: Robot and names of topics.
        planner: Planner of the robot, which cuts the global planner's plans.

    Raises:
        BagError: The bag cannot be read, lacks odometry, scans, commands or plans, another robot or
            planner drove, or the frames of its messages do not fit.
    """
    robot = options.robot
    # Who gave the robot is not asked to give it.
    is_given = "robot" in options.model_fields_set
    with refused(path):
        types = topics_in(path)
        # Topics that are options are not looked for.
        names = names_in(types, options.topics(), options.given_topics())
        drive = read(path, robot, names, CHANNELS)
        return recording_from(drive, names, types, planner, robot, is_given)
