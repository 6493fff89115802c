"""Replays the recorded drive of a bag with the obstacle range that reproduces most of it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import methods
from applr_ros1.why.replay import Replay, Watch, replay_of
from applr_ros1.why.rerun import RerunPlanner
from training.why.recorded import RecordedOptions, recording_of

ENOUGH = 0.98  # share of reproduced cycles from which on no other obstacle range is tried


def replay_in(path: Path, options: RecordedOptions, watch: Watch = iter) -> Replay:
    """Return the replay of the drive in a bag. It may have no cycles (check_cycles).

    Args:
        path: The bag.
        options: Robot and names of topics.
        watch: Shows the progress of a loop, as tqdm does.

    Raises:
        NotReplayedError: Only what is seen from outside is known.
        ApplrError: The bag cannot be read.
    """
    # A robot whose files are wrong is reported before a long bag is read.
    planner = RerunPlanner(options.robot)
    replay = replay_of(recording_of(path, options, planner), planner, watch)
    return with_range_of_method(replay, watch) if replay.cycles else replay


def check_cycles(path: Path, replay: Replay) -> None:
    """Raise ApplrError if no command of a bag was replayed."""
    if not replay.cycles:
        raise ApplrError(
            f"{path}: no command has a plan, a scan and odometry: "
            "record the drive from its beginning"
        )


def with_range_of_method(replay: Replay, watch: Watch = iter) -> Replay:
    """Return the replay that reproduces most: this one, or one with the range of a method.

    No bag says up to which range obstacles were marked. A move_base that was started for the
    robot's policy or tuned set marks them up to the one for which this was made. The drive gets a
    note if that is the range.

    Args:
        replay: Replay with the range of the robot's files.
        watch: Shows the progress of a loop, as tqdm does.
    """
    best_replay = replay
    for needed_range in methods.obstacle_ranges(replay.robot):
        if best_replay.share_of_cycles >= ENOUGH:
            break
        note = (
            f"obstacles are marked up to {needed_range:g} m, as the robot's set or policy asks: "
            "with the range of its files, fewer commands are reproduced"
        )
        other_recording = replace(
            replay.recording,
            robot=replay.robot.seeing(needed_range),
            drive=replace(replay.drive, notes=[*replay.drive.notes, note]),
        )
        other_replay = replay_of(other_recording, watch=watch)
        if other_replay.reproduced > best_replay.reproduced:
            best_replay = other_replay
    return best_replay
