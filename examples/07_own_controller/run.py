"""Evaluates a controller of one's own (pursuit.py), which commands velocities, beside the default parameters.

The same as `evaluate.py --methods dwa,pursuit=pursuit.py:Pursuit:0.8 ...` in this folder.
docs/tutorials/own_method.md says how the same class drives over ROS.
"""

import argparse
import csv
import subprocess
import sys
from pathlib import Path


def main() -> None:
    """Evaluate, and print each method's times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", default="generated:0,generated:7", help="courses to drive (default %(default)s)")
    parser.add_argument("--trials", default="2", help="in each world (default %(default)s)")
    parser.add_argument("--out", default="results_pursuit", help="folder to write (default %(default)s)")
    options = parser.parse_args()

    file = Path(__file__).resolve().with_name("pursuit.py")
    command = [sys.executable, "-m", "training.evaluate", "--methods", "dwa,pursuit=%s:Pursuit:0.8" % file]
    command += ["--worlds", options.worlds, "--trials", options.trials, "--simulator", "kinematic"]
    subprocess.run(command + ["--out", options.out], check=True)
    with open(Path(options.out) / "trials.csv", newline="") as file:
        for row in csv.DictReader(file):
            reached = "goal" if row["success"] == "True" else "no goal"
            print("%s %s trial %s: %s after %s s" % (row["method"], row["world"], row["trial"], reached, row["time_s"]))


if __name__ == "__main__":
    main()
