"""The BARN Challenge: a checkout of its repository as its runner finds it here, and what a run of it is worth.

The runner looks for the ROS package jackal_helper: worlds, plugins and launch files. `Overlay` makes a folder of that
name whose files are links into the checkout, but for the launch file that starts Gazebo (ours starts the simulator of
this repository) and the one that starts the controller (the person's, if one is given). Used by barn.py.
"""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Dict, List, Optional

import numpy as np

import worlds
from applr_ros1.common.errors import ApplrError
from worlds import barn

HELPER = "jackal_helper"
GAZEBO_LAUNCH, CONTROLLER_LAUNCH = "gazebo_launch.launch", "move_base_DWA.launch"
STATIC_WORLDS = 300  # worlds 0 to 299 are BARN's, 300 to 359 DynaBARN's
WORLDS = 360
OURS = Path(__file__).resolve().parents[3] / "compat" / HELPER / "launch"
LIMIT = 100.0  # [s] a run
SPEED = 2.0  # [m/s] at which the optimal time is driven


class Overlay:
    """The package jackal_helper for one evaluation.

    checkout    the person's folder: run.py and jackal_helper/ lie in it
    folder      where the package of links is made anew; what was there is removed
    controller  launch file that starts the controller in place of the checkout's move_base_DWA.launch, or None
    """

    def __init__(self, checkout: Path, folder: Path, controller: Optional[Path]):
        self.checkout = checkout.resolve()
        self.runner = self.checkout / "run.py"
        self.package = folder / HELPER
        helper = self.checkout / HELPER
        for needed in (self.runner, helper / "package.xml", helper / "worlds"):
            if not needed.exists():
                raise ApplrError(f"{checkout} is no checkout of the BARN Challenge: it has no {needed.name}")
        if controller is not None and not controller.is_file():
            raise ApplrError(f"controller {controller} is not there: give a launch file")
        shutil.rmtree(self.package, ignore_errors=True)
        shutil.copytree(helper, self.package, copy_function=os.symlink)
        launch = self.package / "launch"
        launch.mkdir(exist_ok=True)
        for name, file in ((GAZEBO_LAUNCH, OURS / GAZEBO_LAUNCH), (CONTROLLER_LAUNCH, controller)):
            if file is not None:
                if (launch / name).exists():
                    (launch / name).unlink()
                (launch / name).symlink_to(file.resolve())
        if not (launch / CONTROLLER_LAUNCH).exists():
            raise ApplrError(f"{helper} has no launch/{CONTROLLER_LAUNCH}: give --controller LAUNCH")

    def route(self, number: int) -> float:
        """Length [m] of the Challenge's reference path in a world, from which its optimal time follows."""
        static = number < STATIC_WORLDS
        name = f"BARN/world_{number}.world" if static else f"DynaBARN/world_{number - STATIC_WORLDS}.world"
        path = self.package / "worlds" / name
        if not path.is_file():
            raise ApplrError(f"the checkout has no world {number}: {path.name} is missing")
        course = worlds.load(str(path)).course
        return (barn.challenge_course(course.path) if static else course).route_m


@dataclass(frozen=True)
class Run:
    """One row: what the runner wrote (time_s and metric), and the score computed from it."""

    world: int
    trial: int
    success: int
    collided: int
    timeout: int
    time_s: float
    metric: float  # as run.py computes it
    score: float  # with no less than 2 optimal times counted, as run.py does since 2025
    score_2024: float  # no less than 4, as until then
    optimal_s: float

    @property
    def outcome(self) -> str:
        """In a word."""
        return "succeeded" if self.success else "collided" if self.collided else "timeout"


def score(success: bool, seconds: float, optimal: float, least: float) -> float:
    """The Challenge's score of a run: success x OT / clip(AT, `least` OT, 8 OT), 0 to 1 / `least`; times in seconds."""
    return float(success) * optimal / float(np.clip(seconds, least * optimal, 8.0 * optimal))


def run_of(line: str, trial: int, route: float) -> Run:
    """From the line that run.py appends to its file: world, success, collided, timeout, seconds, metric."""
    words = line.split()
    try:
        world, success, collided, timeout = (int(word) for word in words[:4])
        seconds, metric = (float(word) for word in words[4:6])
    except ValueError:
        raise ApplrError(f"the runner wrote {line[:80]!r}: no line of six numbers") from None
    optimal = route / SPEED
    scores = [round(score(bool(success), seconds, optimal, least), 4) for least in (2.0, 4.0)]
    return Run(world, trial, success, collided, timeout, seconds, metric, scores[0], scores[1], round(optimal, 4))


def summary(runs: List[Run]) -> Dict[str, object]:
    """Counts, rates and means over all runs; times over the successful ones."""
    times = [run.time_s for run in runs if run.success]

    def mean(values) -> float:
        return round(float(np.mean(values)), 4)

    return {
        "runs": len(runs),
        "worlds": len({run.world for run in runs}),
        "success_rate": mean([run.success for run in runs]),
        "collision_rate": mean([run.collided for run in runs]),
        "timeout_rate": mean([run.timeout for run in runs]),
        "time_s": mean(times) if times else None,
        "score": mean([run.score for run in runs]),
        "score_2024": mean([run.score_2024 for run in runs]),
        "metric_of_runner": mean([run.metric for run in runs]),
    }
