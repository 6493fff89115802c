"""Two methods race in the same world: an animation of both robots, their trails, times and speeds.

README.md shows what `--simulator pybullet --out side_by_side.gif` makes. The drives are read from traces of evaluate.py
as in 05_reading_a_trace.
"""

import argparse
import subprocess
import sys
import tempfile

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from PIL import Image

import worlds
from applr_ros1.robots import load
from applr_ros1.robots.geometry import bounding_box
from training.evaluation.store import read_trace

STEP = 0.1  # s between two frames, simulated and shown
TITLES = {"dwa": "default parameters", "applr": "learned policy"}
COLOURS = ("#2f6fde", "#9c36b5")  # as in the playground


def frames(world, drives: dict):
    """Pictures of {method: trace}, one every STEP seconds until the last robot has arrived."""
    figure = Figure(figsize=(8.0, 5.4), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    course, speeds = figure.subplots(2, height_ratios=[3.2, 1.0])
    for x, y, radius in world.cylinders:  # turned, so that the robots drive to the right
        course.add_patch(Circle((y, -x), radius, facecolor="#c3c6cc", edgecolor="#969ba5"))
    last, finish = max(trace["time"][-1] for trace in drives.values()), world.course.finish_y or world.course.goal[1]
    course.axvline(finish, color="#28aa50", ls=":")
    course.set(aspect="equal", xlim=(world.course.start[1] - 0.6, finish + 1.0))
    course.set_axis_off()
    fastest = max(trace["twist"][:, 0].max() for trace in drives.values())
    speeds.set(xlim=(0.0, last), ylim=(-0.6, fastest + 0.1), xlabel="time [s]", ylabel="speed [m/s]")
    back, front, right, left = bounding_box(load("jackal"))
    body = np.array([[front, left], [front, right], [back, right], [back, left]])
    racers = []
    for (method, trace), colour, place in zip(drives.items(), COLOURS, (0.3, 0.7)):
        robot = course.fill(*body.T, facecolor=colour, edgecolor="black", alpha=0.6, zorder=5)[0]
        trail, curve = course.plot([], [], color=colour, lw=2.5)[0], speeds.plot([], [], color=colour)[0]
        label = course.text(place, 1.0, "", transform=course.transAxes, color=colour, weight="bold", ha="center")
        racers.append((TITLES.get(method, method), trace, robot, trail, curve, label))
    for now in np.arange(0.0, last + STEP, STEP):
        for title, trace, robot, trail, curve, label in racers:
            at = min(int(np.searchsorted(trace["time"], now)), len(trace["time"]) - 1)
            places, yaw = trace["pose"][: at + 1, 1::-1] * (1.0, -1.0), trace["pose"][at, 2] - np.pi / 2
            robot.set_xy(body @ [[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]] + places[-1])
            trail.set_data(*places.T)
            curve.set_data(trace["time"][: at + 1], trace["twist"][: at + 1, 0])
            label.set_text(f"{title} {trace['time'][at]:.1f} s")
        canvas.draw()
        yield Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba()).convert("RGB")


def main() -> None:
    """Drive, read, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="generated:61", help="course to drive (default %(default)s)")
    parser.add_argument("--methods", default="dwa,applr", help="two of evaluate.py's methods (default %(default)s)")
    parser.add_argument("--simulator", default="kinematic", help="kinematic or pybullet (default %(default)s)")
    parser.add_argument("--out", default="side_by_side.gif", help="animation to write (default %(default)s)")
    options = parser.parse_args()

    world = worlds.load(options.world)
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "training.evaluate", "--worlds", options.world, "--methods", options.methods]
        command += ["--trials", "1", "--simulator", options.simulator, "--workers", "1", "--no-report", "--out", folder]
        subprocess.run(command, check=True)
        drives = {method: read_trace(folder, world.name, method, 0) for method in options.methods.split(",")}
    pictures = list(frames(world, drives))
    palette = pictures[-1].quantize(32)
    pictures = [picture.quantize(palette=palette, dither=0) for picture in pictures]
    shown = [int(1000 * STEP)] * (len(pictures) - 1) + [3000]  # ms
    pictures[0].save(options.out, save_all=True, append_images=pictures[1:], duration=shown, loop=0)
    print(f"{options.out}: {len(pictures)} frames")


if __name__ == "__main__":
    main()
