"""Drives out of dead ends: `python -m benchmarks.dead_ends --out DIR`.

The figures are for docs/explanation/results.md.

The Jackal starts in a made-up pocket: posts stand 10 to 12 cm from its sides and its front, and the
way out is behind it. In the other made-up pockets the gaps differ, the walls are uneven and may
open like a funnel, the robot stands askew, and a wall may stand behind the mouth. Straight back
nothing is in the way: a robot that drives into a pocket has seen what is behind it, but one that
starts there has not. The worlds `choosing` serve the choice of rules; `final` serves published
figures only.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Dict, Iterator, List, NamedTuple, Tuple

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.robots import JACKAL
from applr_ros1.robots.geometry import corners
from training.evaluate.evaluation import EvaluationOptions, evaluate
from training.evaluate.score import seconds
from training.evaluate.table import TRIALS, read_trials
from worlds import Course, World, sdf_writer

POST_M = 0.075  # radius of a post, as in BARN's worlds [m]
# distance between the centres of neighbouring posts: no gap shows the laser what is behind [m]
SPACING_M = 0.13
GOAL_M = 10.0  # distance of the goal ahead of the start [m]
# Numbers of the worlds of each set
SETS: Dict[str, Tuple[str, range]] = {
    "tight": ("tight", range(20)),
    "choosing": ("other", range(100, 124)),
    "final": ("other", range(200, 240)),
}
# Seeds of the two kinds of pockets: published figures are of these worlds.
TIGHT_SEED = 0x70C1
OTHER_SEED = 0x70C2


class Pocket(NamedTuple):
    """Measures of a pocket, in the frame of the robot's start: x to the right, y ahead.

    Attributes:
        left, right, front: Gaps between the robot's outline and the posts [m].
        depth: Distance from the robot's centre back to the mouth [m].
        yaw: Rotation of the robot in the pocket [rad].
        uneven: Largest shift of a post out of its row [m].
        left_lean, right_lean: Shift outwards of each wall per metre behind the robot.
        wings: Lengths of the walls to the left and right of the mouth [m].
        behind: Distance from the mouth to a wall behind it [m]; inf without this wall.
    """

    left: float
    right: float
    front: float
    depth: float
    yaw: float = 0.0
    uneven: float = 0.0
    left_lean: float = 0.0
    right_lean: float = 0.0
    wings: Tuple[float, float] = (1.0, 1.0)
    behind: float = math.inf


def tight(rng: np.random.Generator) -> Pocket:
    """Draw the measures of the pocket that leaves the robot 10 to 12 cm."""
    left_gap, right_gap, front_gap = rng.uniform(0.10, 0.12, 3)
    return Pocket(left_gap, right_gap, front_gap, depth=0.5)


def other(rng: np.random.Generator) -> Pocket:
    """Draw the measures of another pocket."""
    left_gap, right_gap, front_gap = rng.uniform(0.10, 0.25, 3)
    # About half of the pockets have a wall behind the mouth.
    distance_behind = math.inf
    if rng.random() < 0.5:
        distance_behind = rng.uniform(1.3, 2.5)
    return Pocket(
        left_gap,
        right_gap,
        front_gap,
        depth=rng.uniform(0.4, 0.8),
        # The robot's corners keep at least 4 cm.
        yaw=rng.uniform(-0.1, 0.1),
        uneven=0.02,
        left_lean=rng.uniform(0.0, 0.3),
        right_lean=rng.uniform(0.0, 0.3),
        wings=tuple(rng.uniform(0.5, 2.5, 2)),
        behind=distance_behind,
    )


def row(begin: Tuple[float, float], end: Tuple[float, float]) -> Array:
    """Return the centres (n, 2) of posts in a row [m]."""
    post_count = max(2, round(math.dist(begin, end) / SPACING_M) + 1)
    return np.linspace(begin, end, post_count)


def posts(pocket: Pocket, rng: np.random.Generator) -> Array:
    """Return the posts (n, 3) of a pocket: x, y, radius [m]."""
    half_length, half_width = np.abs(corners(JACKAL)).max(axis=0).tolist()
    front_y = half_length + pocket.front + POST_M
    left_x = -(half_width + pocket.left + POST_M)
    right_x = half_width + pocket.right + POST_M
    # Beside the robot the walls are straight, so that it starts with its gaps.
    tail_y = -half_length - POST_M
    mouth_y = -pocket.depth
    left_mouth_x = left_x - pocket.left_lean * (pocket.depth + tail_y)
    right_mouth_x = right_x + pocket.right_lean * (pocket.depth + tail_y)
    left_wing, right_wing = pocket.wings
    left_wing_x = left_mouth_x - left_wing
    right_wing_x = right_mouth_x + right_wing

    post_rows = [
        # Around the robot
        row((left_x, front_y), (right_x, front_y)),
        row((left_x, tail_y), (left_x, front_y)),
        row((right_x, tail_y), (right_x, front_y)),
        # From behind the robot to the mouth
        row((left_mouth_x, mouth_y), (left_x, tail_y)),
        row((right_mouth_x, mouth_y), (right_x, tail_y)),
        # On both sides of the mouth
        row((left_wing_x, mouth_y), (left_mouth_x, mouth_y)),
        row((right_mouth_x, mouth_y), (right_wing_x, mouth_y)),
    ]
    if math.isfinite(pocket.behind):
        wall_y = mouth_y - pocket.behind - 2.0 * POST_M
        post_rows.append(row((left_wing_x, wall_y), (right_wing_x, wall_y)))
    centres = np.concatenate(post_rows)
    centres = centres + rng.uniform(-pocket.uneven, pocket.uneven, centres.shape)
    return np.column_stack([centres, np.full(len(centres), POST_M)])


def world(name: str, kind: str, number: int) -> World:
    """Return a made-up world; the same number always gives the same one."""
    kind_seed, draw = {"tight": (TIGHT_SEED, tight), "other": (OTHER_SEED, other)}[kind]
    rng = np.random.default_rng([kind_seed, number])
    pocket = draw(rng)
    obstacles = posts(pocket, rng)

    # The reference path leads backwards out of the pocket, and then around it on the left.
    outside_y = -pocket.depth - 0.6
    passing_x = obstacles[:, 0].min() - 1.0
    reference_path = [
        (0.0, 0.0),
        (0.0, outside_y),
        (passing_x, outside_y),
        (passing_x, 1.0),
        (0.0, GOAL_M),
    ]
    start_yaw = 0.5 * math.pi + pocket.yaw
    course = Course(
        start=(0.0, 0.0, start_yaw),
        goal=(0.0, GOAL_M, 0.5 * math.pi),
        finish_y=None,
        goal_tolerance=1.0,
        path=np.array(reference_path),
    )
    return World(name, obstacles, np.zeros((0, 5)), course)


def written(folder: Path, chosen: str) -> str:
    """Write the worlds of a set to a folder, and return their specification."""
    kind, numbers = SETS[chosen]
    folder.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        world_name = f"{chosen}_{number}"
        sdf_writer.write(world(world_name, kind, number), str(folder / f"{world_name}.world"))
    return str(folder)


def drive(arguments: argparse.Namespace, name: str, worlds: str, trials: int) -> None:
    """Drive a set of worlds under the Challenge's rules as in Gazebo with the C++ move_base."""
    options = EvaluationOptions(
        worlds=worlds,
        methods=arguments.methods,
        trials=trials,
        protocol="barn-challenge",
        planner="cpp-like",
        monitor=True,
        seed=arguments.seed,
        out=str(arguments.out / name),
        traces=0,
        report=False,
    )
    evaluate(options)
    for result_line in lines(arguments.out / name):
        print(f"{name} {result_line}", flush=True)


def lines(folder: Path) -> Iterator[str]:
    """Yield the results of an evaluation: a line for each method."""
    trials = read_trials(folder / TRIALS)
    for method, method_trials in trials.groupby("method", sort=False):
        arrivals = f"{int(method_trials.success.sum())} of {len(method_trials)} arrive"
        contacts = f"{int(method_trials.collided.sum())} contacts"
        mean_s = float(np.mean(seconds(method_trials)))
        yield f"{method}: {arrivals}, {contacts}, {mean_s:.1f} s with failures as 100 s"


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "sets", nargs="*", default=list(SETS), help=f"{', '.join(SETS)}, or .world files"
    )
    parser.add_argument("--methods", default="applr")
    parser.add_argument("--trials", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    world_files: List[str] = []
    for set_or_file in arguments.sets:
        if set_or_file in SETS:
            folder = written(arguments.out / "worlds" / set_or_file, set_or_file)
            drive(arguments, set_or_file, folder, arguments.trials)
        else:
            world_files.append(set_or_file)
    # Files of all places make one evaluation, with one table.
    if world_files:
        drive(arguments, "files", ",".join(world_files), arguments.trials)


if __name__ == "__main__":
    main()
