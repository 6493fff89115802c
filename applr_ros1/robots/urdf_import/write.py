"""Writer of a new robot.yaml.

It has the values of other files, and a line to fill in for each unknown value.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple

import yaml

from applr_ros1.planner.parameters.trees import merged
from applr_ros1.robots.robot import Monitoring, RobotFile, number_at
from applr_ros1.robots.urdf_import.description import Description, Hints
from applr_ros1.robots.urdf_import.parameters import Parameters

# Limits in the section base, and the corresponding decelerations in the section monitor
BRAKES = {"max_acceleration": "deceleration", "max_yaw_acceleration": "yaw_deceleration"}
COMMENT_COLUMN = 34  # column at which comments of values to fill in begin
GRIP = 2.0  # default friction limit, the lateral acceleration at which tyres slide [m/s^2]
# Decelerations that most bases reach: the monitor's defaults, within the default friction limit
USUAL_BRAKING = {
    "deceleration": min(Monitoring().deceleration, GRIP),
    "yaw_deceleration": Monitoring().yaw_deceleration,
}

# Sections in the order of the file
_SECTIONS = (
    "base",
    "body",
    "laser",
    "topics",
    "frames",
    "monitor",
    "simulation",
)
# Fields to fill in although they have a default
_ALSO_ASKED = {
    "base": ("wheel_mass", "casters"),
    "body": ("bottom",),
    "laser": ("no_return",),
    "monitor": ("deceleration", "yaw_deceleration"),
}
_LIMITS = ("max_speed", "max_yaw_rate", "max_acceleration", "max_yaw_acceleration")
# Sources of the values to fill in, by section or field
_WHERE = {
    **dict.fromkeys(_LIMITS, "from the base's manual or its driver's parameters"),
    **dict.fromkeys(("pose", "height"), "from rosrun tf tf_echo BASE_FRAME LASER_FRAME"),
    "wheel_mass": "from the URDF, a scale, or the maker's data",
    "casters": "relative to the centre of the driven wheels",
    "mass": (
        "from a scale, the maker's data, or the sum of the masses in the URDF if these are real"
    ),
    "body": "measured, or from the maker's drawing",
    "laser": "from rostopic echo -n 1 --noarr on the topic of the scans",
    "rate": "from rostopic hz on the topic of the scans",
    "no_return": "by its driver in docs/howto/lasers.md; no line if this is +inf or NaN",
    "monitor": "measured by measure_braking.py",
    "base": "measured on the robot",
}


def robot_yaml(
    source: str,
    values: Mapping[str, Mapping[str, Any]],
    world_scale: float,
    move_base: Mapping[str, Any],
    hints: Hints,
) -> Tuple[str, List[str]]:
    """Return the text of robot.yaml, and a line for each value to fill in.

    Args:
        source: Name of the source file, for the first line.
        values: Known values by section and field.
        world_scale: Value of the key world_scale.
        move_base: Content of the section move_base.
        hints: Proposals (value, origin) for unknown values, by (section, field).
    """
    units = "Lengths in m, masses in kg, angles in rad, times in s"
    lines = [f"# Made from {source}. {units}; positions in {values['frames']['base']}, x ahead."]
    missing_fields = []
    for section in _SECTIONS:
        known_values = values.get(section, {})
        asked_fields = _asked(section, known_values)
        if values["base"].get("drive") == "skid_steer":
            asked_fields.pop("casters", None)
        if known_values or asked_fields:
            lines.append(f"{section}:")
        for field_name, field_value in known_values.items():
            lines.append(f"  {field_name}: {flow(field_value)}")
        # Unknown fields are comments, which the user completes.
        for field_name, field in asked_fields.items():
            unit = field.json_schema_extra["unit"]
            meaning = field.description
            if unit:
                meaning = f"[{unit}] {meaning}"
            line = f"  # {field_name}: "
            note = f"{section}.{field_name} {meaning}"
            if (section, field_name) in hints:
                field_value, origin = hints[section, field_name]
                line += flow(field_value)
                note += f"; {origin}: {flow(field_value)}"
                source_of_value = f"proposal: {origin}"
            else:
                source_of_value = _WHERE.get(field_name, _WHERE.get(section, ""))
            line = f"{line.ljust(COMMENT_COLUMN)}  # {meaning}"
            if source_of_value:
                line += f"; {source_of_value}"
            lines.append(line)
            missing_fields.append(note)
    move_base_lines = yaml.dump(
        {"move_base": move_base},
        None,
        _Dumper,
        sort_keys=False,
        default_flow_style=None,
        width=110,
    )
    lines += [f"world_scale: {flow(world_scale)}", move_base_lines]
    return "\n".join(lines), missing_fields


def _asked(section: str, known: Mapping[str, Any]) -> Dict[str, Any]:
    """Return the fields of a section of robot.yaml that the user must fill in: {name: field}."""
    model: Any = RobotFile.model_fields[section].annotation
    also_asked = _ALSO_ASKED.get(section, ())
    asked_fields = {}
    for field_name, field in model.model_fields.items():
        if field_name not in known and (field.is_required() or field_name in also_asked):
            asked_fields[field_name] = field
    return asked_fields


def flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    yaml_text = yaml.dump(value, None, _Dumper, default_flow_style=True, width=1000)
    # YAML ends a document that is a scalar with "...".
    return yaml_text.partition("\n...")[0].strip()


class _Dumper(yaml.SafeDumper):
    """YAML without anchors, with five significant digits, and with tiny numbers rounded to 0."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _rounded(dumper: Any, number: float) -> Any:
    """Represent a number: poses of a URDF have rounding errors such as 6.1e-17."""
    if abs(number) <= 1e-8:
        number = 0.0
    return dumper.represent_float(float(f"{number:.5g}"))


