"""Writer of a new robot.yaml, with the values of other files and a line to fill in for each unknown value."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple

import yaml

from applr_ros1.common.trees import merged
from applr_ros1.robots.robot import Monitoring, RobotFile, number_at
from applr_ros1.robots.urdf_import.description import Description
from applr_ros1.robots.urdf_import.parameters import Parameters

# Limits in the section base, and the corresponding decelerations in the section monitor
BRAKES = {"max_acceleration": "deceleration", "max_yaw_acceleration": "yaw_deceleration"}
GRIP = 2.0  # default friction limit, the lateral acceleration at which tyres slide [m/s^2]

_SECTIONS = (
    "base",
    "body",
    "laser",
    "topics",
    "frames",
    "monitor",
    "simulation",
)  # sections in the order of the file
_ALSO_ASKED = {  # fields to fill in although they have a default
    "base": ("wheel_mass", "casters"),
    "body": ("bottom",),
    "monitor": ("deceleration", "yaw_deceleration"),
}
_LIMITS = ("max_speed", "max_yaw_rate", "max_acceleration", "max_yaw_acceleration")
_WHERE = {  # sources of the values to fill in, by section or field
    **dict.fromkeys(_LIMITS, "from the base's manual or its driver's parameters"),
    **dict.fromkeys(("pose", "height"), "from rosrun tf tf_echo BASE_FRAME LASER_FRAME"),
    "wheel_mass": "from the URDF, a scale, or the maker's data",
    "casters": "relative to the centre of the driven wheels",
    "mass": "from a scale, the maker's data, or the sum of the masses in the URDF if these are real",
    "body": "measured, or from the maker's drawing",
    "laser": "from rostopic echo -n 1 --noarr on the topic of the scans",
    "rate": "from rostopic hz on the topic of the scans",
    "monitor": "measured by measure_braking.py",
    "base": "measured on the robot",
}


def robot_yaml(
    source: str,
    values: Mapping[str, Mapping[str, Any]],
    world_scale: float,
    move_base: Mapping[str, Any],
    hints: Mapping[Tuple[str, str], Tuple[Any, str]],
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
    missing = []
    for section in _SECTIONS:
        known, also = values.get(section, {}), _ALSO_ASKED.get(section, ())
        model: Any = RobotFile.model_fields[section].annotation
        asked: Dict[str, Any] = {
            name: declared
            for name, declared in model.model_fields.items()
            if name not in known and (declared.is_required() or name in also)
        }
        if values["base"].get("drive") == "skid_steer":
            asked.pop("casters", None)
        lines += [f"{section}:"] * bool(known or asked)
        lines += [f"  {name}: {flow(value)}" for name, value in known.items()]
        for name, field in asked.items():
            value, origin = hints.get((section, name), (None, ""))
            proposed, unit = "" if value is None else flow(value), field.json_schema_extra["unit"]
            about = f"[{unit}] {field.description}" if unit else field.description
            where = f"proposal: {origin}" if origin else _WHERE.get(name, _WHERE.get(section, ""))
            lines.append(
                f"  # {name}: {proposed}".ljust(34)
                + f"  # {about}"
                + (f"; {where}" if where else "")
            )
            missing.append(
                f"{section}.{name} {about}" + (f"; {origin}: {proposed}" if origin else "")
            )
    files = yaml.dump(
        {"move_base": move_base}, None, _Dumper, sort_keys=False, default_flow_style=None, width=110
    )
    return "\n".join([*lines, f"world_scale: {flow(world_scale)}", files]), missing


def flow(value: Any) -> str:
    """Return a value as YAML on one line."""
    return (
        yaml.dump(value, None, _Dumper, default_flow_style=True, width=1000)
        .split("\n...")[0]
        .strip()
    )


class _Dumper(yaml.SafeDumper):
    """YAML without anchors, with five significant digits, and with tiny numbers rounded to 0."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_representer(
    float, lambda dump, x: dump.represent_float(float(f"{x:.5g}") if abs(x) > 1e-8 else 0.0)
)


def add_parameters(description: Description, parameters: Parameters) -> None:
    """Add limits, frames, topics and the monitor's decelerations from the parameter files to a description."""
    values = description.values
    values["base"].update(parameters.limits)
    values["frames"] = parameters.frames()
    topics = (source["topic"].rstrip("/") for source in parameters.scans())
    names = {"scan": next(topics, ""), "odometry": parameters.planner.get("odom_topic", "")}
    values["topics"].update((name, topic) for name, topic in names.items() if topic)
    base, usual = values["base"], Monitoring()
    values["monitor"] = {
        name: min(getattr(usual, name), base[limit])
        for limit, name in BRAKES.items()
        if limit in base
    }
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
    copies, notes = copies_of(parameters), []
    section: Dict[str, Any] = {
        "files": [
            {"file": copies[path], **({"namespace": name} if name else {})}
            for path, name in parameters.files
        ]
    }
    if parameters.added:
        section["parameters"] = parameters.added
    changes = parameters.without_map(values["frames"].get("odom", "odom"), size)
    scan_alone, others = parameters.one_scan(values["topics"].get("scan", ""))
    if changes:
        section["with_map"] = {}
    if changes or others:
        section["without_map"] = {"parameters": merged(changes, scan_alone)}
        dropped = f", without {', '.join(sorted(others))}" if others else ""
        notes.append(
            "move_base.without_map, which applies on courses without a map, has a fixed global costmap and only the "
            f"laser scan{dropped}: correct it before your robot drives without a map"
        )
    return section, notes


def copies_of(parameters: Parameters) -> Dict[str, str]:
    """Return the path in the robot's folder of each parameter file, with a subfolder if two files share a name."""
    paths = list(dict.fromkeys(path for path, _ in parameters.files))
    names = [Path(path).name for path in paths]
    folders = [Path(path).resolve().parent.name for path in paths]
    return {p: n if names.count(n) == 1 else f"{f}/{n}" for p, n, f in zip(paths, names, folders)}


def limits(planner: Dict[str, Any]) -> Dict[Tuple[str, str], Tuple[Any, str]]:
    """Return the local planner's limits as proposals for the base's limits, which cannot be lower."""
    hints: Dict[Tuple[str, str], Tuple[Any, str]] = {}
    for field, names in (
        ("max_speed", ("max_vel_x", "max_vel_trans", "max_trans_vel")),
        ("max_yaw_rate", ("max_vel_theta", "max_rot_vel")),
        ("max_acceleration", ("acc_lim_x",)),
        ("max_yaw_acceleration", ("acc_lim_theta",)),
    ):
        known = [
            (x, f"the planner's {name}")
            for name in names
            if (x := number_at(planner, "", (name,))) is not None
        ]
        hints.update({("base", field): max(known)} if known else {})
        if known and field in BRAKES:
            usual = (
                getattr(Monitoring(), BRAKES[field]),
                "the default, which is below the planner's limit",
            )
            hints["monitor", BRAKES[field]] = min(max(known), usual)
    return hints
