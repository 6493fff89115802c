"""What a recorded drive says of a robot's sensors, seen by the collision monitor's own classes.

The monitor is given the robot's own velocity as command. As the drive went well, whatever it slows
down or stops is a false alarm.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Dict, List, Set

import numpy as np

from applr_ros1.drives.drive import Measured, Motion, Scans
from applr_ros1.monitor.monitor import CollisionMonitor
from applr_ros1.monitor.scan_matching import noise_of
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.robots import Robot
from applr_ros1.senses.standing import STANDS

PERIOD_S = 0.05  # time between two commands [s]
COLUMNS = (*Measured._fields, "transforms")  # of a drive
# Sentence on a drive, the figure that is bad from a limit on, and its remedy
WORDS = (
    ("{minutes:.1f} min, {rate:.1f} scans per second, longest gap {gap:.2f} s", "gap", 0.5,
     "the monitor stops the robot in such a gap: check the driver and the network"),
    ("noise of the ranges: {noise:.3f} m", "noise", 0.03, "matching needs less: check the laser"),
    ("{zeros:.0%} of the ranges are 0", "zeros", 0.01,
     "if the laser sends 0 without a return, set laser.no_return to 0.0"),
    ("{unmatched:.0%} of the scans are not matched", "unmatched", 0.1,
     "check laser.pose, and the stamps of scans and odometry"),
    ("{elsewhere:.0f} scans show another place", "elsewhere", 1,
     "check that one robot publishes scans and odometry"),
    ("of the robot's own velocities, the monitor slows or stops {alarms:.1%}", "alarms", 0.02,
     "check monitor and laser.pose in robot.yaml"),
    ("{tracks:.1f} movers per minute are tracked", "tracks", 10.0,
     "if fewer were there, check laser.rate and laser.pose"),
)  # fmt: skip


def rehearsed(odometry: Motion, scans: Scans, robot: Robot) -> Dict[str, float]:
    """Return the figures of a drive that WORDS names, and the share of velocities that "pass"."""
    intervals = np.diff(np.sort(scans.stamp))
    period = float(np.median(intervals))
    monitor = CollisionMonitor(replace(MonitorSettings.of(robot), scan_period=period))
    counts: Counter[str] = Counter()
    tracked: Set[int] = set()
    row = scans.latest(odometry.time[0]) + 1
    noises: List[float] = [0.0]
    for time in np.arange(odometry.time[0], odometry.time[-1], PERIOD_S).tolist():
        while row < len(scans) and scans.time[row] <= time:
            stamp = float(scans.stamp[row])
            laser_pose = robot.laser.pose_for(odometry.pose_at(stamp))
            scan = scans.scan(row, stamp, laser_pose, robot.laser)
            # Real lasers measure beam by beam, all the time.
            monitor.add_scan(replace(scan, sweep=period))
            noises.append(noise_of(scan.distances))
            counts["unmatched"] += bool(monitor.matcher.problem)
            counts["elsewhere"] += monitor.matcher.lost
            tracked.update(monitor.lasers.first.movers.id.tolist())
            row += 1
        # What a command has led to is measured after the reaction time.
        reached = time + monitor.settings.reaction_time
        v, w = (float(np.interp(reached, odometry.time, values)) for values in odometry.twist.T)
        now = odometry.latest(time)
        age = time - float(odometry.stamp[now])
        pose = odometry.pose[now]
        verdict = monitor.filter(time, pose, odometry.twist[now], (v, w), (age, age))
        if not STANDS.holds(v, w):
            counts.update(["moving", verdict.action])

    minutes = float(np.ptp(odometry.time)) / 60.0
    moving = max(counts["moving"], 1)
    return {
        "minutes": minutes,
        "rate": 1.0 / period,
        "gap": float(intervals.max()),
        "noise": float(np.median(noises)),
        "zeros": float(np.mean(np.concatenate(scans.ranges) == 0.0)),
        "unmatched": counts["unmatched"] / len(noises),
        "elsewhere": counts["elsewhere"],
        "pass": counts["pass"] / moving,
        "alarms": (counts["slow"] + counts["stop"]) / moving,
        "tracks": len(tracked) / minutes,
    }


def lines(figures: Dict[str, float]) -> List[str]:
    """Return what an owner should know before the robot drives, with remedies."""
    said = []
    for words, name, limit, remedy in WORDS:
        line = words.format(**figures)
        said.append(f"{line}: {remedy}" if figures[name] >= limit else line)
    return said
