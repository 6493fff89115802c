#!/usr/bin/env python3
"""What another scanner costs the shipped policy: `python tests/benchmarks/lasers.py [--worlds N] [--workers N]`.

The same Jackal drives the same worlds with scanners of 541, 720 and 1081 beams over 270 degrees, and of 1440 beams all
around; the policy gets each scan resampled to its 720 beams. Printed are success and traversal times beside those with
720 beams, in which it was trained, and what resampling takes.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Dict

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from applr_ros1 import robots  # noqa: E402
from applr_ros1.policy.observation import layout_of  # noqa: E402
from training import evaluate  # noqa: E402
from training.evaluation.store import TRIALS, flag, read_rows  # noqa: E402
from training.evaluation.trials import COLUMNS  # noqa: E402
from worlds import specs  # noqa: E402

SCANNERS = {  # beams, first and last angle [rad]
    "720": (720, -2.35619, 2.35619),
    "541": (541, -2.35619, 2.35619),
    "1081": (1081, -2.35619, 2.35619),
    "1440 all around": (1440, -3.14159, 3.13723),
}


def with_scanner(folder: Path, beams: int, first: float, last: float) -> str:
    """The folder of a Jackal that carries another scanner."""
    made = folder / ("%d" % beams) / robots.JACKAL.name
    shutil.copytree(robots.JACKAL.folder, made)
    text = (made / "robot.yaml").read_text()
    for name, before, after in (
        ("beams", robots.JACKAL.laser.beams, beams),
        ("first_angle", robots.JACKAL.laser.first_angle, first),
        ("last_angle", robots.JACKAL.laser.last_angle, last),
    ):
        assert "%s: %r" % (name, before) in text
        text = text.replace("%s: %r" % (name, before), "%s: %r" % (name, after))
    (made / "robot.yaml").write_text(text)
    return str(made)


def resampling(robot: str) -> float:
    """Median processor time [us] in which a scan of a robot becomes one of the shipped policy's layout."""
    laser = robots.load(robot).laser
    scan = np.random.default_rng(0).uniform(laser.range_min, laser.range_max, laser.beams).astype(np.float32)
    took = []
    for _ in range(300):
        began = time.thread_time()
        layout_of(robots.JACKAL).resample(scan, laser.first_angle, laser.increment)
        took.append(time.thread_time() - began)
    return 1e6 * float(np.median(took))


def drive(robot: str, worlds: str, trials: int, workers: int, out: str) -> Dict[str, np.ndarray]:
    """{world: (success, seconds) of each trial}."""
    asked = ["--robot", robot, "--worlds", worlds, "--methods", "applr", "--trials", str(trials)]
    asked += ["--simulator", "kinematic", "--workers", str(workers), "--no-report", "--out", out]
    if evaluate.main(asked):
        raise SystemExit(1)
    found: Dict[str, list] = {}
    for row in read_rows(os.path.join(out, TRIALS), COLUMNS):
        found.setdefault(row["world"], []).append((flag(row["success"]), float(row["time_s"])))
    return {world: np.array(rows, dtype=float) for world, rows in found.items()}


def main() -> None:
    """Drives and prints a line for each scanner."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--worlds", type=int, default=20, help="number of training worlds (default %(default)s)")
    parser.add_argument("--trials", type=int, default=2, help="in each (default %(default)s)")
    parser.add_argument("--workers", type=int, default=0, help="driven at once (default %(default)s: one by one)")
    options = parser.parse_args()
    worlds = ",".join(np.random.default_rng(0).choice(specs("generated:learn"), options.worlds, replace=False))
    with tempfile.TemporaryDirectory() as folder:
        driven, took = {}, {}
        for name, scanner in SCANNERS.items():
            robot = with_scanner(Path(folder), *scanner)
            took[name] = resampling(robot)
            driven[name] = drive(robot, worlds, options.trials, options.workers, os.path.join(folder, "out " + name))
    base = driven["720"]
    for name, found in driven.items():
        success = np.mean([rows[:, 0].mean() for rows in found.values()])
        both = [world for world in base if base[world][:, 0].all() and found[world][:, 0].all()]
        times = np.array([(found[world][:, 1].mean(), base[world][:, 1].mean()) for world in both])
        apart = times[:, 0] - times[:, 1]
        error = apart.std(ddof=1) / len(apart) ** 0.5
        print(
            "%-16s success %.3f, %.2f s; %+.2f s +- %.2f (standard error) beside 720 beams in %d worlds; "
            "%.0f us to resample a scan"
            % (name, success, times[:, 0].mean(), apart.mean(), error, len(both), took[name])
        )


if __name__ == "__main__":
    main()
