"""Writes the folder of a robot from its URDF or xacro file and the parameter files of its navigation package.

Started as `./applr robot` or `python -m training.new_robot`. The folder gets copies of the parameter files and a
robot.yaml with what the files say: wheels, body, mass, laser, frames, topics, and below which names move_base reads
each parameter file. What they do not say is a line to fill in there, and is listed at the end; nothing is guessed.

Arguments of a xacro file, and what the launch file puts in place of $(arg NAME), are given as NAME:=VALUE. Give the
parameter files in the order of your launch file. The file of a diff_drive_controller beside them says the limits of the
base. docs/tutorials/your_robot.md goes on from here.
"""

from __future__ import annotations

import os
import shutil
import sys
from math import ceil
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np
import yaml

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import write_bytes
from applr_ros1.common.trees import branch, merged
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.check import check, without
from applr_ros1.robots.check import WIDTH, in_one_line
from applr_ros1.robots.owner.links import read_urdf
from applr_ros1.robots.owner.parameters import Parameters, one_scan, read_parameter_files, used, without_map
from applr_ros1.robots.owner.write import robot_yaml
from applr_ros1.robots.robot import FILE, Monitoring, number_at
from training.common.command_line import parsed
from training.common.options import Options, argument, option

COURSE = 42.0  # width [m] of a costmap in which the Jackal's courses lie, whose world_scale is 1
GRIP = 2.0  # lateral acceleration [m/s^2] at which tyres slide where nobody measured it


class NewRobotOptions(Options):
    """Files to write a robot from."""

    urdf: Path = argument("URDF or xacro file of the whole robot, with its wheels and its laser.")
    parameters: List[Path] = option(
        ..., "Parameter files (YAML) that the launch file of move_base loads, in its order, and the controller's."
    )
    out: Path = option(Path("my_robot"), "Folder to write.")


def write(options: NewRobotOptions, arguments: Dict[str, str]) -> List[str]:
    """Writes the folder; lines about it, for people.

    Args:
        options: The files.
        arguments: Of the xacro file, by name.

    Raises:
        ApplrError: The folder has a robot.yaml, or the files describe no robot that this package has a model of.
    """
    file = options.out / FILE
    if file.exists():
        raise ApplrError(f"{file} is there already: remove it, or give another folder with --out")
    parameters = read_parameter_files([str(path) for path in options.parameters], arguments)
    scan = next(iter(parameters.scans()), {})
    found = read_urdf(
        str(options.urdf),
        arguments,
        parameters.base_frame,
        str(scan.get("sensor_frame", "")).lstrip("/"),
        parameters.driven,
    )
    values = found.values
    values["base"].update(parameters.limits)
    local, world = parameters.frame("local_costmap"), parameters.frame("global_costmap")
    if local not in ("", world):
        values["frames"].update({"odom": local, **({"map": world} if world else {})})
    elif world not in ("", "map", "odom"):  # the map's where there is one
        tree = branch(parameters.tree, "global_costmap")
        values["frames"]["map" if tree.get("static_map") or "StaticLayer" in str(tree) else "odom"] = world
    topics = [str(source["topic"]).rstrip("/") for source in parameters.scans()]
    named = [topic for topic in topics if topic.startswith(values["topics"].get("scan", ""))]
    names = {"scan": next(iter(named + topics), ""), "odometry": parameters.planner().get("odom_topic")}
    values["topics"].update((name, topic) for name, topic in names.items() if topic)
    further = [topic for topic in dict.fromkeys(topics) if topic != names["scan"]]
    if further:
        parameters.notes.append(
            f"of the laser scans of the costmaps {names['scan']} is topics.scan, which is simulated; for the collision "
            f"monitor on the robot give topics.more_scans: [{', '.join(further)}]"
        )
    values["monitor"] = _braking(values["base"])
    values["simulation"] = {"grip_limit": GRIP}
    odom = values["frames"].get("odom", "odom")
    base_frame = values["frames"].get("base", "base_link")
    for costmap in ("global_costmap", "local_costmap"):
        if base_frame != branch(parameters.tree, costmap).get("robot_base_frame", "base_link"):  # as move_base has it
            parameters.added.setdefault(costmap, {})["robot_base_frame"] = base_frame
    parameters.tree = merged(parameters.tree, parameters.added)
    scale, problems = _scale(parameters, odom, values)
    copies = _copies(parameters)
    files = [{"file": copies[path], **({"namespace": name} if name else {})} for path, name in parameters.files]
    move_base: Dict[str, Any] = {"files": files}
    if parameters.added:
        move_base["parameters"] = parameters.added
    changes = without_map(parameters, odom, ceil(COURSE * scale))
    if changes:
        move_base["with_map"] = {}
    if "width" in changes.get("global_costmap", {}) and parameters.tree["global_costmap"].get("rolling_window"):
        problems.append(
            f"without a map, as on courses, the global costmap does not move along with the robot: it is "
            f"{changes['global_costmap']['width']} m wide, for whole courses; before yours drives so, set "
            "rolling_window, width, height, origin_x and origin_y in move_base.without_map as you want them"
        )
    costmaps = used(merged(parameters.tree, changes))
    scan_alone, others = one_scan(costmaps, names["scan"]) if names["scan"] else ({}, set())
    if changes or others:
        move_base["without_map"] = {"parameters": merged(changes, scan_alone)}
    if others:
        problems.append(
            f"without a map, as on courses, the costmaps take nothing from {', '.join(sorted(others))}: the simulated "
            "robot has one laser; before yours drives so, take observation_sources from move_base.without_map"
        )
    text, missing = robot_yaml(options.urdf.name, values, scale, move_base, _hints(parameters))
    for path, name in copies.items():
        (options.out / name).parent.mkdir(parents=True, exist_ok=True)
        if path in parameters.changed:
            (options.out / name).write_text(yaml.safe_dump(parameters.changed[path]))
        else:
            shutil.copyfile(path, options.out / name)
    write_bytes(file, text.encode())  # the last one: a part of it would be in the way of the next try
    lines = [f"{file} is made from {options.urdf} and {len(options.parameters)} parameter files"]
    lines += ["remark: " + line for line in found.notes + parameters.notes + problems]
    if missing:
        lines.append(f'the files leave out {len(missing)} values; give each in its line of {file}, without the "# ":')
    lines += ["  " + line for line in missing]
    lines += ["then:", f"  ./applr exec python -m training.check_robot {options.out}"]
    return lines + [f"  ./applr demo robot:={options.out} method:=dwa", f"  ./applr tune {options.out}"]


