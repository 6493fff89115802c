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

from applr_ros1.drives.outcome import Outcome
from applr_ros1.policy.decision import Context
from applr_ros1.policy.dimensionless import DimensionlessEncoding
from applr_ros1.robots import NAMES, Robot, load
from applr_ros1.robots.learned import OUTPUTS
from training.env.reward import Reward

FILE = Path(__file__).resolve().parents[1] / "data" / "encoding.npz"
PERIOD = 1.0  # time between two decisions [s]
SCENES = 4  # number of decisions of the course
PLAN = 24  # number of points of a plan
# The default reward, and one that differs in every option
REWARDS = (
    Reward(),
    Reward(
        c_p=2.0,
        c_c=0.1,
        along_y=True,
        exact_time=True,
        lowest=True,
        c_collision=5.0,
    ),
)
FLAGS = ("contact", "success", "flipped")
NUMBERS = ("progress", "progress_y", "last_scan_min", "decision_min")
Arrays = Dict[str, np.ndarray]


def inputs(robot: Robot, rng: np.random.Generator) -> Arrays:
    """Return random scenes, actions and outcomes."""
    encoding = DimensionlessEncoding(robot, PERIOD)
    layout = encoding.layout
    scale = encoding.scale
    # The order of the draws decides their values.
    steps = rng.uniform(-0.2, 0.4, (SCENES, 3)) * scale
    poses = np.cumsum(steps, axis=0)
    plan_steps = rng.uniform(-0.05, 0.3, (SCENES, PLAN, 2)) * scale
    from_robot = np.cumsum(plan_steps, axis=1)
    # From very near to beyond every cap
    logarithms = rng.normal(0.5, 1.0, (SCENES, layout.beams))
    ranges = np.exp(logarithms).astype(np.float32)
    largest_speed = robot.base.max_speed
    mover_units = [6.0 * scale, 6.0 * scale, largest_speed, largest_speed]  # x, y, vx, vy
    return {
        "ranges": ranges * np.float32(scale),
        "poses": poses,
        "twists": rng.uniform(-0.3, 1.0, (SCENES, 2)) * largest_speed,
        "phis": rng.uniform(-3.0, 3.0, SCENES),
        "goal": np.array([8.0 * scale, 5.0 * scale, 0.0]),
        "plans": poses[:, None, :2] + from_robot,
        "actions": rng.uniform(-1.0, 1.0, (SCENES, len(OUTPUTS))).astype(np.float32),
        "numbers": rng.uniform(0.05, 1.5, (SCENES, len(NUMBERS))) * scale,
        # Without any flag, and with each of them
        "flags": np.array(
            [
                (0, 0, 0),
                (1, 0, 0),
                (0, 1, 0),
                (0, 0, 1),
            ],
            bool,
        ),
        "seconds": np.array([1.0, 1.0, 0.35, 0.6]),
        "movers": rng.normal(0.0, 0.5, (SCENES, 5, 4)) * mover_units,
    }


def outputs(robot: Robot, scenes: Arrays) -> Arrays:
    """Return the outputs of the encoding. The parameters of one decision are the current ones at
    the next.
    """
    encoding = DimensionlessEncoding(robot, PERIOD)
    # In force are the parameters as the Pilot clips them.
    thetas = np.array([encoding.space.clip(encoding.theta(action)) for action in scenes["actions"]])
    current_thetas = np.vstack([encoding.space.theta0, thetas[:-1]])
    actions = [encoding.action(theta) for theta in thetas]

    # Observations have memory: their order is that of the course.
    encoding.forget_decision()
    observations = []
    for index in range(SCENES):
        context = _context(encoding, scenes, index, current_thetas[index])
        observations.append(encoding.observe(context))

    rewards = []
    for reward in REWARDS:
        reward_terms = []
        for index, theta in enumerate(thetas):
            reward_terms.append(_reward(encoding, reward, scenes, index, theta))
        rewards.append(reward_terms)
    return {
        "observations": np.array(observations),
        "thetas": thetas.astype(np.float32),
        "meant": np.array(actions, np.float32),
        "rewards": np.array(rewards, np.float32),
    }


def _context(
    encoding: DimensionlessEncoding, scenes: Arrays, index: int, theta: np.ndarray
) -> Context:
    """Return what a method sees at a decision."""
    return Context(
        ranges=scenes["ranges"][index],
        phi=float(scenes["phis"][index]),
        theta=theta,
        time=PERIOD * index,
        pose=tuple(scenes["poses"][index].tolist()),
        twist=tuple(scenes["twists"][index].tolist()),
        goal=tuple(scenes["goal"].tolist()),
        plan=scenes["plans"][index],
        # None at first, later more than fit into an observation
        movers=scenes["movers"][index, : 2 * index],
        space=encoding.space,
    )


def _reward(encoding: Any, reward: Reward, scenes: Arrays, index: int, theta: np.ndarray) -> list:
    """Return the terms of the reward for a decision 10 s before the time limit."""
    values: Dict[str, Any] = dict(zip(NUMBERS, scenes["numbers"][index].tolist()))
    values.update(zip(FLAGS, scenes["flags"][index].tolist()))
    # 90 of 100 decisions of 1 s are used up.
    outcome = Outcome(
        theta,
        seconds=float(scenes["seconds"][index]),
        decisions=90,
        **values,
    )
    _, terms = reward(outcome, 100, PERIOD, encoding)
    return list(terms.values())


def main() -> None:
    """Write the golden file."""
    arrays: Arrays = {}
    for seed, robot_name in enumerate(NAMES):
        robot = load(robot_name)
        scenes = inputs(robot, np.random.default_rng(seed))
        for key, array in {**scenes, **outputs(robot, scenes)}.items():
            arrays[f"{robot_name}/{key}"] = array
    np.savez_compressed(FILE, **arrays)
    print(f"{FILE}: {FILE.stat().st_size} bytes")


if __name__ == "__main__":
    main()
