"""A checkout of the BARN Challenge as its own runner finds it here: barn.py runs run.py unmodified on a copy of links.

The runner looks for the ROS package jackal_helper: worlds, plugins and launch files. `Overlay` makes a folder of that
name whose entries are links into the checkout, but for the launch file that starts Gazebo (ours starts the simulator of
this repository), the one that starts the controller (the person's, if one is given) and the table of key frames of
DynaBARN's moving obstacles.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import List, Optional

import worlds
from applr_ros1.common.errors import ApplrError
from worlds import dynabarn_table, field, movers_table

HELPER = "jackal_helper"
GAZEBO_LAUNCH, CONTROLLER_LAUNCH = "gazebo_launch.launch", "move_base_DWA.launch"
STATIC_WORLDS = 300  # worlds 0 to 299 are BARN's, 300 to 359 DynaBARN's
WORLDS = 360
OURS = Path(__file__).resolve().parents[2] / "compat" / HELPER / "launch"


class CheckoutError(ApplrError):
    """The folder is no checkout of the BARN Challenge, or lacks what a run needs. One line."""


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
                raise CheckoutError("%s is no checkout of the BARN Challenge: it has no %s" % (checkout, needed.name))
        if controller is not None and not controller.is_file():
            raise CheckoutError("controller %s is not there: give a launch file" % controller)
        if self.package.exists():
            shutil.rmtree(self.package)
        _link_all(helper, self.package, but=("launch", "worlds"))
        _link_all(helper / "launch", self.package / "launch", but=(GAZEBO_LAUNCH,))
        _link(OURS / GAZEBO_LAUNCH, self.package / "launch" / GAZEBO_LAUNCH)
        if controller is not None:
            _link(controller, self.package / "launch" / CONTROLLER_LAUNCH)
        if not (self.package / "launch" / CONTROLLER_LAUNCH).exists():
            raise CheckoutError("%s has no launch/%s: give --controller LAUNCH" % (helper, CONTROLLER_LAUNCH))
        _link_all(helper / "worlds", self.package / "worlds", but=("DynaBARN",))
        if (helper / "worlds" / "DynaBARN").is_dir():
            _link_all(helper / "worlds" / "DynaBARN", self.package / "worlds" / "DynaBARN", but=())

    def world_file(self, number: int) -> Path:
        """The world's file, where the runner looks for it."""
        if number < STATIC_WORLDS:
            return self.package / "worlds" / "BARN" / ("world_%d.world" % number)
        return self.package / "worlds" / "DynaBARN" / ("world_%d.world" % (number - STATIC_WORLDS))

    def make_table(self) -> List[str]:
        """Makes DynaBARN's table of key frames where there is none; one line for each plugin not understood."""
        folder = self.package / "worlds" / "DynaBARN"
        if (folder / movers_table.NAME).exists():
            return []
        animations, problems = dynabarn_table.collect(str(folder), str(self.package / "plugins"))
        if animations:
            movers_table.write(str(folder / movers_table.NAME), animations)
        return problems

    def route(self, number: int) -> float:
        """Length [m] of the Challenge's reference path in a world, from which its optimal time follows."""
        path = self.world_file(number)
        if not path.is_file():
            raise CheckoutError("the checkout has no world %d: %s is missing" % (number, path.name))
        course = worlds.load(str(path)).course
        return (field.challenge_course(course.path) if number < STATIC_WORLDS else course).route_m


def _link(target: Path, link: Path) -> None:
    link.parent.mkdir(parents=True, exist_ok=True)
    if os.path.lexists(link):
        link.unlink()
    link.symlink_to(target.resolve())


def _link_all(source: Path, folder: Path, but) -> None:
    """Links to all entries of a folder but those named."""
    folder.mkdir(parents=True, exist_ok=True)
    for entry in sorted(source.iterdir()) if source.is_dir() else []:
        if entry.name not in but:
            _link(entry, folder / entry.name)
