"""Drives with one planted cause of a stop each, in situations that must not change the answer.

They are columns of measured drives, from a robot that drives, stops for some seconds and drives on.
Nothing is simulated but what its laser sees.
"""

from dataclasses import fields, replace
from typing import NamedTuple

import numpy as np

from applr_ros1.drives.columns import SECOND, Stamp
from applr_ros1.drives.drive import Commands, Drive, Goal, Motion, Plans, Scans, with_full_speed
from applr_ros1.drives.received import Received, drive_from
from applr_ros1.robots import JACKAL
from applr_ros1.why import events
from applr_ros1.why.diagnosis import give_outside_reason
from applr_ros1.why.limits import limits_of, start_values
from sim_bridge.lidar import Lidar

TOP = 0.5  # [m/s]
STOP_S = 3.0  # begin of the stop [s]
GOES_ON_S = 11.0  # its end [s]
END_S = 14.0
BEAMS = 180
LASER = JACKAL.laser.model_copy(
    update={
        "beams": BEAMS,
        "first_angle": -np.pi,
        "last_angle": np.pi - 2.0 * np.pi / BEAMS,
        "range_max": 10.0,
    }
)

# Words of the reason by its cause; "" if the planner wants it so, which nobody sees from outside
CAUSES = {
    "the planner creeps": "",
    "no scan": "there was no scan",
    "no odometry": "there was no odometry",
    "no path": "the global planner finds no path",
    "the planner is silent": "move_base sent no command",
    "a mux blocks": "the base (collision monitor, mux",
    "the base does not follow": "the base did not follow its commands",
    "the wheels slip": "the scans stay the same",
    "a recovery runs": "a recovery behaviour ran",
    "the pose jumps": "the pose jumped",
    "the planner is late": "commands came every",
}
SITUATIONS = (
    "pure",
    "in a corridor",
    "on an omni base",
    "cut at both ends",
    "clock set back an hour",
    "clock set back 3 s",
    "clock set on an hour",
    "another node plans",
    "a silent mux",
    "without /move_base/cmd_vel",
)
# What is said instead if the situation hides the cause: nothing, or less
LESS = {
    ("the wheels slip", "in a corridor"): "",
    ("no path", "another node plans"): "move_base sent no command",
    ("the planner is silent", "without /move_base/cmd_vel"): "no command came",
    ("a mux blocks", "without /move_base/cmd_vel"): "",
}


class Said(NamedTuple):
    """What is said of a drive: kinds of its events, and the reason of the longest one."""

    kinds: list
    reason: str

    def verdict(self, cause, situation):
        """Return "right", "honest" if less is said than is known without the situation, or "wrong".

        No event but the planted stop may be seen.
        """
        if len(self.kinds) != 1:
            return "wrong"

        # Nothing is in every reason.
        def is_said(words):
            return words in self.reason and bool(self.reason) == bool(words)

        if is_said(CAUSES[cause]):
            return "right"
        less = LESS.get((cause, situation))
        return "honest" if less is not None and is_said(less) else "wrong"


def planted(cause, situation, seed):
    """Return a drive with a cause in a situation. The seed varies speeds, walls and noise."""
    random = np.random.default_rng(seed)
    times = np.arange(0.0, END_S, 0.05)
    stops = (times >= STOP_S) & (times < GOES_ON_S)
    cruise = random.uniform(0.4, TOP)

    # What the planner wants, what reaches the base, what its wheels and the robot do
    creeps = cause in ("the planner creeps", "the wheels slip", "the planner is late")
    wants_on = cause in ("a mux blocks", "the base does not follow")
    wanted = np.where(stops, cruise if wants_on else 0.1 * creeps, cruise)
    reaching = np.where(stops & (cause == "a mux blocks"), 0.0, wanted)
    measured = np.where(stops & (cause == "the base does not follow"), 0.0, reaching)
    true_speed = np.where(stops & (cause == "the wheels slip"), 0.0, measured)
    true_x = np.cumsum(true_speed) * 0.05
    x = np.cumsum(measured) * 0.05
    if cause == "the pose jumps":
        x = x + np.where(times >= STOP_S, random.uniform(0.5, 2.0), 0.0)

    poses = np.column_stack([x, 0.0 * x, 0.0 * x])
    twists = np.column_stack([measured, 0.0 * x])
    odometry = Motion(times, times, poses, twists)
    if situation == "on an omni base":
        # It drives to its left, while it looks ahead.
        poses = np.column_stack([0.0 * x, x, 0.0 * x])
        odometry = with_full_speed(Motion(times, times, poses, 0.0 * twists, measured))
    planned = _commands(times, wanted)
    commands = _commands(times, reaching)

    # Who is silent, and when
    is_late = stops & (np.arange(len(times)) % 10 > 0)
    silent = stops & (cause in ("no path", "the planner is silent"))
    if cause == "the planner is late":
        silent = is_late
    planned = planned.part(np.flatnonzero(~silent))
    commands = commands.part(np.flatnonzero(~silent))
    is_cycle = ~silent & ~(stops & (cause == "a recovery runs"))
    plans = Plans(times[is_cycle], [_path(at) for at in x[is_cycle]])
    if situation == "a silent mux":
        commands = commands.part(np.flatnonzero(commands.twist.any(axis=1)))

    routes = _routes(cause, situation, x, times)
    scanned_rows = np.flatnonzero(~(stops & (cause == "no scan")))[::2]
    drive = Drive(
        odometry=odometry.part(np.flatnonzero(~(stops & (cause == "no odometry")))),
        scans=_scans(times[scanned_rows], true_x[scanned_rows], situation, random),
        routes=routes,
        plans=plans,
        planned=planned,
        commands=commands,
        goals=[Goal("one", 0.0, END_S)],
        recoveries=np.array([STOP_S + 0.1] if cause == "a recovery runs" else []),
    )
    if situation == "without /move_base/cmd_vel":
        drive = replace(drive, planned=drive.commands)
    return _received(drive, situation)


