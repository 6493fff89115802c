"""Options of ./applr tune, and the worlds in which it searches and judges."""

from __future__ import annotations

from typing import Literal, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import radius
from training.attempts.verdict import FEWEST_WORLDS
from training.common.command_line import AnyRobot, Seed, Workers
from training.common.options import Options, argument, option
from worlds.loading import SPECIFICATIONS, building
from worlds.map_courses import HALVES

WORLDS = "generated:learn"  # default worlds of a search
UNSEEN = "fresh:40000-40029"  # worlds of every verdict


class TuneOptions(Options):
    """Options of a search."""

    # fmt: off
    robot: AnyRobot = argument("Folder with robot.yaml, or the name of an included robot.")
    anyway: bool = option(False,
        "Continue even if the robot does not drive on open floor with its default parameters.")
    worlds: str = option(WORLDS,
        f"Courses to search in: {SPECIFICATIONS}; several are separated by commas. The verdicts "
        f"use {UNSEEN}, but with MAP.yaml the search uses one half of the building and the "
        "verdicts the other half.")
    minutes: float = option(15.0,
        "Duration of the search [min]. The two verdicts, of 30 courses each, or those of half a "
        "building, take 7 to 10 more on two cores.",
        gt=0, le=10_000)
    for_: Literal["fast", "careful", "smooth"] = option("fast",
        "Objective besides arriving without a contact: fast, a short time; careful, distance from "
        "obstacles; smooth, little jerk and turning. The last two count a longer time as a loss, "
        "too.")
    workers: Workers
    out: str = option("",
        "Folder for all trials and the report, and for the result if the robot is included. "
        "Default: tune/ROBOT.")
    seed: Seed
    # fmt: on


def split(worlds: str) -> Tuple[str, str]:
    """Return the worlds of the search and of the verdicts: of a whole map, one half each."""
    searched = []
    judged = []
    for listed_world in worlds.split(","):
        world_name = listed_world.strip()
        if world_name.endswith(".yaml"):
            searched.append(f"{world_name}:choose")
            judged.append(f"{world_name}:report")
        else:
            searched.append(world_name)
    return ",".join(searched), ",".join(judged) or UNSEEN


def check_maps(worlds: str, robot: Robot) -> None:
    """Raise ApplrError if a half of a map has too few courses for the test of a verdict."""
    for listed_world in worlds.split(","):
        map_path = listed_world.strip()
        if not map_path.endswith(".yaml"):
            continue
        # The search takes one half of the building, the verdicts the other.
        halves = building(map_path, radius(robot)).halves
        searched = len(halves[HALVES[0]])
        judged = len(halves[HALVES[1]])
        if min(searched, judged) < FEWEST_WORLDS:
            raise ApplrError(
                f"{map_path} has {searched} courses in the half of the floor for the search and "
                f"{judged} in the half for the verdict, for a robot with a radius of "
                f"{radius(robot):.2f} m; each needs {FEWEST_WORLDS}, because no comparison of "
                f"fewer courses is significant: give a map with more floor, or {WORLDS}"
            )