_Dumper.add_representer(float, _rounded)


def add_parameters(description: Description, parameters: Parameters) -> None:
    """Add limits, frames, topics and decelerations from the parameter files."""
    values = description.values
    values["base"].update(parameters.limits)
    values["frames"] = parameters.frames()
    # The first scan of the costmaps is taken for the robot's main laser.
    scans = parameters.scans()
    if scans and scans[0]["topic"].rstrip("/"):
        values["topics"]["scan"] = scans[0]["topic"].rstrip("/")
    odometry_topic = parameters.planner.get("odom_topic")
    if odometry_topic:
        values["topics"]["odometry"] = odometry_topic
    # The monitor counts on no more than usual, even if the base's controller allows more.
    base_values = values["base"]
    values["monitor"] = {}
    for limit_field, monitor_field in BRAKES.items():
        if limit_field in base_values:
            usual_value = USUAL_BRAKING[monitor_field]
            values["monitor"][monitor_field] = min(usual_value, base_values[limit_field])
    values["simulation"] = {"grip_limit": GRIP}


def move_base_section(
    parameters: Parameters, values: Dict[str, Any], size: int
) -> Tuple[Dict[str, Any], List[str]]:
    """Return the section move_base of robot.yaml, and notes about driving without a map.

    Args:
        parameters: Content of the parameter files.
        values: Known values of the robot, by section and field.
        size: Width of a global costmap [m] that covers the robot's courses.
    """
    copy_paths = copies_of(parameters)
    notes = []
    file_entries = []
    for file_path, namespace in parameters.files:
        file_entry = {"file": copy_paths[file_path]}
        if namespace:
            file_entry["namespace"] = namespace
        file_entries.append(file_entry)
    section: Dict[str, Any] = {"files": file_entries}
    if parameters.added:
        section["parameters"] = parameters.added
    # Courses of the simulators have no map.
    changes = parameters.without_map(values["frames"].get("odom", "odom"), size)
    scan_alone, other_topics = parameters.one_scan(values["topics"].get("scan", ""))
    if changes:
        section["with_map"] = {}
    if changes or other_topics:
        section["without_map"] = {"parameters": merged(changes, scan_alone)}
        scan = "the laser scan"
        if other_topics:
            scan += f", without {', '.join(sorted(other_topics))}"
        notes.append(
            "move_base.without_map, which applies on courses without a map, has a fixed global "
            f"costmap and only {scan}: correct it before your robot drives without a map"
        )
    return section, notes


def copies_of(parameters: Parameters) -> Dict[str, str]:
    """Return the path in the robot's folder of each parameter file.

    Files that share a name are in subfolders.
    """
    file_paths = dict(parameters.files)  # A file may be loaded into several namespaces.
    name_counts = Counter(map(os.path.basename, file_paths))
    copy_paths = {}
    for file_path in file_paths:
        file_name = os.path.basename(file_path)
        copy_paths[file_path] = file_name
        if name_counts[file_name] > 1:
            copy_paths[file_path] = f"{Path(file_path).resolve().parent.name}/{file_name}"
    return copy_paths


def limits(planner: Dict[str, Any]) -> Hints:
    """Return the local planner's limits as proposals for the base's, which are not lower."""
    hints = {}
    for limit_field, parameter_names in (
        ("max_speed", ("max_vel_x", "max_vel_trans", "max_trans_vel")),
        ("max_yaw_rate", ("max_vel_theta", "max_rot_vel")),
        ("max_acceleration", ("acc_lim_x",)),
        ("max_yaw_acceleration", ("acc_lim_theta",)),
    ):
        # Names of TrajectoryPlannerROS and DWAPlannerROS, in several versions
        proposals = []
        for parameter_name in parameter_names:
            limit = number_at(planner, "", (parameter_name,))
            if limit is not None:
                proposals.append((limit, f"the planner's {parameter_name}"))
        if not proposals:
            continue
        largest_proposal = max(proposals)
        hints["base", limit_field] = largest_proposal
        if limit_field in BRAKES:
            monitor_field = BRAKES[limit_field]
            usual_hint = (
                USUAL_BRAKING[monitor_field],
                "the usual value, which is below the planner's limit",
            )
            hints["monitor", monitor_field] = min(largest_proposal, usual_hint)
    return hints
