"""Evaluates a method of one's own (cautious.py) beside the planner's default parameters.

The same as the command `evaluate.py --methods dwa,cautious:Cautious ...` with this folder on PYTHONPATH.
The report with all tables and figures is OUT/report/index.html.
"""

import argparse
import csv
import os
import subprocess
import sys
from pathlib import Path


def main() -> None:
    """Evaluate, and print each method's times."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", default="generated:0,generated:7", help="courses to drive (default %(default)s)")
    parser.add_argument("--trials", default="2", help="in each world (default %(default)s)")
    parser.add_argument("--out", default="results_cautious", help="folder to write (default %(default)s)")
    options = parser.parse_args()

    here = str(Path(__file__).resolve().parent)
    environment = dict(os.environ, PYTHONPATH=os.pathsep.join([here, os.environ.get("PYTHONPATH", "")]))
    command = [sys.executable, "-m", "applr_ros1.training.evaluate", "--methods", "dwa,cautious:Cautious"]
    command += ["--worlds", options.worlds, "--trials", options.trials, "--simulator", "kinematic"]
    subprocess.run(command + ["--out", options.out], env=environment, check=True)
    with open(Path(options.out) / "trials.csv", newline="") as file:
        for row in csv.DictReader(file):
            reached = "goal" if row["success"] == "True" else "no goal"
            print("%s %s trial %s: %s after %s s" % (row["method"], row["world"], row["trial"], reached, row["time_s"]))


if __name__ == "__main__":
    main()
