"""Drives towards a wall with the collision monitor: `python -m benchmarks.approaches`.

The figures are for docs/explanation/collision_monitor.md. A Jackal in the pybullet simulator, on
Gazebo's ground, is told to drive straight on at 2 m/s, twenty times a second, towards a wall of
posts 2 to 4.5 m ahead. The wall is askew by up to 35 degrees, so the robot also slides along it.
"""

import math

import numpy as np

from tests.monitor import test_drives

DRIVES = 128
FULL_SPEED = (2.0, 0.0)  # command [m/s, rad/s]
COMMAND_PERIOD = 0.05  # [s]
# 12 cm between centres leaves no gap between posts of 10 cm radius.
POSTS_Y = np.arange(-3.0, 3.0, 0.12)
POST_RADIUS = 0.1
LARGEST_ANGLE = math.radians(35.0)
OLDEST_S = 0.28  # age of scans and poses of the late drives, of which the youngest is 0.1 [s]


def askew_wall(rng):
    """Return the cylinders (x, y, radius) [m] of a wall at a random distance and angle."""
    distance = rng.uniform(2.0, 4.5)
    angle = rng.uniform(-LARGEST_ANGLE, LARGEST_ANGLE)
    x = distance - POSTS_Y * math.sin(angle)
    y = POSTS_Y * math.cos(angle)
    return [(post_x, post_y, POST_RADIUS) for post_x, post_y in zip(x, y)]


def contact_speeds(is_late):
    """Return the speeds [m/s] of the contacts of DRIVES drives."""
    speeds = []
    for seed in range(DRIVES):
        rng = np.random.default_rng(seed)
        cylinders = askew_wall(rng)
        late = rng.uniform(0.1, OLDEST_S) if is_late else 0.0
        driven = test_drives.drive(
            test_drives.in_turn(COMMAND_PERIOD, FULL_SPEED),
            seed,
            late=late,
            cylinders=cylinders,
            simulator_name="pybullet",
        )
        if driven.contact_speed > 0.0:
            speeds.append(driven.contact_speed)
    return speeds


def main():
    """Print how many drives touch the wall, and how fast they are then."""
    cases = {
        "data in time": contact_speeds(is_late=False),
        "late data": contact_speeds(is_late=True),
    }
    for case, speeds in cases.items():
        fastest = max(speeds, default=0.0)
        print(f"{case}: {len(speeds)} of {DRIVES} touch the wall, at up to {fastest:.2f} m/s")


if __name__ == "__main__":
    main()
