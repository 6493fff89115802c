"""Drives out of dead ends: `python -m tests.benchmarks.dead_ends --out DIR`.

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
    left, right, front = rng.uniform(0.10, 0.12, 3)
    return Pocket(left, right, front, depth=0.5)


def other(rng: np.random.Generator) -> Pocket:
    """Draw the measures of another pocket."""
    left, right, front = rng.uniform(0.10, 0.25, 3)
    behind = math.inf
    if rng.random() < 0.5:
        behind = rng.uniform(1.3, 2.5)
    return Pocket(
        left,
        right,
        front,
        depth=rng.uniform(0.4, 0.8),
        # The robot's corners keep at least 4 cm.
        yaw=rng.uniform(-0.1, 0.1),
        uneven=0.02,
        left_lean=rng.uniform(0.0, 0.3),
        right_lean=rng.uniform(0.0, 0.3),
        wings=tuple(rng.uniform(0.5, 2.5, 2)),
        behind=behind,
    )


def row(begin: Tuple[float, float], end: Tuple[float, float]) -> Array:
    """Return the centres (n, 2) of posts in a row [m]."""
    count = max(2, round(math.dist(begin, end) / SPACING_M) + 1)
    return np.linspace(begin, end, count)


def posts(pocket: Pocket, rng: np.random.Generator) -> Array:
    """Return the posts (n, 3) of a pocket: x, y, radius [m]."""
    half_length, half_width = np.abs(corners(JACKAL)).max(axis=0).tolist()
    ahead = half_length + pocket.front + POST_M
    left = -(half_width + pocket.left + POST_M)
    right = half_width + pocket.right + POST_M
    # Beside the robot the walls are straight, so that it starts with its gaps.
    tail = -half_length - POST_M
    left_mouth = left - pocket.left_lean * (pocket.depth + tail), -pocket.depth
    right_mouth = right + pocket.right_lean * (pocket.depth + tail), -pocket.depth
    left_wing, right_wing = pocket.wings
    rows = [
        row((left, ahead), (right, ahead)),
        row((left, tail), (left, ahead)),
        row((right, tail), (right, ahead)),
        row(left_mouth, (left, tail)),
        row(right_mouth, (right, tail)),
        row((left_mouth[0] - left_wing, -pocket.depth), left_mouth),
        row(right_mouth, (right_mouth[0] + right_wing, -pocket.depth)),
    ]
    if math.isfinite(pocket.behind):
        end = -pocket.depth - pocket.behind - 2.0 * POST_M
        rows.append(row((left_mouth[0] - left_wing, end), (right_mouth[0] + right_wing, end)))
    centres = np.concatenate(rows)
    centres = centres + rng.uniform(-pocket.uneven, pocket.uneven, centres.shape)
    return np.column_stack([centres, np.full(len(centres), POST_M)])


def world(name: str, kind: str, number: int) -> World:
    """Return a made-up world; the same number always gives the same one."""
    seed, draw = {"tight": (TIGHT_SEED, tight), "other": (OTHER_SEED, other)}[kind]
    rng = np.random.default_rng([seed, number])
    pocket = draw(rng)
    obstacles = posts(pocket, rng)
    yaw = 0.5 * math.pi + pocket.yaw
    beside = obstacles[:, 0].min() - 1.0
    path = [(0.0, 0.0), (0.0, -pocket.depth - 0.6), (beside, -pocket.depth - 0.6)]
    path += [(beside, 1.0), (0.0, GOAL_M)]
    course = Course(
        start=(0.0, 0.0, yaw),
        goal=(0.0, GOAL_M, 0.5 * math.pi),
        finish_y=None,
        goal_tolerance=1.0,
        path=np.array(path),
    )
    return World(name, obstacles, np.zeros((0, 5)), course)


def written(folder: Path, chosen: str) -> str:
    """Write the worlds of a set to a folder, and return their specification."""
    kind, numbers = SETS[chosen]
    folder.mkdir(parents=True, exist_ok=True)
    for number in numbers:
        name = f"{chosen}_{number}"
        sdf_writer.write(world(name, kind, number), str(folder / f"{name}.world"))
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
        workers=arguments.workers,
        seed=arguments.seed,
        out=str(arguments.out / name),
        traces=arguments.traces,
        report=False,
    )
    evaluate(options)
    for line in lines(arguments.out / name):
        print(f"{name} {line}", flush=True)


def lines(folder: Path) -> Iterator[str]:
    """Yield the results of an evaluation: a line for each method."""
    trials = read_trials(folder / TRIALS)
    for method, rows in trials.groupby("method", sort=False):
        arrivals = f"{int(rows.success.sum())} of {len(rows)} arrive"
        contacts = f"{int(rows.collided.sum())} contacts"
        mean_s = float(np.mean(seconds(rows)))
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
    parser.add_argument("--workers", type=int, default=0)
    parser.add_argument("--traces", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    files: List[str] = []
    for chosen in arguments.sets:
        if chosen in SETS:
            drive(
                arguments,
                chosen,
                written(arguments.out / "worlds" / chosen, chosen),
                arguments.trials,
            )
        else:
            files.append(chosen)
    if files:
        drive(arguments, "files", ",".join(files), arguments.trials)


if __name__ == "__main__":
    main()
