"""Writes the folder of a robot from its URDF or xacro file and the parameter files of its navigation package.

Started as `./applr robot` or `python -m training.new_robot`. The folder gets copies of the parameter files and a
robot.yaml with what the files say plainly: wheels, outline, laser, frames, topics. Everything else is a line to fill in
there, and is listed at the end.

A file whose name ends in .xacro is expanded as roslaunch would, with its arguments as NAME:=VALUE. Give the parameter
files in the order of your launch file, each with the namespace of its <rosparam ns="...">, or what roslaunch
--dump-params writes. The file of a diff_drive_controller beside them names the driven wheels and says the limits of the
base. docs/tutorials/your_robot.md goes on from here.
"""

from __future__ import annotations

import shutil
import sys
from math import ceil
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import write_bytes
from applr_ros1.common.trees import merged
from applr_ros1.robots.check import WIDTH
from applr_ros1.robots.robot import FILE, Monitoring, number_at
from applr_ros1.robots.urdf_import.description import Description, describe
from applr_ros1.robots.urdf_import.parameters import Parameters, read_parameter_files
from applr_ros1.robots.urdf_import.urdf import UrdfFile
from applr_ros1.robots.urdf_import.write import robot_yaml
from training.common.command_line import parsed
from training.common.options import Options, argument, option

COURSE = 42.0  # width [m] of a costmap in which the Jackal's courses lie, whose world_scale is 1
BRAKES = {"max_acceleration": "deceleration", "max_yaw_acceleration": "yaw_deceleration"}  # base's field: monitor's
GRIP = 2.0  # lateral acceleration [m/s^2] at which tyres slide, until somebody measures it


class NewRobotOptions(Options):
    """Files to write a robot from."""

    urdf: Path = argument("URDF or xacro file of the whole robot, with its wheels and its laser.")
    parameters: List[Path] = option(
        ...,
        "Parameter file (YAML) that the launch file of move_base loads, as FILE or FILE:NAMESPACE; several in its "
        "order, and the controller's.",
    )
    laser: str = option("", "Link of the laser. Default: sensor_frame of the costmaps' scan, or the only ray sensor.")
    out: Path = option(Path("my_robot"), "Folder to write.")


def write(options: NewRobotOptions, arguments: Dict[str, str]) -> List[str]:
    """Write the folder, and return lines about it for people.

    Args:
        options: The files.
        arguments: Arguments of the xacro file by name.

    Raises:
        ApplrError: The folder has a robot.yaml, or a file cannot be used.
    """
    file = options.out / FILE
    if file.exists():
        raise ApplrError(f"{file} is there already: remove it, or give another folder with --out")
    parameters = read_parameter_files([str(path) for path in options.parameters])
    scan = next(iter(parameters.scans()), {})
    urdf = UrdfFile(str(options.urdf), arguments, parameters.frames()["base"])
    frame = scan.get("sensor_frame", "").lstrip("/")
    found = describe(urdf, parameters.driven, parameters.footprint(), options.laser, frame)
    _add_parameters(found, parameters)
    scale = round(parameters.padded_width() / WIDTH, 3)
    move_base, notes = _move_base(parameters, found.values, ceil(COURSE * scale))
    hints = {**found.hints, **_limits(parameters.planner)}
    text, missing = robot_yaml(options.urdf.name, found.values, scale, move_base, hints)
    for path, name in _copies(parameters).items():
        (options.out / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, options.out / name)
    write_bytes(file, text.encode())  # last, because a part of the folder would be in the way of the next try
    lines = [f"{file} is made from {options.urdf} and {len(options.parameters)} parameter files"]
    lines += ["remark: " + line for line in found.notes + parameters.notes + notes]
    if missing:
        lines.append(f'the files leave out {len(missing)} values; give each in its line of {file}, without the "# ":')
    lines += ["  " + line for line in missing]
    lines += ["then:", f"  ./applr exec python -m training.check_robot {options.out}"]
    return lines + [f"  ./applr demo robot:=$(realpath {options.out}) method:=dwa", f"  ./applr tune {options.out}"]


