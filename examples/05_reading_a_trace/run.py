"""Drives two methods, reads their traces, and draws the course with both paths, speed and parameters over time.

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

SHOWN = ["max_vel_x", "inflation_radius", "pdist_scale"]
COLOURS = ("#cc3311", "#228833", "#0077bb", "#ee7733")


def picture(traces: dict, world, parameters, path: str) -> None:
    """Above the course with the path of each method, below speed and parameters over time. traces: {method: trace}."""
    matplotlib.use("Agg")
    from matplotlib import pyplot

    rows = 2 + len(parameters)
    figure, (course, speed, *rest) = pyplot.subplots(
        rows, figsize=(9, 3.4 + 1.3 * rows), height_ratios=[3.4] + [1] * (rows - 1), layout="constrained"
    )
    for x, y, radius in world.cylinders:  # turned, so that the robot drives to the right
        course.add_patch(pyplot.Circle((y, -x), radius, color="0.6"))
    for colour, (method, trace) in zip(COLOURS, traces.items()):
        x, y = trace["pose"][:, :2].T
        course.plot(y, -x, color=colour, label="%s, %.1f s" % (method, trace["time"][-1] - trace["time"][0]))
        speed.plot(trace["time"], trace["twist"][:, 0], color=colour)
        for axes, name in zip(rest, parameters):
            axes.step(trace["decided"], trace["theta"][:, SPACE.names.index(name)], where="post", color=colour)
    course.set_aspect("equal")
    course.set_axis_off()
    course.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=len(traces), frameon=False)
    for axes, name in zip((speed, *rest), ("speed [m/s]", *parameters)):
        axes.set_title(name, loc="left", fontsize="medium")
        axes.sharex(speed)
        axes.tick_params(labelbottom=axes is (speed, *rest)[-1])
    (speed, *rest)[-1].set_xlabel("time [s]")
    figure.savefig(path, dpi=100)


def main() -> None:
    """Drive, read, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="generated:0", help="course to drive (default %(default)s)")
    parser.add_argument("--methods", default="dwa,applr", help="whose trials (default %(default)s)")
    parser.add_argument("--parameters", nargs="+", default=SHOWN, choices=SPACE.names, help="to show")
    parser.add_argument("--simulator", default="kinematic", help="kinematic or pybullet (default %(default)s)")
    parser.add_argument("--out", default="results_trace", help="folder to write (default %(default)s)")
    options = parser.parse_args()

    command = [sys.executable, "-m", "training.evaluate", "--worlds", options.world, "--methods", options.methods]
    command += [
        "--trials",
        "1",
        "--simulator",
        options.simulator,
        "--workers",
        "1",
        "--no-report",
        "--out",
        options.out,
    ]
    subprocess.run(command, check=True)
    world = worlds.load(options.world)
    traces = {method: read_trace(options.out, world.name, method, 0) for method in options.methods.split(",")}
    if None in traces.values():
        sys.exit("%s lacks traces in %s: give another --out" % (options.out, options.world))
    picture(traces, world, options.parameters, "%s/trace.png" % options.out)
    for method, trace in traces.items():
        length = np.hypot(*np.diff(trace["pose"][:, :2], axis=0).T).sum()
        print("%s: %.1f m in %.1f s" % (method, length, trace["time"][-1] - trace["time"][0]))
    print("%s/trace.png" % options.out)


if __name__ == "__main__":
    main()
