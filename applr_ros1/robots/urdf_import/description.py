"""Description of a robot's wheels, outline and laser from its URDF: `describe`.

Ambiguous values are left out. training/robot writes the description and lists all values to
fill in.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from math import atan2, inf, isfinite
from typing import Any, Dict, Iterable, List, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError, did_you_mean
from applr_ros1.robots.urdf_import.urdf import UrdfFile

_SIDEWAYS = re.compile(
    r"mecanum|omni|planar_move|force_based_move", re.IGNORECASE
)  # names of wheels and plugins of omnidirectional bases
_DRIVE_PLUGIN = re.compile(r"diff_drive|skid_steer_drive")  # files of Gazebo's drive plugins
_RAYS = ("ray", "gpu_ray", "lidar", "gpu_lidar")  # types of laser scanners in Gazebo
SAME_M = 0.01  # tolerance of positions and sizes that should agree [m]
CLEARANCE_M = 0.005  # smallest ground clearance of a body; lower shapes are supports [m]
_TAGS = {  # tags of a ray sensor by field of robot.yaml
    "beams": ".//horizontal/samples",
    "first_angle": ".//horizontal/min_angle",
    "last_angle": ".//horizontal/max_angle",
    "range_min": ".//range/min",
    "range_max": ".//range/max",
    "rate": "update_rate",
    "noise": ".//noise/stddev",
}


@dataclass
class Description:
    """Content of a URDF.

    Attributes:
        values: Unambiguous values, by section and field of robot.yaml.
        hints: Proposals (value, origin) for fields to fill in, by (section, field).
        notes: Messages about values used and left out.
    """

    values: Dict[str, Dict[str, Any]] = field(default_factory=dict)
    hints: Dict[Tuple[str, str], Tuple[Any, str]] = field(default_factory=dict)
    notes: List[str] = field(default_factory=list)


def describe(
    urdf: UrdfFile, driven: Iterable[str], footprint: np.ndarray, laser: str, sensor_frame: str
) -> Description:
    """Return the description of a robot.

    Args:
        urdf: URDF of the robot.
        driven: Joints of the driven wheels according to a controller's file.
        footprint: Outline (n, 2) [m] in the parameter files; empty if there is none.
        laser: Link of the laser given by the user; "" for none.
        sensor_frame: Frame of the laser in the costmap's source; "" for none.

    Raises:
        ApplrError: There is no link `laser`.
    """
    description = Description({"base": {}, "body": {}, "laser": {}, "topics": {}})
    joints = _wheels(urdf, list(driven), description.notes)
    _base(urdf, joints, description)
    _body(urdf, joints, footprint, description)
    _laser(urdf, laser, sensor_frame, description)
    return description


def _wheels(urdf: UrdfFile, driven: List[str], notes: List[str]) -> List[Any]:
    """Return the joints of the driven wheels, left side first, or none if they cannot be identified."""
    plugins = [
        plugin
        for plugin in urdf.xml.iter("plugin")
        if _DRIVE_PLUGIN.search(str(plugin.get("filename")))
    ]
    texts = [
        tag.text or ""
        for plugin in plugins
        for tag in plugin.iter()
        if re.match("(left|right).*joint", tag.tag, re.I)
    ]
    named = driven or [name for text in texts for name in re.split(r"[\s,]+", text.strip()) if name]
    by = (
        "the controller's file"
        if driven
        else "the drive plugin"
        if named
        else "pairs of continuous joints"
    )
    absent = sorted(set(named) - set(urdf.joints))
    turning = [
        joint
        for joint in urdf.joints.values()
        if joint.type == "continuous" and _is_across(urdf, joint)
    ]
    alone = [
        joint
        for joint in turning
        if all(above.type != "continuous" for above in urdf.moving[joint.child][1:])
    ]
    joints = (
        [urdf.joints[name] for name in dict.fromkeys(named) if name in urdf.joints]
        if named
        else alone
    )
    names = ", ".join(joint.name for joint in joints)
    problem = (
        f"{by} names {', '.join(absent)}, which {urdf.path} does not have"
        if absent
        else _oddity(urdf, joints)
    )
    if problem:
        notes.append(f"driven wheels not identified: {problem}; fill them in")
        return []
    notes.append(f"the driven wheels are {names}, according to {by}")
    return sorted(joints, key=lambda joint: -urdf.pose(joint.child)[1, 3])


def _is_across(urdf: UrdfFile, joint: Any) -> bool:
    """Return whether a joint's axis is lateral."""
    return bool(abs(urdf.axis(joint)[1]) > 0.95)


