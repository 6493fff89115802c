"""Writes the folder of a robot from its URDF or xacro file and the files of its navigation.

Run it as `./applr robot` or `python -m training.robot`. The folder gets copies of the parameter
files, and a robot.yaml with the values that the files state explicitly: wheels, outline, laser,
frames, topics. For every other value, robot.yaml has a line to fill in, and the command lists these
values at its end.

A file whose name ends in .xacro is expanded as roslaunch would, with its arguments as NAME:=VALUE.
Give the parameter files in the order of your launch file, each with the namespace of its <rosparam
ns="...">, or give the output of roslaunch --dump-params. Add the file of a diff_drive_controller if
there is one: it gives the driven wheels and the limits of the base. docs/tutorials/your_robot.md
continues from here.
"""

from __future__ import annotations

import sys
from math import ceil
from pathlib import Path
from typing import Any, Dict, Iterator, List, Optional, Sequence

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import read_bytes, write_bytes, yaml_value
from applr_ros1.robots.check import WIDTH
from applr_ros1.robots.parameter_files import read_yaml
from applr_ros1.robots.robot import FILE, WORLD_SCALES
from applr_ros1.robots.urdf_import.description import describe
from applr_ros1.robots.urdf_import.parameters import read_parameter_files
from applr_ros1.robots.urdf_import.urdf import UrdfFile
from applr_ros1.robots.urdf_import.write import (
    add_parameters,
    copies_of,
    limits,
    move_base_section,
    robot_yaml,
)
from training.common.command_line import run_command
from training.common.folders import make_folder
from training.common.options import Options, argument, option
from training.common.words import counted

COURSE = 42.0  # width of a costmap that contains every course at world_scale 1 (the Jackal) [m]
# What the file of a diff_drive_controller answers of the missing values
CONTROLLER = (
    "(six of them are in the file of the base's controller: add it to --parameters for the limits "
    "of base and the decelerations of monitor)"
)
OTHER_FOLDER = "move it away, or give another folder with --out"


class NewRobotOptions(Options):
    """Options of ./applr robot: input files and output folder."""

    urdf: Path = argument("URDF or xacro file of the whole robot, with its wheels and its laser.")
    parameters: List[Path] = option(
        ...,
        "Parameter files (YAML) of move_base in the order of its launch file, and of the base's "
        "controller, each as FILE or FILE:NAMESPACE.",
    )
    laser: str = option(
        "",
        "Link of the laser. Default: sensor_frame of the costmaps' scan, or the only ray sensor.",
    )
    out: Path = option(Path("my_robot"), "Folder to write.")


def write(options: NewRobotOptions, arguments: Dict[str, str]) -> List[str]:
    """Write the folder of the robot, and return lines that report about it.

    Args:
        options: Files to read, and the folder to write.
        arguments: Arguments of the xacro file by name.

    Raises:
        ApplrError: The folder has values that would be lost, or a file cannot be used.
    """
    # Worlds are scaled by how much wider the robot is than the Jackal.
    parameters = read_parameter_files(list(map(str, options.parameters)))
    width = parameters.padded_width()
    scale = round(width / WIDTH, 3)
    if not WORLD_SCALES[0] <= scale <= WORLD_SCALES[1]:
        remedy = "give footprint, robot_radius and footprint_padding in metres"
        raise ApplrError(f"the padded footprint of the files is {width:.3g} m wide: {remedy}")

    # What the files say. The first scan source of the costmaps names the laser's frame.
    scan = next(iter(parameters.scans()), {})
    urdf = UrdfFile(str(options.urdf), arguments, parameters.frames()["base"])
    frame = scan.get("sensor_frame", "").lstrip("/")
    described = describe(urdf, parameters.wheels, parameters.outline(), options.laser, frame)
    add_parameters(described, parameters)

    # Content of robot.yaml
    move_base, notes = move_base_section(parameters, described.values, ceil(COURSE * scale))
    hints = {**described.hints, **limits(parameters.planner)}
    text, missing = robot_yaml(options.urdf.name, described.values, scale, move_base, hints)

    # What has been filled in or changed in the folder stays.
    file = options.out / FILE
    lost_values = list(_lost(read_yaml(file), yaml_value(text, file))) if file.exists() else []
    if lost_values:
        problem = f"{file} has {', '.join(lost_values)}, which this command would not write"
        raise ApplrError(f"{problem}: {OTHER_FOLDER}")
    copies = {options.out / name: read_bytes(path) for path, name in copies_of(parameters).items()}
    for copy, content in copies.items():
        if copy.exists() and read_bytes(copy) != content:
            raise ApplrError(f"{copy} differs from the file that was given: {OTHER_FOLDER}")
    for copy, content in copies.items():
        make_folder(copy.parent)
        write_bytes(copy, content)
    write_bytes(file, text.encode())

    files = counted(len(options.parameters), "parameter file")
    lines = [f"wrote {file} from {options.urdf} and {files}"]
    for note in described.notes + parameters.notes + notes:
        lines.append(f"remark: {note}")
    if missing:
        remedy = f'enter each in its line of {file}, and remove the "# "'
        lines.append(f"the files lack {len(missing)} values: {remedy}:")
    if not parameters.limits:
        lines.append(f"  {CONTROLLER}")
    for line in missing:
        lines.append(f"  {line}")
    return [
        *lines,
        "then:",
        f"  ./applr check {options.out}",
        f"  ./applr demo robot:=$(realpath {options.out}) method:=dwa",
        f"  ./applr tune {options.out}",
    ]


def _lost(old: Dict[str, Any], new: Dict[str, Any], path: str = "") -> Iterator[str]:
    """Yield the values of a robot.yaml that new content lacks, such as body.mass.

    A file in which nothing has been filled in has none: the command may be repeated, for example
    with --laser.
    """
    for name, value in old.items():
        new_value = new.get(name)
        if isinstance(value, dict) and isinstance(new_value, dict):
            yield from _lost(value, new_value, f"{path}{name}.")
        elif value is not None and value != new_value:
            yield f"{path}{name}"


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command. Return 0, or 1 after a one-line error if the folder cannot be written."""
    # Words with := are arguments of the xacro file, which are left out of the options.
    words = sys.argv[1:] if arguments is None else arguments
    xacro_arguments = {}
    for word in words:
        argument_name, is_assigned, value = word.partition(":=")
        if is_assigned:
            xacro_arguments[argument_name] = value

    def run(options: NewRobotOptions) -> None:
        print("\n".join(write(options, xacro_arguments)))

    return run_command(NewRobotOptions, run, "./applr robot", __doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
