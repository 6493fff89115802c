"""How fast the simulators are: simulated seconds per wall second on one core, alone and with their laser.
tests/benchmarks/run.py reads the functions; `python tests/benchmarks/simulators.py` prints all.
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import sim_bridge
import worlds
from applr_ros1.robots import load
from sim_bridge.lidar import Lidar

WORLD = "generated:0"
CYCLE = 0.05  # simulated seconds between commands, and between scans


def sim_speed(name, seconds=20.0, scans=False, repeats=3):
    """Simulated seconds per wall second of simulator `name`, driven to and fro on the course at 20 Hz, in contact
    now and then; with a scan per cycle if `scans`. The best of `repeats`.
    """
    simulator, world = sim_bridge.make(name), worlds.load(WORLD)
    cycles, best = int(seconds / CYCLE), 0.0
    _drive(simulator, world, 10, scans)
    for _ in range(repeats):
        began = time.perf_counter()
        _drive(simulator, world, cycles, scans)
        best = max(best, cycles * CYCLE / (time.perf_counter() - began))
    simulator.close()
    return best


def _drive(simulator, world, cycles, scans):
    simulator.reset(world, 0)
    for i in range(cycles):
        simulator.command(0.5, 0.6 if i % 80 < 40 else -0.6)
        simulator.advance(CYCLE)
        if scans:
            simulator.scan()


def scan_time(spec=WORLD, scans=2000, repeats=3):
    """Microseconds for one exact scan of 720 beams, moving along the course; the best of `repeats`."""
    world = worlds.load(spec)
    lidar, path = Lidar(load("jackal").laser, world.cylinders, world.boxes), np.asarray(world.course.path)
    points = path[np.linspace(0, len(path) - 1, scans).astype(int)]
    lidar.scan(*points[0], 1.57)
    best = np.inf
    for _ in range(repeats):
        began = time.perf_counter()
        for x, y in points:
            lidar.scan(x, y, 1.57)
        best = min(best, time.perf_counter() - began)
    return best / scans * 1e6


def figures():
    """{name: {value, unit}}."""
    unit = "simulated s / wall s, one core"
    found = {}
    for name in ("pybullet", "kinematic"):
        found["sim_alone_" + name] = {"value": round(sim_speed(name), 1), "unit": unit}
        found["sim_with_laser_" + name] = {"value": round(sim_speed(name, scans=True), 1), "unit": unit}
    found["scan_720_beams"] = {"value": round(scan_time(), 2), "unit": "us"}
    return found


if __name__ == "__main__":
    for key, figure in figures().items():
        print("%-24s %10.1f %s" % (key, figure["value"], figure["unit"]))
