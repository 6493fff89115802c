"""Writes a robot.yaml from what was found in other files, with a line to fill in for each value that was not.

training/new_robot.py calls `text`; reader.py reads the file.
"""

from __future__ import annotations

from typing import Any, List, Mapping, Tuple

import yaml

# what robot.yaml cannot do without, and the files may leave out: section, field, unit, what it is
_ASKED = (
    ("base", "max_speed", "m/s", "largest speed that the base's controller allows"),
    ("base", "max_yaw_rate", "rad/s", "largest turn rate that it allows"),
    ("base", "max_acceleration", "m/s^2", "largest acceleration that it allows"),
    ("base", "max_yaw_acceleration", "rad/s^2", "largest angular acceleration that it allows"),
    ("base", "wheel_width", "m", "width of a driven wheel"),
    ("base", "casters", "m", "[[x, y], ...], where the base stands on the ground beside its wheels"),
    ("body", "size", "m", "[length, width, height] of the box around all but the wheels"),
    ("body", "mass", "kg", "of all but the driven wheels"),
    ("laser", "frame", "", "frame of its scans in tf"),
    ("laser", "pose", "m, m, rad", "[x, y, yaw] of the scanner in the base frame"),
    ("laser", "height", "m", "of the scanner above the base frame"),
    ("laser", "beams", "", "number of ranges in a scan"),
    ("laser", "first_angle", "rad", "angle_min of the scans"),
    ("laser", "last_angle", "rad", "angle_max of the scans"),
    ("laser", "range_min", "m", "range_min of the scans"),
    ("laser", "range_max", "m", "range_max of the scans"),
    ("laser", "rate", "Hz", "scans per second"),
    ("monitor", "deceleration", "m/s^2", "how hard the base brakes, at most max_acceleration"),
    ("monitor", "yaw_deceleration", "rad/s^2", "how hard it ends a turn, at most max_yaw_acceleration"),
)
_SECTIONS = ("base", "body", "laser", "topics", "frames", "monitor", "simulation")


def text(
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
    frame, drive = values["frames"]["base"], values["base"]["drive"]
    lines = [
        f"# Made from {source}. Lengths in metres, masses in kg, angles in rad, times in s; places in {frame}, x ahead."
    ]
    missing = []
    for section in _SECTIONS:
        found = values.get(section, {})
        asked = [entry[1:] for entry in _ASKED if entry[0] == section and entry[1] not in found]
        asked = [entry for entry in asked if entry[0] != "casters" or drive == "two_wheel"]
        lines += [f"{section}:"] * bool(found or asked)
        lines += [f"  {name}: {_flow(value)}" for name, value in found.items()]
        for name, unit, about in asked:
            value, origin = hints.get((section, name), (None, ""))
            proposed = "" if value is None else _flow(value)
            about = f"[{unit}] {about}" if unit else about
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
