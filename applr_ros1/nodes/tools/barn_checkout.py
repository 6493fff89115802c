"""A checkout of the BARN Challenge as its own runner finds it here: barn.py runs run.py unmodified on a copy of links.

The runner looks for the ROS package jackal_helper: worlds, plugins and launch files. `Overlay` makes a folder of that
name whose files are links into the checkout, but for the launch file that starts Gazebo (ours starts the simulator of
this repository) and the one that starts the controller (the person's, if one is given).
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Optional

import worlds
from applr_ros1.common.errors import ApplrError
from worlds import barn

HELPER = "jackal_helper"
GAZEBO_LAUNCH, CONTROLLER_LAUNCH = "gazebo_launch.launch", "move_base_DWA.launch"
STATIC_WORLDS = 300  # worlds 0 to 299 are BARN's, 300 to 359 DynaBARN's
WORLDS = 360
OURS = Path(__file__).resolve().parents[3] / "compat" / HELPER / "launch"


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

    def world_file(self, number: int) -> Path:
        """The world's file, where the runner looks for it."""
        if number < STATIC_WORLDS:
            return self.package / "worlds" / "BARN" / f"world_{number}.world"
        return self.package / "worlds" / "DynaBARN" / f"world_{number - STATIC_WORLDS}.world"

    def route(self, number: int) -> float:
        """Length [m] of the Challenge's reference path in a world, from which its optimal time follows."""
        path = self.world_file(number)
        if not path.is_file():
            raise ApplrError(f"the checkout has no world {number}: {path.name} is missing")
        course = worlds.load(str(path)).course
        return (barn.challenge_course(course.path) if number < STATIC_WORLDS else course).route_m
