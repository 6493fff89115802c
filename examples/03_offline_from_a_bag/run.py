"""Records drives to a bag, makes a dataset of the bag, and trains a policy from it, offline.

Here the drives are simulated and their parameters random. A bag of a real robot (`record:=drive.bag` of the launch
file) goes the same way; the two commands are the ones to use then.
"""

import argparse
import subprocess
import sys
from pathlib import Path

import numpy as np
from recording import RecordingEpisode, StackWriter

import sim_bridge
import worlds
from applr_ros1 import robots
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.parameter_space import SPACE


def record(bag: Path, courses: int, decisions: int) -> None:
    """Drive `courses` built-in worlds for at most `decisions` decisions each, and record what a robot would."""
    random = np.random.default_rng(0)
    with StackWriter(bag) as writer:
        episode = RecordingEpisode(
            sim_bridge.make("kinematic"), MoveBase(robots.JACKAL.parameters()), writer, period=2.0, limit=decisions
        )
        for number in range(courses):
            outcome = episode.reset(worlds.load("generated:%d" % number), seed=number)
            while not outcome.over:
                outcome = episode.decide(SPACE.to_theta(random.uniform(-1.0, 1.0, len(SPACE))))


def main() -> None:
    """Record, convert, train."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--courses", type=int, default=6, help="drives to record (default %(default)s)")
    parser.add_argument("--decisions", type=int, default=20, help="of each drive at most (default %(default)s)")
    parser.add_argument("--gradient-steps", default="300", help="gradient steps (default %(default)s)")
    parser.add_argument("--net-arch", nargs="+", default=["256", "256"], help="hidden layers (default 256 256)")
    parser.add_argument("--out", default="offline", help="folder to write; must be new (default %(default)s)")
    options = parser.parse_args()

    out = Path(options.out)
    out.mkdir(parents=True)
    record(out / "drives.bag", options.courses, options.decisions)
    command = [sys.executable, "-m", "training.bags_to_dataset", str(out / "drives.bag"), "--out", str(out / "dataset")]
    subprocess.run(command + ["--finish", "5.925"], check=True)
    command = [sys.executable, "-m", "training.train", "--dataset", str(out / "dataset"), "--out", str(out / "run")]
    command += ["--gradient-steps", options.gradient_steps, "--net-arch", *options.net_arch, "--bc-alpha", "2.5"]
    command += ["--eval-worlds", "none"]
    subprocess.run(command, check=True)
    print("%s: drive it with method:=applr policy:=..." % (out / "run" / "actor.safetensors"))


if __name__ == "__main__":
    main()
