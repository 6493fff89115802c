"""Reasons why a robot does not drive, read from the columns of a simulated or recorded drive.

Causes come before what follows from them: without a scan the planner sends nothing, without a plan
nothing is commanded, and a command that the collision monitor stops moves nothing.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from typing import DefaultDict, List, Optional

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.common.paths import distances, step_lengths
from applr_ros1.drives.drive import Rows, Verdicts
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
# Share of the time in which the monitor delays reversals from which on it holds the robot. A
# planner that keeps changing its direction is delayed for less.
DELAYED_SHARE = 0.3
# Share of a stretch in which the planner drives forward, from which on it counts what the monitor
# does to these commands alone
FORWARD_SHARE = 0.2
PASSED = 0.2  # share of the planner's command above which it counts as passed on to the base
# A robot is held if its odometry moves by this much [m] and its ranges change by less [m].
HELD_M = 0.5
SAME_SCAN_M = 0.03
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
    silent_s = _longest_gap(stretch.drive.planned, stretch)
    if not stretch.is_reason(silent_s):
        return ""
    return f"move_base sent no command for {silent_s:.1f} s"


def _longest_gap(rows: Optional[Rows], stretch: Stretch) -> float:
    """Return the longest part [s] of a stretch in which a source is silent, or 0.0."""
    if rows is None or len(rows) < 2:
        return 0.0
    # A source that ends is silent until the end of the drive.
    times = np.append(rows.time, max(rows.time[-1], stretch.drive.end))
    gaps = np.diff(times)
    usual_gap = float(np.median(gaps))
    is_long = gaps > max(SILENT_S, SILENT_PERIODS * usual_gap)
    # Between two goals, the planner is silent for as long as nobody wants anything.
    overlaps = np.minimum(times[1:], stretch.end) - np.maximum(times[:-1], stretch.begin)
    return float(overlaps[is_long].max(initial=0.0))


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
    """Return that the global planner found no path, or ""."""
    routes = stretch.drive.routes
    if routes is None:
        return ""
    # Until the first plan comes, and from each empty plan to the next plan, there is none.
    span_starts = np.append(-np.inf, routes.time)
    span_ends = np.append(routes.time, np.inf)
    pose_counts = [0, *map(len, routes.path)]
    is_missing = np.equal(pose_counts, 0)
    overlaps = np.minimum(span_ends, stretch.end) - np.maximum(span_starts, stretch.begin)
    time_without_plan = float(np.maximum(overlaps, 0.0)[is_missing].sum())
    if not stretch.is_reason(time_without_plan):
        return ""
    return NO_PATH


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
def held(stretch: Stretch) -> str:
    """Return why the collision monitor held the robot, or ""."""
    verdicts = stretch.in_force(stretch.drive.verdicts)
    if verdicts is None:
        return ""
    seconds = durations(verdicts, stretch.end)
    blocked_s: DefaultDict[str, float] = defaultdict(float)  # time by reason [s]
    delayed_s = 0.0
    for duration, reason, is_blocked in zip(seconds, verdicts.reason, verdicts.blocked):
        if is_blocked:
            blocked_s[reason] += duration
        elif reason == REVERSING:
            delayed_s += duration
    # A reversal that the monitor delays does not move the robot either.
    if delayed_s > DELAYED_SHARE * stretch.seconds:
        blocked_s[REVERSING] += delayed_s
    blocked_total = sum(blocked_s.values())
    if not stretch.is_reason(blocked_total) and not _is_kept_from_advancing(stretch, verdicts):
        return ""
    reason = max(blocked_s, key=blocked_s.__getitem__)
    share = f"{100 * blocked_total / stretch.seconds:.0f} %"
    return f"the collision monitor intervenes {share} of the time: {reason}"


def _is_kept_from_advancing(stretch: Stretch, verdicts: Verdicts) -> bool:
    """Return whether the monitor blocks most commands to drive forward.

    Between them the planner may back out, which the monitor allows, before it tries again.

    Args:
        stretch: The stretch.
        verdicts: Verdicts in force in it.
    """
    planned = stretch.part(stretch.drive.planned)
    if planned is None:
        return False
    drives_forward = planned.twist[:, 0] >= DRIVES_SPEED
    verdict_rows = latest_rows(verdicts, planned.time + PASS_ON_S)
    is_blocked = np.array(verdicts.blocked, bool)[verdict_rows]
    seconds = durations(planned, stretch.end)
    forward_s = float(seconds[drives_forward].sum())
    blocked_s = float(seconds[drives_forward & is_blocked].sum())
    return forward_s > FORWARD_SHARE * stretch.seconds and blocked_s > stretch.share * forward_s


def stopped(stretch: Stretch) -> str:
    """Return that the planner's commands did not reach the base, or ""."""
    drive = stretch.drive
    planned = stretch.part(drive.planned)
    if planned is None or drive.commands is None or drive.commands is drive.planned:
        return ""
    asks_for_motion = _asks_for_motion(planned.twist)
    # What reaches the base may come a little later than the planner's command.
    command_rows = latest_rows(drive.commands, planned.time + PASS_ON_S)
    passed_commands = drive.commands.twist[command_rows]
    is_little = np.abs(passed_commands) <= PASSED * np.abs(planned.twist)
    # The base may still brake before a change of direction.
    is_little |= passed_commands * planned.twist < 0.0
    is_stopped = asks_for_motion & is_little.all(axis=1)
    seconds = durations(planned, stretch.end)
    if not stretch.is_reason(float(seconds[is_stopped].sum())):
        return ""
    speed = _in_words(planned.twist[is_stopped])
    monitor_reason = _reason_of_monitor(stretch, planned.time[is_stopped])
    if monitor_reason:
        return f"the collision monitor lets nothing of {speed} pass: {monitor_reason}"
    return (
        f"move_base commanded {speed}, but nothing of it reached the base "
        "(collision monitor, mux or emergency stop)"
    )


