"""Table of logs of real robots: `python -m benchmarks.real_logs FOLDER`.

Each log goes through the collision monitor as in `./applr check --bag`. The figures are written to
docs/results/real_logs.csv. FOLDER has bags (.bag, .db3), logs of CARMEN (.log, .gz), those of the
course 16-831 of Carnegie Mellon (.log, in centimetres) and those of BreezySLAM (.dat).
"""

import csv
import gzip
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from applr_ros1 import robots
from applr_ros1.common.scan import measured_ranges
from applr_ros1.drives.columns import TopicNames
from applr_ros1.drives.drive import Drive, Measured, Motion, Scans
from training.bags.read import opened
from training.robot import rehearsal

TABLE = Path(__file__).parents[1] / "docs" / "results" / "real_logs.csv"
COLUMNS = ("pass", "alarms", "elsewhere", "unmatched", "zeros", "noise", "tracks")
HALF_S = 0.15  # half of the time over which poses give a velocity [s]
LATE_S = 0.03  # time from a scan's stamp to its arrival [s]


def robot_of(size, speed, deceleration, laser, no_return=None, ahead=0.0):
    """Return a robot by length and width, speed, deceleration, laser.pose and laser.no_return.

    The centre of its body is `ahead` of its axle [m].
    Of the Burger, whose wheels are within all of the bodies, it has what does not matter here.
    """
    burger = robots.load("turtlebot3_burger")
    braking = {"deceleration": deceleration, "yaw_deceleration": 2.0 * deceleration}
    placed = {"pose": laser, "no_return": no_return}
    return replace(
        burger,
        body=burger.body.model_copy(update={"size": (*size, 0.3), "centre": (ahead, 0.0)}),
        base=burger.base.model_copy(update={"max_speed": speed, "max_yaw_rate": 2.0}),
        laser=burger.laser.model_copy(update=placed),
        monitor=burger.monitor.model_copy(update=braking),
    )


# Robots by the beginning of a log's name
ROBOTS = {
    "cmu": robot_of((0.45, 0.38), 1.2, 1.0, (0.25, 0.0, 0.0)),
    "freiburg": robot_of((0.45, 0.38), 1.2, 1.0, (-0.04, 0.0, 0.0)),
    "exp": robot_of((0.34, 0.34), 1.8, 2.0, (0.145, 0.0, 0.0), no_return=0.0),
    "general": robot_of((1.2, 0.68), 1.4, 1.0, (0.85, 0.235, 0.735), ahead=0.35),
    "tb4": robot_of((0.34, 0.34), 0.9, 1.0, (0.004, 0.0, math.pi / 2)),
}


def drive_of(poses, scans, fan):
    """Return the drive of poses (n, 4: stamp, x, y, yaw), scans [(stamp, ranges)] and their fan."""
    poses = np.array(poses)
    _, first_rows = np.unique(poses[:, 0], return_index=True)
    stamp, x, y, yaw = poses[first_rows].T
    yaw = np.unwrap(yaw)

    # Velocities are those of the poses around each stamp.
    before = np.clip(stamp - HALF_S, stamp[0], stamp[-1])
    after = np.clip(stamp + HALF_S, stamp[0], stamp[-1])
    x_step, y_step, turn = (
        np.interp(after, stamp, values) - np.interp(before, stamp, values) for values in (x, y, yaw)
    )
    forward = x_step * np.cos(yaw) + y_step * np.sin(yaw)
    twist = np.column_stack([forward, turn]) / (after - before)[:, None]
    stamps = np.array([scan_stamp for scan_stamp, _ in scans])
    ranges = [np.float32(scan_ranges) for _, scan_ranges in scans]
    return Drive(
        odometry=Motion(stamp, stamp, np.column_stack([x, y, yaw]), twist),
        scans=Scans(stamps + LATE_S, stamps, np.tile(fan, (len(stamps), 1)), ranges),
    )


def carmen(path):
    """Return the drive of a log of CARMEN, or of one that has O and L lines in centimetres."""
    opened = gzip.open if path.suffix == ".gz" else open
    poses = []
    scans = []
    fan = (-math.pi / 2, math.radians(0.5), 0.0, 80.0)
    with opened(path, "rt", errors="ignore") as log:
        for line in log:
            kind, *words = line.split() or [""]
            if kind == "FLASER":
                count = int(words[0])
                stamp = float(words[count + 7])
                scans.append((stamp, words[1 : count + 1]))
                poses.append((stamp, *map(float, words[count + 4 : count + 7])))
            elif kind in ("O", "L"):
                x, y, yaw = map(float, words[:3])
                poses.append((float(words[-1]), x / 100, y / 100, yaw))
                # The laser's pose on this line is 0.11 s older than its time.
                if kind == "L":
                    scans.append((poses.pop()[0] - 0.11, np.float32(words[6:186]) / 100))
                    fan = (math.radians(-89.5), math.radians(1.0), 0.0, 81.0)
    return drive_of(poses, scans, fan)


def breezy(path):
    """Return the drive of a log of BreezySLAM: ticks of two wheels, and ranges in millimetres.

    With scans 0.15 s older than the ticks on their line, the matcher corrects the fewest turns.
    """
    table = np.loadtxt(path)
    stamps = table[:, 0] / 1e6
    # As BreezySLAM counts: 2000 ticks per turn, wheels of 7.7 cm radius 33 cm apart.
    left, right = np.diff(table[:, 2:4], axis=0).T * 2.0 * math.pi / 2000.0 * 0.077
    turns = np.append(0.0, (right - left) / 0.33)
    steps = np.append(0.0, 0.5 * (left + right))
    yaw = np.cumsum(turns)
    heading = yaw - 0.5 * turns
    x = np.cumsum(steps * np.cos(heading))
    y = np.cumsum(steps * np.sin(heading))
    poses = np.column_stack([stamps, x, y, yaw])
    ranges = table[:, 24:] / 1000.0
    increment = math.radians(240.0 / 682.0)
    fan = (-increment * (ranges.shape[1] - 1) / 2, increment, 0.02, 4.0)
    return drive_of(poses, list(zip(stamps - 0.15, ranges)), fan)


def row_of(path):
    """Return the row of the table of a log."""
    (robot,) = [ROBOTS[start] for start in ROBOTS if path.name.startswith(start)]
    if path.suffix in (".bag", ".db3"):
        names = replace(TopicNames.of(robot), scan="/scan", odometry="/odom")
        with opened(path) as bag:
            drive = bag.drive(robot, names, rehearsal.COLUMNS)
    else:
        drive = breezy(path) if path.suffix == ".dat" else carmen(path)
        drive.scans.ranges = [
            measured_ranges(ranges, robot.laser.no_return) for ranges in drive.scans.ranges
        ]
    figures = rehearsal.rehearsed(*drive.require(Measured), robot)
    return [path.name, f"{figures['minutes']:.1f}", *(f"{figures[name]:.3g}" for name in COLUMNS)]


def main():
    """Write the table, and print it."""
    with TABLE.open("w", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["log", "minutes", *COLUMNS])
        for path in sorted(Path(sys.argv[1]).iterdir()):
            table.writerow(row_of(path))
    print(TABLE.read_text())


if __name__ == "__main__":
    main()