def said_of(drive):
    """Return what is said of a drive from outside."""
    limits = limits_of(drive, drive.odometry, JACKAL, start_values(JACKAL))
    found_events = events.find(drive, drive.odometry, limits)
    for event in found_events:
        give_outside_reason(event, drive, limits)
    told = max(found_events, key=lambda event: event.seconds, default=None)
    return Said([event.kind for event in found_events], told.reason if told else "")


def _commands(times, speeds):
    return Commands(times, np.column_stack([speeds, 0.0 * speeds]))


def _path(x, points=20):
    """Return a plan from a place on."""
    steps = x + 0.05 * np.arange(points)
    return np.column_stack([steps, 0.0 * steps, 0.0 * steps])


def _routes(cause, situation, x, times):
    """Return the plans of the global planner: its own each second, and those for another node."""
    routes = []
    for row in range(0, len(times), 20):
        # A plan of before the bag, and none as long as it serves
        is_old = situation == "cut at both ends" and 0.0 < times[row] < GOES_ON_S
        is_lost = cause == "no path" and STOP_S <= times[row] < GOES_ON_S
        if is_lost or not is_old:
            routes.append((times[row], _path(x[row], 0 if is_lost else 100)))
        if situation == "another node plans":
            routes.append((times[row] + 0.4, _path(-x[row] - 5.0, 100 if row % 40 else 0)))
    return Plans(np.array([time for time, _ in routes]), [path for _, path in routes])


def _scans(times, places, situation, random):
    """Return what the laser sees between walls: of a room, or of a corridor without ends."""
    half = random.uniform(1.2, 3.0)
    walls = [(0.0, y, 0.0, 1000.0, 0.02) for y in (-half, half)]
    if situation != "in a corridor":
        walls += [(x, 0.0, 0.0, 0.02, 10.0) for x in (-3.0, 8.0)]
    lidar = Lidar(LASER, np.zeros((0, 3)), np.array(walls))
    ranges = []
    for place in places:
        noise = random.normal(0.0, 0.01, BEAMS).astype(np.float32)
        ranges.append(lidar.scan(place, 0.0, 0.0) + noise)
    return Scans(times, times, np.tile(LASER.fan, (len(times), 1)), ranges)


# -- as it is recorded
CLOCKS = {
    "clock set back an hour": -3600.0,
    "clock set back 3 s": -3.0,
    "clock set on an hour": 3600.0,
}
NOON_S = 1_700_000_000.0


def _received(drive, situation):
    """Return a drive as a bag has it, whose clock may be set in the middle of the stop."""
    first_time, last_time = 0.0, END_S
    if situation == "cut at both ends":
        first_time, last_time = STOP_S - 1.0, GOES_ON_S - 0.5
    set_at = 0.5 * (STOP_S + GOES_ON_S)
    step = CLOCKS.get(situation, 0.0)
    messages = []
    for key in ("odometry", "scans", "plans", "routes", "planned", "commands"):
        column = getattr(drive, key)
        if key == "planned" and column is drive.commands:
            continue
        for row, time in enumerate(column.time.tolist()):
            if first_time <= time <= last_time:
                clock = NOON_S + time + (step if time >= set_at else 0.0)
                messages.append(
                    (time, Received(round(clock * SECOND), key, [_row(key, column, row, clock)]))
                )
    for time in drive.recoveries.tolist():
        messages.append((time, Received(round((NOON_S + time) * SECOND), "recoveries", [{}])))
    messages.sort(key=lambda message: message[0])
    recorded = drive_from([message for _, message in messages], JACKAL, is_one=True)
    goal_end = min(drive.goals[0].end, last_time) - first_time
    planned = recorded.planned if recorded.planned is not None else recorded.commands
    return replace(recorded, planned=planned, goals=[Goal("one", 0.0, goal_end)])


def _row(key, column, row, clock):
    """Return the row of a message that is stamped as it is recorded."""
    values = {"frame": "odom"}
    for name in [field.name for field in fields(column) if field.name != "time"]:
        values[name] = getattr(column, name)[row]
    if key in ("odometry", "scans"):
        values["stamp"] = Stamp(round(clock * SECOND))
    if key in ("plans", "routes"):
        values.update(planner=JACKAL.local_planner, stamp=Stamp(round(clock * SECOND)))
    return values
