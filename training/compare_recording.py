"""Compares recorded drives with what the kinematic simulator makes of their commands, on each ground.

Started as `python -m training.compare_recording FILE...`. A FILE is a ROS bag with the robot's velocity commands and
odometry, or a CSV (or .csv.xz) with the columns t [s], cmd_v, cmd_w, x, y, yaw and, where they are known, wheel_v,
wheel_w (speeds that the wheels turn for, else the commands) and profile (the name of one of several drives). Commands
count as they reach the base.

Every half second the simulated robot begins where the recorded one is, with its motion and its wheels' angles, and
drives a second. Prints how far it is off then. `./applr tune --bag` compares whole drives.
"""

from __future__ import annotations

import csv
import lzma
import sys
from dataclasses import replace
from pathlib import Path
from typing import Dict, List, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from applr_ros1.robots import GROUNDS, Robot, on_ground
from sim_bridge.kinematic_simulator import KinematicSimulator
from training.common.command_line import AnyRobot, parsed
from training.common.options import Options, argument
from worlds import World
from worlds.dynabarn import arena_course

with extra(__name__):
    from training.bags.reader import TopicNames, read_messages

COLUMNS = ("t", "cmd_v", "cmd_w", "x", "y", "yaw")
WHEELS = ("wheel_v", "wheel_w")
T, COMMAND, POSE, TURNING = 0, slice(1, 3), slice(3, 6), slice(6, 8)
EVERY, SECOND = 0.5, 1.0  # [s]
PLANE = World("plane", np.empty((0, 3)), np.empty((0, 5)), arena_course())


def read_drives(path: Path, robot: Robot) -> List[Tuple[str, np.ndarray]]:
    """The drives of a file: name, and rows (n, 8) of COLUMNS and WHEELS in the order of time.

    Raises ApplrError where it cannot be used.
    """
    drives = _of_csv(path) if ".csv" in path.suffixes else [(path.stem, _of_bag(path, robot))]
    usable = [(name, rows) for name, rows in drives if len(rows) > 2 and np.ptp(rows[:, T]) > SECOND]
    if not usable:
        raise ApplrError(f"{path}: no drive of more than a second; give one with commands and poses")
    return usable


def _of_csv(path: Path) -> List[Tuple[str, np.ndarray]]:
    found: Dict[str, List[List[float]]] = {}
    try:
        with lzma.open(path, "rt") if path.suffix == ".xz" else open(path) as file:
            for row in csv.DictReader(file):
                turning = [row.get(name) or row[name.replace("wheel", "cmd")] for name in WHEELS]
                values = [float(value) for value in [*(row[name] for name in COLUMNS), *turning]]
                found.setdefault(row.get("profile") or path.name.split(".")[0], []).append(values)
    except (OSError, EOFError, lzma.LZMAError, KeyError, ValueError, TypeError) as error:
        raise ApplrError(f"{path}: {error}; give a CSV with the columns {', '.join(COLUMNS)}") from None
    return [(name, np.array(rows)) for name, rows in found.items()]


def _of_bag(path: Path, robot: Robot) -> np.ndarray:
    recording = read_messages(path, TopicNames.of(robot), robot)
    given = np.array([(-1, 0.0, 0.0), *recording.commands], dtype=float)
    at, pose = recording.odometry.at, recording.odometry.pose
    command = given[np.searchsorted(given[:, 0], at) - 1, 1:]
    return np.hstack([1e-9 * at[:, None], command, pose, command])


def standing_in(robot: Robot, ground: str) -> KinematicSimulator:
    """The simulator that takes a recording's commands, on a ground."""
    robot = on_ground(robot, ground)
    return KinematicSimulator(replace(robot, simulation=robot.simulation.model_copy(update={"command_delay": 0.0})))


def replay(simulator: KinematicSimulator, rows: np.ndarray, begin: int = 0, end: Optional[int] = None) -> np.ndarray:
    """(k, 3) poses at rows begin + 1 to end of a drive, from the recorded pose and motion at row `begin`.

    The wheels' angles are counted from 0 at the first row.
    """
    base = simulator.robot.base
    t, turning = rows[:, T], rows[:, TURNING]
    half = 0.5 * base.track * (simulator.robot.simulation.track_multiplier or 1.0)
    way = (turning[1 : begin + 1] * np.diff(t[: begin + 1])[:, None]).sum(axis=0)
    simulator.reset(PLANE, 0, rows[begin, POSE].tolist())
    after = min(begin + 3, len(rows) - 1)
    dx, dy = (rows[after, 3:5] - rows[begin, 3:5]) / max(t[after] - t[begin], 1e-3)
    c, s = np.cos(rows[begin, 5]), np.sin(rows[begin, 5])
    turn = normalize_angle_modulo(rows[after, 5] - rows[begin, 5]) / max(t[after] - t[begin], 1e-3)
    angles = (way[0] - half * way[1]) / base.wheel_radius, (way[0] + half * way[1]) / base.wheel_radius
    simulator.set_motion((c * dx + s * dy, c * dy - s * dx, turn), tuple(turning[begin]), angles)
    poses = []
    for k in range(begin, len(rows) - 1 if end is None else end):
        simulator.command(*rows[k, COMMAND])
        poses.append(simulator.advance(max(t[k + 1] - t[k], 1e-4)).pose)
    return np.array(poses)


def second_on(simulator: KinematicSimulator, rows: np.ndarray) -> np.ndarray:
    """(n, 2): how far [m] and how much turned [rad] the simulated robot is off after each second."""
    t, off = rows[:, T], []
    for start in np.arange(t[0], t[-1] - SECOND, EVERY):
        begin, end = np.searchsorted(t, (start, start + SECOND))
        x, y, yaw = replay(simulator, rows, begin, end)[-1] - rows[end, POSE]
        off.append((np.hypot(x, y), abs(normalize_angle_modulo(yaw))))
    return np.array(off)


class CompareOptions(Options):
    """What to compare."""

    files: List[Path] = argument("Bag or CSV of recorded drives.")
    robot: AnyRobot


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Exit status 0, or 1 and one line on stderr for a file that cannot be used."""
    name = "compare_recording"
    return run_main(lambda: _compare(parsed(CompareOptions, name, __doc__, argv)), name)


def _compare(given: CompareOptions) -> None:
    drives = [drive for path in given.files for drive in read_drives(path, given.robot)]
    grounds = [ground for ground in GROUNDS if ground in ("plain", given.robot.simulation.ground)]
    simulators = {ground: standing_in(given.robot, ground) for ground in grounds}
    off = {ground: [second_on(simulator, rows) for _, rows in drives] for ground, simulator in simulators.items()}
    print("off a second on         " + "".join(f"{ground:>14}       " for ground in grounds))
    for n, (name, _) in enumerate(drives):
        _print(name[:24], [off[ground][n] for ground in grounds])
    every = {ground: np.concatenate(off[ground]) for ground in grounds}
    _print("mean", list(every.values()))


def _print(name, errors):
    means = (error.mean(axis=0) for error in errors)
    print(f"{name:24}" + "".join(f"{metres:7.3f} m {turn:7.3f} rad  " for metres, turn in means))


if __name__ == "__main__":
    sys.exit(main())