def _reason_of_monitor(stretch: Stretch, times: np.ndarray) -> str:
    """Return why the monitor changed most of the commands of some times (n,) [s], or ""."""
    verdicts = stretch.in_force(stretch.drive.verdicts)
    if verdicts is None:
        return ""
    verdict_rows = latest_rows(verdicts, times + PASS_ON_S)
    reason_counts = Counter(verdicts.reason[row] for row in verdict_rows)
    reason, count = reason_counts.most_common(1)[0]
    return reason if count > stretch.share * len(times) else ""


def unmoved(stretch: Stretch) -> str:
    """Return that the base did not follow its commands, or ""."""
    drive = stretch.drive
    commands = stretch.part(drive.commands)
    if commands is None or drive.odometry is None:
        return ""
    asks_for_motion = _asks_for_motion(commands.twist)
    seconds = durations(commands, stretch.end)
    odometry_rows = latest_rows(drive.odometry, commands.time)
    speed, turn_rate = np.abs(drive.odometry.twist[odometry_rows]).T
    stands = asks_for_motion & (speed < STOOD.v) & (turn_rate < STOOD.w)
    if not stretch.is_reason(float(seconds[stands].sum())):
        return ""
    return f"the base did not follow its commands of {_in_words(commands.twist[stands])}"


def stuck(stretch: Stretch) -> str:
    """Return that the odometry moves and the scans do not, or ""."""
    motion = stretch.part(stretch.drive.odometry)
    scans = stretch.part(stretch.drive.scans)
    if motion is None or scans is None:
        return ""
    # Not the length of its way: a robot that goes to and fro sees the same all the time.
    positions = motion.pose[:, :2]
    moved_distance = float(distances(positions, positions[0]).max())
    if moved_distance < HELD_M:
        return ""
    first_ranges = scans.ranges[0]
    range_changes: List[float] = []
    for ranges in scans.ranges[1:]:
        # Some lasers vary the number of their beams.
        if len(ranges) != len(first_ranges):
            continue
        is_return = np.isfinite(ranges) & np.isfinite(first_ranges)
        if is_return.any():
            differences = np.abs(ranges[is_return] - first_ranges[is_return])
            range_changes.append(float(np.median(differences)))
    if not range_changes or np.median(range_changes) >= SAME_SCAN_M:
        return ""
    unseen = f"the scans stay the same while the odometry moves {moved_distance:.1f} m"
    return f"{unseen}: the robot is held, or its wheels slip"


def _asks_for_motion(twist: np.ndarray) -> np.ndarray:
    """Return for commands (n, 2) whether they ask for motion."""
    drives = np.abs(twist[:, 0]) >= DRIVES_SPEED
    turns = np.abs(twist[:, 1]) >= DRIVES_TURN
    asks_for_motion: np.ndarray = drives | turns
    return asks_for_motion


def _in_words(twist: np.ndarray) -> str:
    """Return the usual one of commands (n, 2) for people."""
    v, w = np.median(twist, axis=0)
    if abs(v) >= DRIVES_SPEED:
        return f"{v:.2f} m/s"
    return f"{w:.2f} rad/s"