def _oddity(urdf: UrdfFile, joints: List[Any]) -> str:
    """Return why joints are not two wheels on one axle or four wheels on two axles; "" if they are."""
    names = ", ".join(joint.name for joint in joints) or "none"
    parts = [name for joint in joints for name in (joint.name, joint.child)]
    plugins = [
        str(plugin.get("filename")) for plugin in urdf.xml.iter("plugin") if len(joints) != 2
    ]
    sideways = list(filter(_SIDEWAYS.search, parts + plugins))
    if sideways:
        return f"{sideways[0]} belongs to a base that also drives sideways, which is not supported"
    for joint in joints:
        steers = [above for above in urdf.moving[joint.child][1:] if abs(urdf.axis(above)[2]) > 0.7]
        if joint.type != "continuous" or not _is_across(urdf, joint) or steers:
            return f"{joint.name} is steered, or not continuous about a lateral axis"
    places = np.array([urdf.pose(joint.child)[:3, 3] for joint in joints]).reshape(-1, 3)
    left, right = (
        places[side][np.argsort(places[side][:, 0])]
        for side in (places[:, 1] > 0, places[:, 1] < 0)
    )
    mirrored = right * [1.0, -1.0, 1.0]
    paired = (
        len(left) == len(right)
        and len(joints) in (2, 4)
        and np.allclose(left, mirrored, atol=SAME_M)
    )
    one_axle = len(left) == 2 and np.ptp(left[:, 0]) < SAME_M
    return (
        ""
        if paired and not one_axle
        else f"the candidate joints ({names}) do not form one or two pairs"
    )


def _base(urdf: UrdfFile, joints: List[Any], description: Description) -> None:
    """Fill the section base: kind of the drive, and dimensions of the driven wheels."""
    if not joints:
        return
    radii, widths, middles = zip(*(_wheel(urdf, joint) for joint in joints))
    places, base = np.array(middles), description.values["base"]
    half = len(joints) // 2
    base["drive"] = "two_wheel" if half == 1 else "skid_steer"
    base["track"] = float(places[:half, 1].mean() - places[half:, 1].mean())
    base["axle_height"] = float(places[:, 2].mean())
    if half == 2:
        base["wheelbase"] = float(np.ptp(places[:, 0]))
    for name, sizes in (("wheel_radius", radii), ("wheel_width", widths)):
        if all(sizes) and np.ptp(sizes) < SAME_M:
            base[name] = float(np.mean(sizes))
    ahead = float(places[:, 0].mean())
    if abs(ahead) > SAME_M:
        description.notes.append(
            f"the centre of the wheels is at x = {ahead:.3f} m in {urdf.base}, but the simulators place it at "
            "the origin: give base.casters and body.com relative to the centre of the wheels"
        )


def _wheel(urdf: UrdfFile, joint: Any) -> Tuple[float, float, np.ndarray]:
    """Return radius, width and centre (3,) of a wheel [m]; 0 for a size that the collision shapes do not define."""
    parts = urdf.parts(joint)
    shapes = [corners for name in parts for corners in urdf.shapes(name)]
    low, high = (
        end(np.concatenate(shapes), axis=0) if shapes else np.zeros(3) for end in (np.min, np.max)
    )
    length, width, height = high - low
    if (
        len(shapes) < sum(len(urdf.links[name].collisions) for name in parts)
        or abs(length - height) >= 0.1 * height
    ):
        return 0.0, 0.0, urdf.pose(joint.child)[:3, 3]
    # A wheel modelled as a sphere has no known width.
    return float(height / 2), float(width) if width < 0.9 * height else 0.0, (low + high) / 2