def _braking(base: Dict[str, Any]) -> Dict[str, float]:
    """The monitor's section: where the base cannot brake as hard as the default says, as hard as it can."""
    usual, found = Monitoring(), {}
    for name, limit in (("deceleration", "max_acceleration"), ("yaw_deceleration", "max_yaw_acceleration")):
        if limit in base:
            found[name] = min(getattr(usual, name), base[limit])
    return found


def _scale(parameters: Parameters, odom: str, values: Dict[str, Dict[str, Any]]) -> Tuple[float, List[str]]:
    """world_scale, by the padded footprint, and what is wrong with the parameters, for which it is by the outline."""
    base, body = values["base"], values["body"]
    tree = merged(parameters.tree, without_map(parameters, odom, 1))
    wrong = check(tree)
    try:
        planner = MoveBase(without(tree, wrong))
    except ApplrError as error:
        width = max(base.get("track", 0.0) + base.get("wheel_width", 0.0), *body.get("size", (0.0, WIDTH))[1:2])
        return round(width / WIDTH, 3), [f"the planner refuses the parameter files: {error}"]
    scale = round(float(np.ptp(np.asarray(planner.local_costmap.footprint)[:, 1])) / WIDTH, 3)
    return scale, [f"the planner refuses the parameter files: {in_one_line(wrong)}"] if wrong else []


def _copies(parameters: Parameters) -> Dict[str, str]:
    """Return the name in the robot's folder of each parameter file, with its folder's where two have the same."""
    paths = list(dict.fromkeys(path for path, _ in parameters.files))
    names = [Path(path).name for path in paths]
    folders = [Path(os.path.realpath(path)).parent.name for path in paths]
    return {p: n if names.count(n) == 1 else f"{f}/{n}" for p, n, f in zip(paths, names, folders)}


def _hints(parameters: Parameters) -> Dict[Tuple[str, str], Tuple[float, str]]:
    """Return what the planner's limits say of the base: it can at least do that."""
    planner, found = parameters.stated or parameters.planner(), {}
    for places, theirs in (
        ((("base", "max_speed"),), ("max_vel_x", "max_vel_trans", "max_trans_vel")),
        ((("base", "max_yaw_rate"),), ("max_vel_theta", "max_rot_vel")),
        ((("base", "max_acceleration"), ("monitor", "deceleration")), ("acc_lim_x",)),
        ((("base", "max_yaw_acceleration"), ("monitor", "yaw_deceleration")), ("acc_lim_theta",)),
    ):
        have = [(x, f"the planner's {key}") for key in theirs if (x := number_at(planner, "", (key,))) is not None]
        found.update(dict.fromkeys(places, max(have)) if have else {})
    return found


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0 once the folder is written; 1 and one line on stderr otherwise."""
    given = sys.argv[1:] if arguments is None else arguments
    words = dict(word.split(":=", 1) for word in given if ":=" in word)
    name = "./applr robot"
    return run_main(lambda: print("\n".join(write(parsed(NewRobotOptions, name, __doc__, arguments), words))), name)


if __name__ == "__main__":
    sys.exit(main())
