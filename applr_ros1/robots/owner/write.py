"""Writes a new robot.yaml from what was found in other files.

training/new_robot.py calls `robot_yaml`; folder.py reads the file.
"""

from __future__ import annotations

from typing import Any, Dict, List, Mapping, Tuple, Type

import yaml

from applr_ros1.robots.robot import Base, Body, Frames, Laser, Monitoring, Section, Simulation, Topics

_MODELS: Dict[str, Type[Section]] = {
    "base": Base,
    "body": Body,
    "laser": Laser,
    "topics": Topics,
    "frames": Frames,
    "monitor": Monitoring,
    "simulation": Simulation,
}


def robot_yaml(
    source: str,
    values: Mapping[str, Mapping[str, Any]],
    world_scale: float,
    move_base: Mapping[str, Any],
    hints: Mapping[Tuple[str, str], Tuple[Any, str]],
) -> Tuple[str, List[str]]:
    """The file, and a line for each value that it asks for.

    Args:
        source: What it was made from, for its first line.
        values: What was found, by section and field.
        world_scale: The value of that key.
        move_base: The section of that name.
        hints: (value, where it is from) by (section, field), for what was not found but other values make likely.
    """
    frame = values["frames"]["base"]
    also: Dict[str, Tuple[str, ...]] = {"monitor": ("deceleration", "yaw_deceleration")}  # though they have a default
    also.update(base=("casters",) if values["base"].get("drive") != "skid_steer" else ())
    lines = [
        f"# Made from {source}. Lengths in metres, masses in kg, angles in rad, times in s; places in {frame}, x ahead."
    ]
    missing = []
    for section, model in _MODELS.items():
        found = values.get(section, {})
        asked: Dict[str, Any] = {
            name: declared
            for name, declared in model.model_fields.items()
            if name not in found and (declared.is_required() or name in also.get(section, ()))
        }
        lines += [f"{section}:"] * bool(found or asked)
        lines += [f"  {name}: {_flow(value)}" for name, value in found.items()]
        for name, field in asked.items():
            value, origin = hints.get((section, name), (None, ""))
            proposed, unit = "" if value is None else _flow(value), field.json_schema_extra["unit"]
            about = f"[{unit}] {field.description}" if unit else field.description
            lines.append(f"  # {name}: {proposed}".ljust(34) + f"  # {about}" + (f"; here {origin}" if origin else ""))
            missing.append(f"{section}.{name} {about}" + (f"; {origin} is {proposed}" if origin else ""))
    lines.append(f"world_scale: {_flow(world_scale)}")
    lines.append(
        yaml.safe_dump({"move_base": _rounded(move_base)}, sort_keys=False, default_flow_style=None, width=110)
    )
    return "\n".join(lines), missing


def _flow(value: Any) -> str:
    """A value as it stands behind its name in YAML."""
    return yaml.safe_dump(_rounded(value), default_flow_style=True, width=1000).split("\n...")[0].strip()


def _rounded(value: Any) -> Any:
    """A value with its real numbers cut to five digits, and those next to zero to 0."""
    if isinstance(value, dict):
        return {name: _rounded(below) for name, below in value.items()}
    if isinstance(value, (list, tuple)):
        return [_rounded(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.5g}") if abs(value) > 1e-8 else 0.0
    return value
