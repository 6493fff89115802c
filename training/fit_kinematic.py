"""Fits KinematicSimulator's free numbers to PybulletSimulator: `python -m training.fit_kinematic [--robot husky]`.

Prints step responses of both side by side, then how their contacts differ before and after the fit.

Contacts are compared on scenes: obstacles strewn about the robot and two commands, most of which end at an obstacle.
Both robots get the same seed, so that ground and wheels are equally uneven. Takes about a minute. The numbers found are
those of the section `simulation` of robot.yaml.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any, Dict, Optional, Sequence, Tuple

import numpy as np

from applr_ros1.common.angles import normalize_angle_modulo
from applr_ros1.common.errors import run_main
from applr_ros1.robots import Robot
from sim_bridge.kinematic_simulator import KinematicSimulator
from sim_bridge.pybullet_simulator import PybulletSimulator
from sim_bridge.scenes import STEP, drive, small_world
from sim_bridge.simulator import Simulator
from training.common.command_line import AnyRobot, parsed
from training.common.options import Options, option

OPEN_PLANE = small_world()  # a world with nothing in it
Recordings = Sequence[Tuple[np.ndarray, np.ndarray]]  # what Scene.drive returns, by scene

FITTED = ("wheel_rub", "body_rub", "undo")  # of the section `simulation` of robot.yaml
RESPONSES = [  # shares of the largest speed and turn
    ("start and stop, straight", (0.5, 0.0)),
    ("start and stop, turning", (0.0, 0.3925)),
    ("curve", (0.25, 0.25)),
    ("reverse", (-0.25, 0.0)),
]
DRIFTS = [
    ("8 s in place, .39 of the largest turn", 0.0, 0.3925, 8.0),
    ("the other way", 0.0, -0.3925, 8.0),
    ("10 s straight, half speed", 0.5, 0.0, 10.0),
    ("10 s curve, half speed", 0.5, 0.125, 10.0),
]


class Scene:
    """Obstacles about the origin, and what to drive there: of the size of a robot, within its limits.

    seed: of the scene, and of the unevenness of its ground and of the robot's wheels.
    """

    def __init__(self, seed: int, robot: Robot):
        self._seed, rng = seed, np.random.default_rng(seed)
        scale, self._base = robot.world_scale, robot.base
        spots = rng.uniform(-1.1, 1.1, (16, 2))
        cylinders = np.array([(x, y, 0.075) for x, y in spots if max(abs(x) - 0.35, abs(y) - 0.32) > 0])
        boxes = np.empty((0, 5))
        if seed % 3 == 0:  # a wall askew ahead instead of cylinders
            yaw = rng.uniform(-0.7, 0.7)
            cylinders = np.empty((0, 3))
            boxes = np.array([(0.8 + abs(yaw) * 0.5, rng.uniform(-0.4, 0.4), yaw, 0.3, 2.0)])
            boxes *= (scale, scale, 1.0, scale, scale)
        self.world = small_world((cylinders * scale).tolist(), boxes.tolist())
        self.commands = [self._some_command(rng), self._some_command(rng)]
        self._steps = int(round(30 * scale / (self._base.max_speed / 2.0)))  # of each command

    def _some_command(self, rng):
        v, w = self._base.max_speed / 2.0, self._base.max_yaw_rate / 4.0
        if rng.random() < 0.75:
            return v * rng.uniform(0.1, 1.2), w * rng.uniform(-1.5, 1.5)
        return (v * -0.5, 0.0) if rng.random() < 0.3 else (0.0, w * rng.uniform(-2.0, 2.0))

    def drive(self, simulator: Simulator) -> Tuple[np.ndarray, np.ndarray]:
        """Poses (k, 3) every 50 ms, whether there was contact (k,)."""
        simulator.reset(self.world, self._seed)
        poses, touched = [], []
        for v, w in self.commands:
            for _ in range(self._steps):
                state = drive(simulator, v, w, STEP)
                poses.append(state.pose)
                touched.append(state.contact)
        return np.array(poses), np.array(touched)


def compare(robot: Robot, scenes: Sequence[Scene], recorded: Recordings) -> np.ndarray:
    """A row per scene: how far [m, rad] the robots are apart at the end and on average, and which of them touched."""
    simulator = KinematicSimulator(robot)
    rows = []
    for scene, (poses, touched) in zip(scenes, recorded):
        mine, mine_touched = scene.drive(simulator)
        apart = np.hypot(*(mine[:, :2] - poses[:, :2]).T)
        turn = np.abs(normalize_angle_modulo(mine[:, 2] - poses[:, 2]))
        rows.append((apart[-1], turn[-1], apart.mean(), turn.mean(), touched.any(), mine_touched.any()))
    return np.array(rows, dtype=float)


def loss(robot: Robot, scenes: Sequence[Scene], recorded: Recordings) -> float:
    """Mean distance between the robots' drives [m], a radian counting as .2 m, each scene's bounded.

    Lengths are those of a robot of the Jackal's size. Arguments as for compare().
    """
    rows = compare(robot, scenes, recorded)
    return float(np.mean(np.minimum(rows[:, 2] / robot.world_scale, 0.3) + 0.2 * np.minimum(rows[:, 3], 1.5)))


def with_values(robot: Robot, values: np.ndarray) -> Robot:
    """The robot with other FITTED numbers, rounded as robot.yaml holds them."""
    rounded: Dict[str, Any] = {name: round(float(value), 3) for name, value in zip(FITTED, values)}
    return replace(robot, simulation=replace(robot.simulation, **rounded))


def fit(robot: Robot, scenes: Sequence[Scene], recorded: Recordings, sweeps: int = 3) -> Robot:
    """Coordinate search from the robot's own numbers; returns the robot with the best ones."""
    best = np.array([getattr(robot.simulation, name) for name in FITTED])
    low, high = np.array([0.0, 0.0, 0.02]), np.array([1.0, 1.0, 1.0])
    error = loss(with_values(robot, best), scenes, recorded)
    width = (high - low) / 4
    for _ in range(sweeps):
        for i in range(len(best)):
            for shift in (-2, -1, 1, 2):
                trial = best.copy()
                trial[i] = min(max(best[i] + shift * width[i] / 2, low[i]), high[i])
                now = loss(with_values(robot, trial), scenes, recorded)
                if now < error:
                    error, best = now, trial
        width = width / 2
    return with_values(robot, best)


