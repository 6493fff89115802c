"""Writes a new robot.yaml: what other files say, and a line to fill in for each value that they leave out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Dict, List, Mapping, Tuple, Type

import yaml

from applr_ros1.common.trees import merged
from applr_ros1.robots.robot import Base, Body, Frames, Laser, Monitoring, Section, Simulation, Topics, number_at
from applr_ros1.robots.urdf_import.description import Description
from applr_ros1.robots.urdf_import.parameters import Parameters

BRAKES = {"max_acceleration": "deceleration", "max_yaw_acceleration": "yaw_deceleration"}  # base's field: monitor's
GRIP = 2.0  # lateral acceleration [m/s^2] at which tyres slide, until somebody measures it

_MODELS: Dict[str, Type[Section]] = {
    "base": Base,
    "body": Body,
    "laser": Laser,
    "topics": Topics,
    "frames": Frames,
    "monitor": Monitoring,
    "simulation": Simulation,
}
_ALSO_ASKED = {  # although they have a default
    "base": ("wheel_mass", "casters"),
    "body": ("bottom",),
    "monitor": ("deceleration", "yaw_deceleration"),
}
_WHERE = {  # to look for what is asked for, by section or field
    "wheel_mass": "in the URDF, on a scale, or in the maker's data",
    "casters": "measured from the middle between the driven wheels",
    "mass": "the sum of those in the URDF if they are true, on a scale, or in the maker's data",
    "body": "measured, or from the maker's drawing",
    "max_speed": "in the base's manual or its driver's parameters",
    "max_yaw_rate": "in the base's manual or its driver's parameters",
    "max_acceleration": "in the base's manual or its driver's parameters",
    "max_yaw_acceleration": "in the base's manual or its driver's parameters",
    "laser": "rostopic echo -n 1 --noarr on the topic of the scans",
    "pose": "rosrun tf tf_echo BASE_FRAME LASER_FRAME",
    "height": "rosrun tf tf_echo BASE_FRAME LASER_FRAME",
    "rate": "rostopic hz on the topic of the scans",
    "monitor": "measure_braking.py measures it",
    "base": "measured on the robot",
}


def robot_yaml(
    source: str,
    values: Mapping[str, Mapping[str, Any]],
    world_scale: float,
    move_base: Mapping[str, Any],
    hints: Mapping[Tuple[str, str], Tuple[Any, str]],
) -> Tuple[str, List[str]]:
    """Return the text of robot.yaml, and a line for each value that it asks for.

    Args:
        source: Name of the file that it was made from, for its first line.
        values: What is known, by section and field.
        world_scale: Value of that key.
        move_base: The section of that name.
        hints: (value, origin) by (section, field), proposals for what is not known.
    """
    frame = values["frames"]["base"]
    lines = [
        f"# Made from {source}. Lengths in metres, masses in kg, angles in rad, times in s; places in {frame}, x ahead."
    ]
    missing = []
    for section, model in _MODELS.items():
        known, also = values.get(section, {}), _ALSO_ASKED.get(section, ())
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
            where = f"here {origin}" if origin else _WHERE.get(name, _WHERE.get(section, ""))
            lines.append(f"  # {name}: {proposed}".ljust(34) + f"  # {about}" + (f"; {where}" if where else ""))
            missing.append(f"{section}.{name} {about}" + (f"; {origin}: {proposed}" if origin else ""))
    lines.append(f"world_scale: {flow(world_scale)}")
    lines.append(
        yaml.dump({"move_base": move_base}, None, _Dumper, sort_keys=False, default_flow_style=None, width=110)
    )
    return "\n".join(lines), missing


def flow(value: Any) -> str:
    """Return a value as it stands behind its name in YAML."""
    return yaml.dump(value, None, _Dumper, default_flow_style=True, width=1000).split("\n...")[0].strip()


class _Dumper(yaml.SafeDumper):
    """YAML without anchors, whose real numbers are cut to five digits, and those next to zero to 0."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


_Dumper.add_representer(float, lambda dump, x: dump.represent_float(float(f"{x:.5g}") if abs(x) > 1e-8 else 0.0))


def add_parameters(found: Description, parameters: Parameters) -> None:
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


def move_base_section(parameters: Parameters, values: Dict[str, Any], size: int) -> Tuple[Dict[str, Any], List[str]]:
    """Return the section move_base of robot.yaml, and notes about driving without a map.

    Args:
        parameters: Of the files.
        values: What is known of the robot, by section and field.
        size: Width of a global costmap [m] that holds the robot's courses.
    """
    copies, notes = copies_of(parameters), []
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


def copies_of(parameters: Parameters) -> Dict[str, str]:
    """Return the name in the robot's folder of each parameter file, with its folder if two have the same name."""
    paths = list(dict.fromkeys(path for path, _ in parameters.files))
    names = [Path(path).name for path in paths]
    folders = [Path(path).resolve().parent.name for path in paths]
    return {p: n if names.count(n) == 1 else f"{f}/{n}" for p, n, f in zip(paths, names, folders)}


def limits(planner: Dict[str, Any]) -> Dict[Tuple[str, str], Tuple[Any, str]]:
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
