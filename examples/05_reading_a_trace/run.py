"""Drives one trial, reads its trace, and draws the path over the map with the speed and a parameter over time.

evaluate.py keeps the traces of the first trial of each world and method in OUT/traces (`--traces N` for more). A trace
has an instant every 50 ms: `time` (n,) s, `pose` (n, 3) x, y [m], yaw [rad], `twist` (n, 2) v [m/s], w [rad/s]; and for
every decision its time and a row of parameters: `decided` (k,) s, `theta` (k, 8).
"""

import argparse
import subprocess
import sys

import matplotlib
import numpy as np

import worlds
from applr_ros1.policy.parameter_space import SPACE
from training.evaluation.store import read_trace


def picture(trace: dict, world, parameter: str, path: str) -> None:
    """Left the path, coloured by speed; right speed and parameter over time."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 5))
    for x, y, radius in world.cylinders:
        left.add_patch(pyplot.Circle((x, y), radius, color="0.6"))
    points = left.scatter(trace["pose"][:, 0], trace["pose"][:, 1], c=trace["twist"][:, 0], s=4)
    figure.colorbar(points, ax=left, label="speed [m/s]")
    left.set_aspect("equal")
    right.plot(trace["time"], trace["twist"][:, 0], label="speed [m/s]")
    values = trace["theta"][:, SPACE.names.index(parameter)]
    right.step(trace["decided"], values, where="post", label=parameter)
    right.set_xlabel("time [s]")
    right.legend()
    figure.savefig(path, dpi=100)


def main() -> None:
    """Drive, read, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="generated:0", help="course to drive (default %(default)s)")
    parser.add_argument("--method", default="applr", help="whose trial (default %(default)s)")
    parser.add_argument("--parameter", default="max_vel_x", choices=SPACE.names, help="to show (default %(default)s)")
    parser.add_argument("--out", default="results_trace", help="folder to write (default %(default)s)")
    options = parser.parse_args()

    command = [sys.executable, "-m", "training.evaluate", "--worlds", options.world, "--methods", options.method]
    command += ["--trials", "1", "--simulator", "kinematic", "--workers", "1", "--no-report", "--out", options.out]
    subprocess.run(command, check=True)
    world = worlds.load(options.world)
    trace = read_trace(options.out, world.name, options.method, 0)
    if trace is None:
        sys.exit("%s holds no trace of %s in %s: give another --out" % (options.out, options.method, options.world))
    picture(trace, world, options.parameter, "%s/trace.png" % options.out)
    length = np.hypot(*np.diff(trace["pose"][:, :2], axis=0).T).sum()
    print("%.1f m in %.1f s; %s/trace.png" % (length, trace["time"][-1] - trace["time"][0], options.out))


if __name__ == "__main__":
    main()