def responses(simulators: Sequence[Tuple[str, Simulator]]) -> None:
    """Print true speeds at 50, 100, 200, 500 ms after a start and after a stop, for each simulator."""
    print("%-37s 50 ms   100     200     500  | stop: 50     100     250 ms after" % "response (v or w)")
    for name, (speed, turn) in RESPONSES:
        for label, simulator in simulators:
            simulator.reset(OPEN_PLANE, 0)
            pick = 0 if speed else 1
            v, w = speed * simulator.robot.base.max_speed, turn * simulator.robot.base.max_yaw_rate
            rise = [drive(simulator, v, w, STEP).twist[pick] for _ in range(20)]
            fall = [drive(simulator, 0.0, 0.0, STEP).twist[pick] for _ in range(5)]
            print(
                "%-26s %-10s %s  | %s"
                % (
                    name,
                    label,
                    "  ".join("%6.3f" % rise[i] for i in (0, 1, 3, 9)),
                    "  ".join("%6.3f" % fall[i] for i in (0, 1, 4)),
                )
            )


def drifts(simulators: Sequence[Tuple[str, Simulator]]) -> None:
    """Print where base_link is after whole turns in place and a straight line, for each simulator."""
    print("%-40s %-10s x       y       yaw" % ("pose after", ""))
    for name, v, w, seconds in DRIFTS:
        for label, simulator in simulators:
            simulator.reset(OPEN_PLANE, 1)
            base = simulator.robot.base
            pose = drive(simulator, v * base.max_speed, w * base.max_yaw_rate, seconds).pose
            print("%-40s %-10s %7.3f %7.3f %7.3f" % ((name, label) + pose))


def report(title: str, rows: np.ndarray) -> None:
    """Print one line about the rows of compare()."""
    hit = rows[:, 4] > 0
    print(
        "%s: %d scenes with contact: end apart median %.3f m, mean %.3f m, 90 %% %.3f m; "
        "turned apart median %.3f rad; contact seen by both or neither in %.0f %%"
        % (
            title,
            hit.sum(),
            np.median(rows[hit, 0]),
            rows[hit, 0].mean(),
            np.quantile(rows[hit, 0], 0.9),
            np.median(rows[hit, 1]),
            100 * np.mean(rows[:, 4] == rows[:, 5]),
        )
    )


class FitOptions(Options):
    """What to fit."""

    scenes: int = option(60, "Number of scenes to fit; as many again are kept aside for the check.", ge=1, le=10**6)
    robot: AnyRobot = option("jackal", "Robot to fit: a name or a folder.")


def main(argv: Optional[Sequence[str]] = None) -> int:
    """Exit status 0, or a message where a simulator cannot be made."""
    program, about = "python -m training.fit_kinematic", (__doc__ or "").splitlines()[0]
    return run_main(lambda: _print_fit(parsed(FitOptions, program, about, argv)), "fit_kinematic")


def _print_fit(options: FitOptions) -> None:
    robot = options.robot
    bullet, kinematic = PybulletSimulator(robot), KinematicSimulator(robot)
    pair = (("pybullet", bullet), ("kinematic", kinematic))
    responses(pair)
    drifts(pair)
    scenes = [Scene(seed, robot) for seed in range(2 * options.scenes)]
    recorded = [scene.drive(bullet) for scene in scenes]
    half = options.scenes
    way = np.mean([np.hypot(*np.diff(poses[:, :2], axis=0).T).sum() for poses, _ in recorded])
    print("a scene's drive is %.2f m long on average" % way)
    report("before", compare(robot, scenes[half:], recorded[half:]))
    best = fit(robot, scenes[:half], recorded[:half])
    report("after ", compare(best, scenes[half:], recorded[half:]))
    found = ", ".join("%s: %g" % (name, getattr(best.simulation, name)) for name in FITTED)
    print("fitted on the first %d, reported on the others: %s" % (half, found))


if __name__ == "__main__":
    sys.exit(main())
