"""Evaluates an actor of another project (barn_actor.py) beside the planner's default parameters.

The same as `evaluate.py --methods dwa,barn=barn_actor.py:BarnActor:actor.safetensors ...` in this folder. Without an
actor file a network with random weights is made, which shows the way and drives badly.
"""

import argparse
import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import safetensors.numpy


def random_network(path: str, sizes=(721, 64, 64, 7)) -> None:
    """Write a network with random weights, in the names that ForeignActor reads."""
    draws = np.random.default_rng(0)
    weights = {}
    for i, (inputs, outputs) in enumerate(zip(sizes, sizes[1:])):
        weights["%d.weight" % i] = draws.normal(0.0, inputs**-0.5, (outputs, inputs)).astype(np.float32)
        weights["%d.bias" % i] = np.zeros(outputs, np.float32)
    safetensors.numpy.save_file(weights, path)


def main() -> None:
    """Evaluate, and print each method's times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--actor", help="safetensors file with its layers (default: random weights)")
    parser.add_argument("--worlds", default="generated:0,generated:7", help="courses to drive (default %(default)s)")
    parser.add_argument("--trials", default="2", help="in each world (default %(default)s)")
    parser.add_argument("--out", default="results_barn", help="folder to write (default %(default)s)")
    options = parser.parse_args()

    if not options.actor:
        options.actor = "random_actor.safetensors"
        random_network(options.actor)
    method = "barn=%s:BarnActor:%s" % (Path(__file__).resolve().with_name("barn_actor.py"), options.actor)
    command = [sys.executable, "-m", "training.evaluate", "--methods", "dwa," + method]
    command += ["--worlds", options.worlds, "--trials", options.trials, "--simulator", "kinematic"]
    subprocess.run(command + ["--out", options.out], check=True)
    with open(Path(options.out) / "trials.csv", newline="") as file:
        for row in csv.DictReader(file):
            reached = "goal" if row["success"] == "True" else "no goal"
            print("%s %s trial %s: %s after %s s" % (row["method"], row["world"], row["trial"], reached, row["time_s"]))


if __name__ == "__main__":
    main()
