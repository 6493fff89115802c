"""Reasons why a robot does not drive, read from the columns of a simulated or recorded drive.

Causes come before what follows from them: without a scan the planner sends nothing, without a plan
nothing is commanded, and a command that the collision monitor blocks moves nothing.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from typing import DefaultDict, List, NamedTuple, Optional

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.common.paths import distances, step_lengths
from applr_ros1.drives.drive import Commands, Rows, Scans, Verdicts
from applr_ros1.monitor.monitor import REVERSING
from applr_ros1.senses.standing import SILENT_S, STOOD
from applr_ros1.why.stretch import (
    Stretch,
    durations,
    latest_rows,
)

BEFORE_S = 1.0  # time before a stop in which its cause may lie [s]
JUMP_BEFORE_S = 3.0  # the same for a jump of the pose, which shows later [s]
SILENT_PERIODS = 5.0  # shortest silence of a source, in its usual gaps
# A command asks for motion from these on [m/s, rad/s].
DRIVES_SPEED = 0.05
DRIVES_TURN = 0.2
PASS_ON_S = 0.1  # time in which a command of the planner reaches the base [s]
# Share of a stretch in which the planner drives forward from which on only these commands count
FORWARD_SHARE = 0.2
# Least share of the commanded motion that is a reason if it is blocked. The changes of direction of
# a planner that hesitates are delayed for less.
BLOCKED_SHARE = 0.3
# A robot is held if its odometry moves by this much [m] and the scans stay the same.
HELD_M = 0.5
# A motion shows in a scan if it changes this share of the ranges, each by this share of 1 m and of
# itself: noise grows with the range.
CHANGED_SHARE = 0.1
SAME_SHARE = 0.03
DIRECTIONS = 120  # number of directions in which a place may look alike
# The pose jumps if it moves or turns by this much beyond the measured speed [m, rad].
JUMP_M = 0.3
JUMP_TURN = 0.5
NO_PATH = "the global planner finds no path"
LATE = 2.0  # ratio of the interval between commands to the control period that is late


# -- sources ---------------------------------------------------------------------------------------
def silent(stretch: Stretch) -> str:
    """Return the sensor that sent nothing, or ""."""
    drive = stretch.drive
    for source, messages in (("scan", drive.scans), ("odometry", drive.odometry)):
        silent_s = _longest_gap(messages, stretch)
        if stretch.is_reason(silent_s):
            return f"there was no {source} for {silent_s:.1f} s"
    return ""


def silent_planner(stretch: Stretch) -> str:
    """Return that move_base sent no command, or ""."""
    planned = stretch.drive.planned
    silent_s = _longest_gap(planned, stretch)
    if not stretch.is_reason(silent_s):
        return ""
    # Of the base's topic alone, a mux may be silent as well.
    if planned is stretch.drive.commands:
        return f"no command came for {silent_s:.1f} s, from move_base or from what is behind it"
    return f"move_base sent no command for {silent_s:.1f} s"


def _longest_gap(rows: Optional[Rows], stretch: Stretch) -> float:
    """Return the longest part [s] of a stretch in which a source is silent, or 0.0."""
    if rows is None or len(rows) < 2:
        return 0.0
    # A source that ends is silent until the end of the drive.
    times = np.append(rows.time, max(rows.time[-1], stretch.drive.end))
    gaps = np.diff(times)
    is_long = gaps > longest_usual_gap(times)
    # Between two goals, the planner is silent for as long as nobody wants anything.
    overlaps = np.minimum(times[1:], stretch.end) - np.maximum(times[:-1], stretch.begin)
    return float(overlaps[is_long].max(initial=0.0))


def longest_usual_gap(times: np.ndarray) -> float:
    """Return the gap [s] from which on a source that sends at times (n,) [s] is silent."""
    return max(SILENT_S, SILENT_PERIODS * float(np.median(np.diff(times))))


def jumping(stretch: Stretch) -> str:
    """Return that the pose jumped at the begin of the stretch, or ""."""
    odometry = stretch.drive.odometry
    if odometry is None:
        return ""
    around = odometry.between(stretch.begin - JUMP_BEFORE_S, stretch.begin + BEFORE_S)
    if len(around) < 2:
        return ""
    # What the pose changes by beyond the measured velocity
    seconds = np.diff(around.stamp)
    moved_distances = step_lengths(around.pose[:, :2])
    turned_angles = np.abs(normalize_angle_modulo(np.diff(around.pose[:, 2])))
    speeds, turn_rates = np.abs(around.twist[1:]).T
    jumps = moved_distances - speeds * seconds
    turns = turned_angles - turn_rates * seconds
    if jumps.max() > JUMP_M:
        return f"the pose jumped by {jumps.max():.1f} m"
    if turns.max() > JUMP_TURN:
        return f"the heading jumped by {turns.max():.1f} rad"
    return ""


# -- planner ---------------------------------------------------------------------------------------
def no_plan(stretch: Stretch) -> str:
    """Return that the global planner found no path, or "".

    An empty plan may answer somebody else (make_plan), and a plan may be older than the bag. What
    the local planner does in the meantime proves that it has a path.
    """
    drive = stretch.drive
    routes = drive.routes
    if routes is None:
        return ""
    # From each empty plan to the next plan there is none. Before the first one, that is known only
    # of a goal that was seen to begin.
    goal_begins = [goal.begin for goal in drive.goals if goal.begin > BEFORE_S]
    begins = [min(goal_begins, default=np.inf), *routes.time]
    ends = [*routes.time, np.inf]
    time_without_plan = 0.0
    for begin, end, pose_count in zip(begins, ends, [0, *map(len, routes.path)]):
        span = replace(stretch, begin=max(begin, stretch.begin), end=min(end, stretch.end))
        if not pose_count and span.seconds > 0.0:
            time_without_plan += span.seconds - _planning_seconds(span)
    if not stretch.is_reason(time_without_plan):
        return ""
    return NO_PATH


def _planning_seconds(stretch: Stretch) -> float:
    """Return the time [s] of a stretch in which the local planner ran, as its messages show.

    It publishes what it follows in each cycle, empty if it finds no command. Without such messages,
    commands to move show it.
    """
    cycles: Optional[Rows] = stretch.part(stretch.drive.plans or stretch.drive.planned)
    if cycles is None:
        return 0.0
    seconds = np.minimum(durations(cycles, stretch.end), SILENT_S)
    if isinstance(cycles, Commands):
        seconds *= cycles.twist.any(axis=1)
    return float(seconds.sum())


def recovering(stretch: Stretch) -> str:
    """Return that recovery behaviours ran, or ""."""
    plans = stretch.drive.plans
    recovery_s = 0.0
    for begin_time in stretch.drive.recoveries:
        if stretch.begin - BEFORE_S <= begin_time < stretch.end:
            # A recovery behaviour is over when the local planner follows a plan again.
            end_time = stretch.end
            if plans is not None:
                later_plans = plans.between(begin_time, stretch.end)
                if len(later_plans):
                    end_time = float(later_plans.time[0])
            recovery_s += end_time - max(begin_time, stretch.begin)
    if not stretch.is_reason(recovery_s):
        return ""
    return "a recovery behaviour ran"


def late(stretch: Stretch) -> str:
    """Return that the planner missed its control rate, or ""."""
    commands = stretch.part(stretch.drive.planned)
    if commands is None or len(commands) < 2 or not stretch.period:
        return ""
    interval = float(np.diff(commands.time).mean())
    if interval <= LATE * stretch.period:
        return ""
    return f"commands came every {interval:.2f} s instead of every {stretch.period:.2f} s"


# -- base ------------------------------------------------------------------------------------------
class BlockedMotion(NamedTuple):
    """Part of the commanded motion that does not reach the base, in n rows of a stretch.

    Attributes:
        times: (n,) times at which the rest has reached the base [s].
        seconds: (n,) blocked time [s]: the time of a row, multiplied by the share that is blocked.
        asked_s: Time in which motion is asked for [s].
    """

    times: np.ndarray
    seconds: np.ndarray
    asked_s: float


def blocked(stretch: Stretch) -> str:
    """Return why most of the commanded motion does not reach the base, or ""."""
    verdicts = stretch.in_force(stretch.drive.verdicts)
    planned = stretch.part(stretch.drive.planned)
    commands = stretch.drive.commands
    if planned is not None and commands is not None and commands is not stretch.drive.planned:
        motion = _blocked_of_commands(stretch, planned, commands)
    elif verdicts is not None:
        motion = _blocked_by_verdicts(stretch, verdicts)
    else:
        return ""
    blocked_s = float(motion.seconds.sum())
    if blocked_s <= max(stretch.share, BLOCKED_SHARE) * motion.asked_s:
        return ""

    # The reason of the monitor that takes most of it
    seconds_by_reason: DefaultDict[str, float] = defaultdict(float)
    if verdicts is not None:
        for row, seconds in zip(latest_rows(verdicts, motion.times), motion.seconds):
            seconds_by_reason[verdicts.reason[row]] += seconds
    reason = max(seconds_by_reason, key=seconds_by_reason.__getitem__, default="")
    percent = f"{100 * blocked_s / motion.asked_s:.0f} %"
    if reason:
        return f"the collision monitor blocks {percent} of the commanded motion: {reason}"
    return (
        f"{percent} of the commanded motion does not reach the base "
        "(collision monitor, mux or emergency stop)"
    )


def _blocked_of_commands(stretch: Stretch, planned: Commands, commands: Commands) -> BlockedMotion:
    """Return the part of the planner's commands in a stretch that does not reach the base.

    Args:
        stretch: The stretch.
        planned: Commands of the planner in it.
        commands: Commands that reach the base in the whole drive.
    """
    seconds = durations(planned, stretch.end)
    asks = _asks_for_motion(planned.twist)
    asked_s = stretch.seconds
    drives_forward = planned.twist[:, 0] >= DRIVES_SPEED
    forward_s = float(seconds[drives_forward].sum())
    if forward_s > FORWARD_SHARE * stretch.seconds:
        # Between its attempts the planner may back out or turn, which the monitor allows.
        asks = np.column_stack([drives_forward, np.zeros_like(drives_forward)])
        asked_s = forward_s

    # The next command to the base answers the planner's, unless it comes late. While the base still
    # brakes before a change of direction, it has another sign.
    next_rows = np.searchsorted(commands.time, planned.time)
    next_times = np.append(commands.time, np.inf)[next_rows]
    times = np.minimum(next_times, planned.time + PASS_ON_S)
    passed_rows = latest_rows(commands, times)
    passed_commands = commands.twist[passed_rows].copy()
    # What a silent mux sent last is over.
    command_ages = times - commands.time[passed_rows]
    passed_commands[command_ages > longest_usual_gap(commands.time)] = 0.0
    passed_shares = np.zeros_like(planned.twist)
    np.divide(passed_commands, planned.twist, out=passed_shares, where=asks)
    blocked_shares = 1.0 - passed_shares.clip(0.0, 1.0).max(axis=1)
    return BlockedMotion(times, seconds * blocked_shares * asks.any(axis=1), asked_s)


def _blocked_by_verdicts(stretch: Stretch, verdicts: Verdicts) -> BlockedMotion:
    """Return the time that the monitor blocks by its verdicts in force in a stretch.

    A reversal that the monitor delays does not move the robot either.
    """
    is_blocked = np.array(verdicts.blocked) | (np.array(verdicts.reason) == REVERSING)
    seconds = durations(verdicts, stretch.end)
    return BlockedMotion(verdicts.time, seconds * is_blocked, stretch.seconds)


def unmoved(stretch: Stretch) -> str:
    """Return that the base did not follow its commands, or ""."""
    drive = stretch.drive
    commands = stretch.part(drive.commands)
    if commands is None or drive.odometry is None:
        return ""
    asks_for_motion = _asks_for_motion(commands.twist).any(axis=1)
    seconds = durations(commands, stretch.end)
    odometry_rows = latest_rows(drive.odometry, commands.time)
    speed, turn_rate = np.abs(drive.odometry.twist[odometry_rows]).T
    stands = asks_for_motion & (speed < STOOD.v) & (turn_rate < STOOD.w)
    if not stretch.is_reason(float(seconds[stands].sum())):
        return ""
    return f"the base did not follow its commands of {_in_words(commands.twist[stands])}"


def stuck(stretch: Stretch) -> str:
    """Return that the odometry moves and the scans do not, or "".

    How far the wheels slip is not asked: scans that stay the same need no matching.
    """
    motion = stretch.part(stretch.drive.odometry)
    scans = stretch.part(stretch.drive.scans)
    if motion is None or scans is None:
        return ""
    # Not the length of its way: a robot that goes to and fro sees the same all the time.
    positions = motion.pose[:, :2]
    moved_distance = float(distances(positions, positions[0]).max())
    if moved_distance < HELD_M or _looks_alike(scans):
        return ""
    first_ranges = scans.distances(0)
    shares: List[float] = []
    for scan_row in range(1, len(scans)):
        ranges = scans.distances(scan_row)
        # Some lasers vary the number of their beams.
        if len(ranges) == len(first_ranges):
            shares.append(_changed_share(first_ranges, ranges))
    if not shares or np.median(shares) >= CHANGED_SHARE:
        return ""
    unseen = f"the scans stay the same while the odometry moves {moved_distance:.1f} m"
    return f"{unseen}: the robot is held, or its wheels slip"


def _looks_alike(scans: Scans) -> bool:
    """Return whether a first scan would stay the same if the robot moved by HELD_M.

    It would in some direction along a corridor, or if there is hardly anything in reach. The
    heading of the laser on the robot need not be known for that.
    """
    first_angle, increment, _, _ = scans.fan[0]
    ranges = scans.distances(0)
    angles = first_angle + increment * np.arange(len(ranges))
    is_return = np.isfinite(ranges)
    if not is_return.any():
        return True
    ranges = ranges[is_return]
    angles = angles[is_return]
    # Points and directions as complex numbers x + iy
    points = ranges * np.exp(1j * angles)
    for direction in np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False):
        moved = points - HELD_M * np.exp(1j * direction)
        # A wall is smooth in the inverse range, also where beams meet it at a small angle.
        inverses = np.interp(angles, np.angle(moved), 1.0 / np.abs(moved), period=2.0 * np.pi)
        moved_ranges = 1.0 / inverses
        if _changed_share(ranges, moved_ranges) < CHANGED_SHARE:
            return True
    return False


def _changed_share(ranges: np.ndarray, others: np.ndarray) -> float:
    """Return the share of the beams that return in both scans whose ranges (n,) [m] differ."""
    is_return = np.isfinite(ranges) & np.isfinite(others)
    differences = np.abs(ranges[is_return] - others[is_return])
    is_changed = differences > SAME_SHARE * (1.0 + ranges[is_return])
    return float(is_changed.mean()) if len(is_changed) else 0.0


def _asks_for_motion(twist: np.ndarray) -> np.ndarray:
    """Return for commands (n, 2) whether each of v and w asks for motion."""
    asks_for_motion: np.ndarray = np.abs(twist) >= (DRIVES_SPEED, DRIVES_TURN)
    return asks_for_motion


def _in_words(twist: np.ndarray) -> str:
    """Return the usual one of commands (n, 2) for people."""
    v, w = np.median(twist, axis=0)
    if abs(v) >= DRIVES_SPEED:
        return f"{v:.2f} m/s"
    return f"{w:.2f} rad/s"
