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
from typing import Dict, List, Optional, Sequence

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.files import write_bytes
from applr_ros1.robots.check import WIDTH
from applr_ros1.robots.robot import FILE
from applr_ros1.robots.urdf_import.description import describe
from applr_ros1.robots.urdf_import.parameters import read_parameter_files
from applr_ros1.robots.urdf_import.urdf import UrdfFile
from applr_ros1.robots.urdf_import.write import add_parameters, copies_of, limits, move_base_section, robot_yaml
from training.common.command_line import parsed
from training.common.options import Options, argument, option

COURSE = 42.0  # width [m] of a costmap in which the Jackal's courses lie, whose world_scale is 1


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
    add_parameters(found, parameters)
    scale = round(parameters.padded_width() / WIDTH, 3)
    move_base, notes = move_base_section(parameters, found.values, ceil(COURSE * scale))
    hints = {**found.hints, **limits(parameters.planner)}
    text, missing = robot_yaml(options.urdf.name, found.values, scale, move_base, hints)
    for path, name in copies_of(parameters).items():
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


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Write the folder and return 0; 1 and one line on stderr if that is not possible."""
    given = sys.argv[1:] if arguments is None else arguments
    words = dict(word.split(":=", 1) for word in given if ":=" in word)
    name = "./applr robot"
    return run_main(lambda: print("\n".join(write(parsed(NewRobotOptions, name, __doc__, arguments), words))), name)


if __name__ == "__main__":
    sys.exit(main())
