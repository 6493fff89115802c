"""Two methods drive the same world; an animation shows their drives side by side with a clock.

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
from PIL import Image

import worlds
from applr_ros1.robots import load
from applr_ros1.robots.geometry import bounding_box
from training.evaluation.store import read_trace
from worlds.draw import draw

STEP = 0.1  # s between two frames, simulated and shown
TITLES = {"dwa": "default parameters", "applr": "learned policy"}


def frames(world, drives: dict):
    """Pictures of {method: trace}, one every STEP seconds until the last robot has arrived."""
    figure = Figure(figsize=(7.2, 5.8), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    back, front, right, left = bounding_box(load("jackal"))
    body = np.array([[front, left], [front, right], [back, right], [back, left]])
    panes = []
    for axes, colour in zip(figure.subplots(1, len(drives)), ("#cc3311", "#228833")):
        draw(axes, world, path=False)
        axes.set(ylim=(world.course.start[1] - 0.6, (world.course.finish_y or world.course.goal[1]) + 0.6))
        axes.set_axis_off()
        path, robot = axes.plot([], [], color=colour, lw=2.5)[0], axes.fill(*body.T, color=colour, zorder=5)[0]
        panes.append((axes.set_title(""), path, robot))
    for now in np.arange(0.0, max(trace["time"][-1] for trace in drives.values()) + STEP, STEP):
        for (title, path, robot), (method, trace) in zip(panes, drives.items()):
            at = min(int(np.searchsorted(trace["time"], now)), len(trace["time"]) - 1)
            (x, y, yaw), speed = trace["pose"][at], trace["twist"][at, 0]
            robot.set_xy(body @ [[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]] + [x, y])
            path.set_data(*trace["pose"][: at + 1, :2].T)
            state = "finished" if now >= trace["time"][-1] else f"{speed:.1f} m/s"
            title.set_text(f"{TITLES.get(method, method)}\n{trace['time'][at]:.1f} s, {state}")
        canvas.draw()
        yield Image.frombuffer("RGBA", canvas.get_width_height(), canvas.buffer_rgba()).convert("RGB")


def main() -> None:
    """Drive, read, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--world", default="generated:54", help="course to drive (default %(default)s)")
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
