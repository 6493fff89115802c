"""Golden file of the dimensionless encoding, tests/data/encoding.npz: observations, parameters and
rewards.

    python -m tests.policy.golden_encoding          rewrites the file after a deliberate change of
    the encoding

For each included robot the file has random inputs: scenes of one course, actions, and outcomes of
decisions. It also has the outputs of the encoding at a decision period of 1 s: observations,
parameters of the robot's space, their actions, and the terms of the reward with each of REWARDS.
test_encoding.py compares with the precision of float32, because the last bits of numpy's float64
functions depend on the processor.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict

import numpy as np

from applr_ros1.policy.decision import Context
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.robots import NAMES, Robot, load
from applr_ros1.robots.learned import OUTPUTS
from training.env.outcome import Outcome
from training.env.reward import Reward

FILE = Path(__file__).resolve().parents[1] / "data" / "encoding.npz"
PERIOD = 1.0
SCENES = 4
PLAN = 24
REWARDS = (
    Reward(),
    Reward(c_p=2.0, c_c=0.1, along_y=True, exact_time=True, lowest=True, c_collision=5.0),
)
FLAGS = ("contact", "success", "flipped")
NUMBERS = ("progress", "progress_y", "last_scan_min", "decision_min")
Arrays = Dict[str, np.ndarray]


def inputs(robot: Robot, rng: np.random.Generator) -> Arrays:
    """Return random scenes, actions and outcomes."""
    encoding = DimensionlessEncoding(robot, PERIOD)
    layout = encoding.layout
    scale = encoding.scale
    poses = np.cumsum(rng.uniform(-0.2, 0.4, (SCENES, 3)) * scale, axis=0)
    ways = np.cumsum(rng.uniform(-0.05, 0.3, (SCENES, PLAN, 2)) * scale, axis=1)
    return {
        "ranges": np.exp(rng.normal(0.5, 1.0, (SCENES, layout.beams))).astype(np.float32)
        * np.float32(scale),
        "poses": poses,
        "twists": rng.uniform(-0.3, 1.0, (SCENES, 2)) * robot.base.max_speed,
        "phis": rng.uniform(-3.0, 3.0, SCENES),
        "goal": np.array([8.0 * scale, 5.0 * scale, 0.0]),
        "plans": poses[:, None, :2] + ways,
        "actions": rng.uniform(-1.0, 1.0, (SCENES, len(OUTPUTS))).astype(np.float32),
        "numbers": rng.uniform(0.05, 1.5, (SCENES, len(NUMBERS))) * scale,
        "flags": np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], bool),
        "seconds": np.array([1.0, 1.0, 0.35, 0.6]),
        "movers": rng.normal(0.0, 0.5, (SCENES, 5, 4))
        * ([6.0 * scale] * 2 + [robot.base.max_speed] * 2),
    }


def outputs(robot: Robot, given: Arrays) -> Arrays:
    """Return the outputs of the encoding. The parameters of one decision are the current ones at
    the next.
    """
    encoding = DimensionlessEncoding(robot, PERIOD)
    thetas = np.array([encoding.theta(action) for action in given["actions"]])
    before = np.vstack([encoding.space.theta0, thetas[:-1]])
    encoding.reset()
    seen = [
        encoding.observe(_context(encoding, given, index, before[index])) for index in range(SCENES)
    ]
    return {
        "observations": np.array(seen),
        "thetas": thetas.astype(np.float32),
        "meant": np.array([encoding.action(theta) for theta in thetas], np.float32),
        "rewards": np.array(
            [
                [_reward(encoding, reward, given, index, thetas[index]) for index in range(SCENES)]
                for reward in REWARDS
            ],
            np.float32,
        ),
    }


def _context(
    encoding: DimensionlessEncoding, given: Arrays, index: int, theta: np.ndarray
) -> Context:
    rows = (given["poses"][index], given["twists"][index], given["goal"])
    pose, twist, goal = (tuple(row.tolist()) for row in rows)
    phi = float(given["phis"][index])
    # None at first, later more than fit into an observation.
    seen = (
        given["plans"][index],
        given["movers"][index, : 2 * index],
    )
    return Context(
        given["ranges"][index], phi, theta, PERIOD * index, pose, twist, goal, *seen, encoding.space
    )


def _reward(encoding: Any, reward: Reward, given: Arrays, index: int, theta: np.ndarray) -> list:
    """Return the terms of the reward for a decision 10 s before the time limit."""
    values: Dict[str, Any] = {
        name: float(value) for name, value in zip(NUMBERS, given["numbers"][index])
    }
    values.update({name: bool(value) for name, value in zip(FLAGS, given["flags"][index])})
    outcome = Outcome(theta, seconds=float(given["seconds"][index]), decisions=90, **values)
    return list(reward(outcome, 100, PERIOD, encoding)[1].values())


def main() -> None:
    """Write the golden file."""
    arrays: Arrays = {}
    for number, name in enumerate(NAMES):
        robot = load(name)
        given = inputs(robot, np.random.default_rng(number))
        arrays.update(
            {f"{name}/{key}": array for key, array in {**given, **outputs(robot, given)}.items()}
        )
    np.savez_compressed(FILE, **arrays)
    print(f"{FILE}: {FILE.stat().st_size} bytes")


if __name__ == "__main__":
    main()