def _add_parameters(found: Description, parameters: Parameters) -> None:
    """Add what the parameter files say of the robot: limits, frames, topics, and how hard the monitor brakes."""
    values = found.values
    values["base"].update(parameters.limits)
    values["frames"] = parameters.frames()
    topics = (source["topic"].rstrip("/") for source in parameters.scans())
    names = {"scan": next(topics, ""), "odometry": parameters.planner.get("odom_topic", "")}
    values["topics"].update((name, topic) for name, topic in names.items() if topic)
    base, usual = values["base"], Monitoring()
    values["monitor"] = {
        name: min(getattr(usual, name), base[limit]) for limit, name in BRAKES.items() if limit in base
    }
    values["simulation"] = {"grip_limit": GRIP}


def _move_base(parameters: Parameters, values: Dict[str, Any], size: int) -> Tuple[Dict[str, Any], List[str]]:
    """Return the section move_base of robot.yaml, and notes about driving without a map.

    Args:
        parameters: Of the files.
        values: What is known of the robot, by section and field.
        size: Width of a global costmap [m] that holds the robot's courses.
    """
    copies, notes = _copies(parameters), []
    section: Dict[str, Any] = {
        "files": [{"file": copies[path], **({"namespace": name} if name else {})} for path, name in parameters.files]
    }
    if parameters.added:
        section["parameters"] = parameters.added
    changes = parameters.without_map(values["frames"].get("odom", "odom"), size)
    scan_alone, others = parameters.one_scan(values["topics"].get("scan", ""))
    if changes:
        section["with_map"] = {}
    if changes or others:
        section["without_map"] = {"parameters": merged(changes, scan_alone)}
        kept = f", and none of {', '.join(sorted(others))}" if others else ""
        notes.append(
            "without a map, as on courses, move_base.without_map counts, with a global costmap that stands still and "
            f"the laser alone{kept}: correct it before your robot drives without a map"
        )
    return section, notes


def _copies(parameters: Parameters) -> Dict[str, str]:
    """Return the name in the robot's folder of each parameter file, with its folder if two have the same name."""
    paths = list(dict.fromkeys(path for path, _ in parameters.files))
    names = [Path(path).name for path in paths]
    folders = [Path(path).resolve().parent.name for path in paths]
    return {p: n if names.count(n) == 1 else f"{f}/{n}" for p, n, f in zip(paths, names, folders)}


def _limits(planner: Dict[str, Any]) -> Dict[Tuple[str, str], Tuple[Any, str]]:
    """Return the limits of the local planner as hints for those of the base, which can at least do that."""
    found: Dict[Tuple[str, str], Tuple[Any, str]] = {}
    for field, names in (
        ("max_speed", ("max_vel_x", "max_vel_trans", "max_trans_vel")),
        ("max_yaw_rate", ("max_vel_theta", "max_rot_vel")),
        ("max_acceleration", ("acc_lim_x",)),
        ("max_yaw_acceleration", ("acc_lim_theta",)),
    ):
        known = [(x, f"the planner's {name}") for name in names if (x := number_at(planner, "", (name,))) is not None]
        found.update({("base", field): max(known)} if known else {})
        if known and field in BRAKES:
            usual = getattr(Monitoring(), BRAKES[field]), "the default, less than the planner's limit"
            found["monitor", BRAKES[field]] = min(max(known), usual)
    return found


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Write the folder and return 0; 1 and one line on stderr if that is not possible."""
    given = sys.argv[1:] if arguments is None else arguments
    words = dict(word.split(":=", 1) for word in given if ":=" in word)
    name = "./applr robot"
    return run_main(lambda: print("\n".join(write(parsed(NewRobotOptions, name, __doc__, arguments), words))), name)


if __name__ == "__main__":
    sys.exit(main())
