"""Replays the recorded drive of a bag with the assumptions that reproduce most of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Optional

from applr_ros1.policy import methods
from applr_ros1.robots import Robot
from applr_ros1.robots.learned import TRAJECTORY
from applr_ros1.why.limits import REPLAYED
from applr_ros1.why.replay import Replay, Watch, replay_of
from applr_ros1.why.rerun import RerunPlanner, with_meter_scoring
from training.why.recorded import BagAnswerOptions, recording_of

ENOUGH = 0.98  # share of reproduced cycles from which on nothing else is assumed


def replay_in(path: Path, options: BagAnswerOptions, watch: Watch = iter) -> Replay:
    """Return the replay of the drive in a bag.

    Args:
        path: The bag.
        options: Robot and names of topics.
        watch: Shows the progress of a loop, as tqdm does.

    Raises:
        NotReplayedError: Only what is seen from outside is known.
        ApplrError: The bag cannot be read, or no command can be replayed.
    """
    # A robot whose files are wrong is reported before a long bag is read.
    planner: Optional[RerunPlanner] = None
    if options.robot.local_planner in REPLAYED:
        planner = RerunPlanner(options.robot)
    replay = replay_of(recording_of(path, options, planner), planner, watch)
    return with_likely_robot(replay, watch)


def with_likely_robot(replay: Replay, watch: Watch = iter) -> Replay:
    """Return the replay that reproduces most: this one, or one of a robot with other assumptions.

    No bag says up to which range obstacles were marked. A move_base that was started for the
    robot's policy or tuned set marks them up to the one for which this was made. Nor does a bag say
    in which unit C++ counted distances. The drive gets a note on what differs from the robot.

    Args:
        replay: Replay with the range of the robot's files.
        watch: Shows the progress of a loop, as tqdm does.
    """
    for needed_range in methods.obstacle_ranges(replay.robot):
        note = (
            f"obstacles are marked up to {needed_range:g} m, as the robot's set or policy asks: "
            "with the range of its files, fewer commands are reproduced"
        )
        replay = _better(replay, replay.robot.seeing(needed_range), note, watch)
    if replay.planner.name == TRAJECTORY:
        is_per_metre = replay.planner.start_values["meter_scoring"]
        other_unit = "cell" if is_per_metre else "metre"
        note = (
            f"distance biases count per {other_unit}, as C++ leaves the unit to chance: "
            "with the other unit, fewer commands are reproduced"
        )
        replay = _better(replay, with_meter_scoring(replay.robot, not is_per_metre), note, watch)
    return replay


def _better(replay: Replay, other_robot: Robot, note: str, watch: Watch) -> Replay:
    """Return the replay of another robot with a note if it reproduces more than a poor replay."""
    if replay.share >= ENOUGH:
        return replay
    noted_drive = replace(replay.drive, notes=[*replay.drive.notes, note])
    other_recording = replace(replay.recording, robot=other_robot, drive=noted_drive)
    other_replay = replay_of(other_recording, watch=watch)
    return max(replay, other_replay, key=lambda candidate: candidate.reproduced)