def _body(
    urdf: UrdfFile, joints: List[Any], footprint: np.ndarray, description: Description
) -> None:
    """Fill the section body with the bounds of the fixed collision shapes above the axles.

    If they are unusable, propose the footprint's size. Shapes below the axles, such as casters, are
    ignored.
    """
    base, body, notes = description.values["base"], description.values["body"], description.notes
    axle, driven = base.get("axle_height", inf), {joint.name for joint in joints}
    fixed = [name for name, moved in urdf.moving.items() if not moved]
    shapes = [shape for name in fixed for shape in urdf.shapes(name) if shape[:, 2].max() > axle]
    low, high = (
        end(np.concatenate(shapes), axis=0) if shapes else np.zeros(3) for end in (np.min, np.max)
    )
    problem = "" if shapes else "no fixed collision shapes above the axles are known"
    if urdf.lost:
        problem = f"{', '.join(sorted(urdf.lost))} is missing (put its package beside the package of the URDF)"
    elif shapes and low[2] < axle - base.get("wheel_radius", inf) + CLEARANCE_M:
        problem = "the fixed collision shapes reach down to the ground, as casters do"
    elif shapes and high[1] - low[1] < base["track"] / 2:
        problem = "the fixed collision shapes are narrower than half the track"
    if not problem:
        body.update(
            size=(high - low).tolist(), centre=((low + high) / 2)[:2].tolist(), bottom=float(low[2])
        )
    else:
        notes.append(f"outline not identified: {problem}; fill it in")
    if problem and len(footprint):
        length, width = np.ptp(footprint, axis=0).tolist()
        body["centre"] = ((footprint.min(axis=0) + footprint.max(axis=0)) / 2).tolist()
        origin = "length and width of the footprint in the parameter files"
        description.hints["body", "size"] = [length, width], origin
    moving = [
        name
        for name, moved in urdf.moving.items()
        if moved and not driven & {joint.name for joint in moved}
    ]
    left_out = [name for name in moving if urdf.links[name].collisions]
    if left_out and not problem:
        notes.append(f"the outline excludes moving links: {', '.join(left_out)}")


def _laser(urdf: UrdfFile, laser: str, sensor_frame: str, description: Description) -> None:
    """Fill the section laser with its pose, and with the settings of Gazebo's ray sensor on its link.

    By default, the laser is the link `sensor_frame` of the costmap's source, or the link of the
    only ray sensor.
    """
    sensors: Dict[str, List[Any]] = {}
    for holder in urdf.xml.findall("gazebo"):
        for sensor in (
            sensor for sensor in holder.findall("sensor") if sensor.get("type") in _RAYS
        ):
            sensors.setdefault(str(holder.get("reference")), []).append(sensor)
    link = laser or sensor_frame or (next(iter(sensors)) if len(sensors) == 1 else "")
    if laser and laser not in urdf.links:
        advice = did_you_mean(laser, urdf.links) or "give one of its links"
        raise ApplrError(f"{urdf.path} has no link {laser}: {advice}")
    if link not in urdf.links:
        others = f"; these links have ray sensors: {', '.join(sensors)}" if sensors else ""
        no = (
            f"{urdf.path} has no link {link}, the sensor_frame of the costmaps"
            if link
            else "no file names it"
        )
        description.notes.append(f"laser not identified: {no}; give it with --laser LINK{others}")
        description.values["laser"].update({"frame": link} if link else {})
        return
    pose, values = urdf.pose(link), description.values["laser"]
    if abs(pose[2, 2]) < 0.95:
        raise ApplrError(
            f"{urdf.path}: {link} is tilted, but scans must be level; give another link with --laser"
        )
    values.update(
        frame=link,
        pose=[*pose[:2, 3].tolist(), atan2(pose[1, 0], pose[0, 0])],
        height=float(pose[2, 3]),
    )
    if len(sensors.get(link, [])) != 1:
        return
    (sensor,) = sensors[link]
    fields = {name: _number(sensor, place) for name, place in _TAGS.items()}
    resolution = _number(sensor, ".//horizontal/resolution")  # ranges per ray
    fields["beams"] *= resolution if isfinite(resolution) else 1.0
    if pose[2, 2] < 0.0:  # The laser is mounted upside down.
        fields["first_angle"], fields["last_angle"] = -fields["last_angle"], -fields["first_angle"]
    values.update(
        (name, int(x) if name == "beams" else x) for name, x in fields.items() if isfinite(x)
    )


def _number(sensor: Any, place: str) -> float:
    """Return the number in a tag of a sensor, or nan if the tag is missing."""
    return float(sensor.findtext(place) or "nan")
