"""Judges what a URDF says of a robot: which links are wheels, casters, body and laser, by sections of robot.yaml.

urdf_file.py reads the file, training/new_robot.py writes the folder of a robot from what this finds.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import dataclass, field
from math import atan2, hypot, pi
from typing import Any, Dict, Iterable, List, Mapping, Set, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots.urdf_file import Box, UrdfFile, around

_OMNI = re.compile(r"mecanum|omni", re.IGNORECASE)
_SIDEWAYS_PLUGIN = re.compile(r"mecanum|planar_move|force_based_move", re.IGNORECASE)
_STEERING = re.compile(r"steer", re.IGNORECASE)
_WHEEL = re.compile(r"wheel", re.IGNORECASE)
_LASER = re.compile(r"laser|lidar|scan|hokuyo|sick", re.IGNORECASE)
STEEL = 7850.0  # kg/m^3
_RAYS = ("ray", "gpu_ray", "lidar", "gpu_lidar")
_OURS = "the planners and simulators here are for four wheels on two axles (skid steer) and for two on one axle"
_SIDEWAYS = " is of an omni base, which also drives sideways"


@dataclass
class Description:
    """What a URDF says. values: by section and field of robot.yaml; what it does not say is not there.

    notes: sentences about what was left out or looks odd.
    """

    values: Dict[str, Dict[str, Any]] = field(default_factory=dict)
    notes: List[str] = field(default_factory=list)


def read_urdf(
    path: str,
    arguments: Mapping[str, str],
    base_frame: str = "",
    laser_frame: str = "",
    driven: Iterable[str] = (),
) -> Description:
    """The description of the robot in a URDF or xacro file.

    Args:
        path: The file. Packages that it names are looked for around it and in ROS_PACKAGE_PATH.
        arguments: Of the xacro file, by name.
        base_frame: Link in which places are given; "": base_link, else base_footprint, else the root of the tree.
        driven: Joints that a controller of the wheels names.
        laser_frame: Link that is the scanner's; "": the one that a sensor of Gazebo or a link's name says.

    Raises:
        ApplrError: The file is no URDF, or describes no base with two driven wheels or with four on two axles.
    """
    urdf = UrdfFile(path, arguments, base_frame)
    description = Description(
        {"base": {}, "body": {}, "laser": {}, "topics": {}, "frames": {"base": base_frame or urdf.base}}
    )
    if base_frame not in ("", urdf.base):
        description.notes.append(
            f"{path} has no link {base_frame}, which the parameter files name as robot_base_frame: places are in "
            f"{urdf.base}; where a static transform moves or turns one against the other, write robot_base_frame: "
            f"{urdf.base} into a copy of the parameter file"
        )
    wheels = _wheels(urdf, set(driven))
    fixed = [] if wheels else _loosened(urdf)
    if fixed:
        description.notes.append(f"taken for driven wheels, though they are fixed: {', '.join(fixed)}")
        wheels = _wheels(urdf, set(fixed))
    base = description.values["base"]
    found, ahead = _drive(urdf, wheels, description.notes)
    base.update(found)
    driven = {joint.name for joint, _ in wheels.values()}
    suspension = {j.name for joint, _ in wheels.values() for j in urdf.moving[joint.child]} - driven
    rest = [name for name in urdf.links if not driven & {j.name for j in urdf.moving[name]}]
    rigid = [name for name in rest if {j.name for j in urdf.moving[name]} <= suspension]
    loose = [name for name in rest if name not in rigid]
    if base["drive"] == "two_wheel":
        places, standing = _casters(urdf, rest, base["axle_height"], base["wheel_radius"])
        if places:
            base["casters"] = places
        swivels = {joint.name for name in standing for joint in urdf.moving[name]}
        rigid = [name for name in rigid if name not in standing]
        loose = [name for name in loose if not swivels & {joint.name for joint in urdf.moving[name]}]
    _body(urdf, description, rest, rigid, loose)
    _laser(urdf, description, laser_frame)
    if abs(ahead) > 0.01:
        where = "ahead of" if ahead > 0 else "behind"
        description.notes.append(
            f"the wheels' middle lies {abs(ahead):.3f} m {where} {urdf.base}: the simulators drive as if above it, "
            "so base.casters and body.com count from the wheels' middle"
        )
        for place in [*base.get("casters", []), description.values["body"].get("com", [0.0])]:
            place[0] -= ahead
    if urdf.lost:
        lost = ", ".join(sorted(urdf.lost))
        description.notes.append(f"meshes that are not there, and are left out of the outline: {lost}")
    above = urdf.urdf.get_transform(urdf.base, urdf.urdf.base_link)
    is_above = above[2, 3] > 0.0 and np.allclose(above[:2], np.eye(4)[:2], atol=1e-3)
    if is_above and description.values["laser"].get("height", 0.0) < 0.0:
        # as C++ counts heights, for the odometry moves the root
        description = read_urdf(path, arguments, urdf.urdf.base_link, laser_frame, driven)
        description.notes.append(f"the laser lies below {urdf.base}: places are in {urdf.urdf.base_link}")
    return description


def _turns(joint: Any) -> bool:
    """Whether a joint turns for ever, or nearly: a wheel may be revolute with limits of many turns."""
    limit = joint.limit
    turns = joint.type == "revolute" and limit is not None and None not in (limit.lower, limit.upper)
    return joint.type == "continuous" or turns and limit.upper - limit.lower > 4 * pi


def _named(urdf: UrdfFile) -> Set[str]:
    """The joints that transmissions and drive plugins of Gazebo name. ApplrError for a plugin that drives sideways."""
    found = {joint.get("name", "") for part in urdf.xml.iter("transmission") for joint in part.iter("joint")}
    for plugin in urdf.xml.iter("plugin"):
        file = str(plugin.get("filename"))
        if _SIDEWAYS_PLUGIN.search(file):
            raise ApplrError(f"{urdf.path}: {file}{_SIDEWAYS}: {_OURS}")
        if "drive" in file or "skid" in file:
            found |= {word for element in plugin.iter() for word in re.split(r"[\s,]+", element.text or "")}
    return found


def _wheels(urdf: UrdfFile, driven: Set[str]) -> Dict[str, Tuple[Any, Box]]:
    """Joints of the driven wheels and boxes around these, by link.

    Driven is what a transmission, drive plugin or controller (driven) names and touches the ground; where none does,
    all that turns about an axis across the robot and touches the ground.
    """
    named = driven | _named(urdf)
    wrong: Dict[str, str] = {}
    found: Dict[str, Tuple[Any, Box]] = {}
    for joint in urdf.joints:
        carriers, axis = urdf.moving.get(joint.child, [])[1:], urdf.axis(joint)
        if joint.name not in named and any(map(_turns, carriers)):
            continue  # a caster below its swivel, a roller on a wheel's rim
        if joint.type == "fixed" or abs(axis[2]) > 0.3 or not (_turns(joint) or joint.name in named):
            continue  # a swivel, a turret
        parts = [name for name, joints in urdf.moving.items() if joints[:1] == [joint]]
        boxes = urdf.boxes(parts) or urdf.boxes(parts, "visuals")
        steering = [j.name for j in carriers if abs(urdf.axis(j)[2]) > 0.7 and j.type != "prismatic"]
        steering += [
            j.name for j in urdf.above(joint.child) if j.type == "fixed" and _STEERING.search(j.name)
        ]  # locked
        rollers = [j.name for j in urdf.joints if joint in urdf.moving.get(j.child, [])[1:] and _turns(j)]
        if steering:
            wrong[joint.child] = f"{steering[0]} steers the wheel of {joint.name}"
        elif abs(axis[1]) < 0.95:
            wrong[joint.child] = f"{joint.name}, which turns about an axis not across the robot,{_SIDEWAYS}"
        elif len(rollers) > 2 or _OMNI.search(f"{joint.name} {joint.child}"):
            wrong[joint.child] = f"{joint.name}{_SIDEWAYS}"
        if boxes:
            found[joint.child] = (joint, around(boxes))
    lowest = min((box[0, 2] for _, box in found.values()), default=0.0)
    found = {name: (j, box) for name, (j, box) in found.items() if box[0, 2] < lowest + (box[1, 2] - box[0, 2]) / 4}
    found = {name: wheel for name, wheel in found.items() if wheel[0].name in named} or found
    for name in found:  # what turns above the ground, such as a gripper, is no wheel
        if name in wrong:
            raise ApplrError(f"{urdf.path}: {wrong[name]}: {_OURS}")
    return found


def _loosened(urdf: UrdfFile) -> List[str]:
    """Lets the largest things turn that stand on the ground, are round seen from the side and fixed; their joints."""
    boxes = {joint.name: urdf.boxes([joint.child]) or urdf.boxes([joint.child], "visuals") for joint in urdf.joints}
    round_ones = {}
    for joint in (joint for joint in urdf.joints if joint.type == "fixed" and boxes[joint.name]):
        box = around(boxes[joint.name])
        x, y, z = box[1] - box[0]
        if abs(x - z) < 0.1 * z and y < 0.9 * z:
            round_ones[joint.name] = joint, box[0, 2], z
    lowest = min((low for _, low, _ in round_ones.values()), default=0.0)
    largest = max((z for _, low, z in round_ones.values() if low < lowest + z / 4), default=0.0)
    found = {name: j for name, (j, low, z) in round_ones.items() if low < lowest + z / 4 and z > 0.9 * largest}
    for joint in found.values():
        joint.type, joint.axis = "continuous", urdf.pose(joint.child)[:3, :3].T @ [0.0, 1.0, 0.0]
    urdf.moving.update((name, [j for j in urdf.above(name) if j.type != "fixed"]) for name in urdf.links)
    return list(found)


def _standing_still(urdf: UrdfFile) -> str:
    """The joints that do not turn and hold what looks like a wheel, for people."""
    still = [joint for joint in urdf.joints if not _turns(joint)]
    shapes = [
        (j, shape.geometry) for j in still for shape in (*urdf.links[j.child].collisions, *urdf.links[j.child].visuals)
    ]
    found = {j.name: j.type for j, shape in shapes if shape is not None and shape.cylinder or _WHEEL.search(j.child)}
    return ", ".join(f"{name} is {kind}" for name, kind in list(found.items())[:6])


def _drive(urdf: UrdfFile, wheels: Dict[str, Tuple[Any, Box]], notes: List[str]) -> Tuple[Dict[str, Any], float]:
    """Kind of the drive and measures of the wheels, and how far their middle lies ahead of the base frame [m].

    notes: gets a sentence about what cannot be.
    """
    if not wheels:
        lost = f" (there is no {sorted(urdf.lost)[0]})" if urdf.lost else ""
        still = _standing_still(urdf)
        raise ApplrError(
            f"{urdf.path} has no wheels: no continuous joint turns a link with a shape{lost} about an axis across "
            + (
                f"the robot; {still}: make the wheels' joints continuous"
                if still
                else "the robot; give the URDF of the whole robot"
            )
        )
    boxes = np.array([box for _, box in wheels.values()])
    middles, sizes = boxes.mean(axis=1), boxes[:, 1] - boxes[:, 0]
    ahead, radius = float(middles[:, 0].mean()), float(sizes[:, 2].mean() / 2)
    front, left = middles[:, 0] > ahead + radius / 4, middles[:, 1] > middles[:, 1].mean()
    pairs = (len(wheels), int(front.sum()), int(left.sum()), int(left[front].sum()))
    if pairs not in ((4, 2, 2, 1), (2, 0, 1, 0)):
        raise ApplrError(
            f"{urdf.path}: the driven wheels are {', '.join(sorted(wheels))}: {_OURS}; where others are not driven, "
            "give the controller's file, whose left_wheel and right_wheel are those that are"
        )
    found: Dict[str, Any] = {
        "drive": "two_wheel" if len(wheels) == 2 else "skid_steer",
        "wheel_radius": radius,
        "wheel_width": float(sizes[:, 1].mean()),
        "track": float(middles[left, 1].mean() - middles[~left, 1].mean()),
        "axle_height": float(middles[:, 2].mean()),
    }
    if front.any():
        found["wheelbase"] = float(middles[front, 0].mean() - middles[~front, 0].mean())
    round_ones = [name for name in wheels if any(c.geometry.sphere for c in urdf.links[name].collisions)]
    if round_ones:  # balls that stand for wheels say nothing about their width
        seen = urdf.boxes(round_ones, "visuals")
        found.update(wheel_width=float(np.mean([b[1, 1] - b[0, 1] for b in seen])) if seen else None)
    mass, _, inertia = urdf.inertia(wheels)
    if mass:
        found["wheel_mass"] = mass / len(wheels)
        full = STEEL * pi * radius**2 * found["wheel_width"] if found["wheel_width"] else mass
        if found["wheel_mass"] > full:
            notes.append(
                f"a wheel weighs {found['wheel_mass']:.3g} kg in {urdf.path}, and {full:.3g} kg if it were "
                "all of steel: look at base.wheel_mass"
            )
        own = np.mean([urdf.inertia([name])[2] for name in wheels], axis=0)
        if own.min() > 1e-9:
            found["wheel_inertia"] = own.tolist()
    return {name: value for name, value in found.items() if value is not None}, ahead


def _casters(urdf: UrdfFile, rest: List[str], axle: float, radius: float) -> Tuple[List[List[float]], Set[str]]:
    """Where links other than the wheels touch the ground (x, y), and which do."""
    places: List[List[float]] = []
    standing = set()
    for name in rest:
        for box in urdf.boxes([name]) or urdf.boxes([name], "visuals"):
            x, y = box.mean(axis=0)[:2].tolist()
            if box[0, 2] > axle - 0.85 * radius or np.max(box[1] - box[0]) > 4 * radius:
                continue  # above the ground, or a body that hangs low
            standing.add(name)
            if all(hypot(x - other[0], y - other[1]) > radius for other in places):
                places.append([x, y])
    return places, standing


def _body(urdf: UrdfFile, description: Description, rest: List[str], rigid: List[str], loose: List[str]) -> None:
    boxes = urdf.boxes(rigid)
    if not boxes:
        boxes = urdf.boxes(rigid, "visuals")
        description.notes.append("the body has no collision shapes: its outline is that of what is seen")
    body = description.values["body"]
    if boxes:
        low, high = around(boxes)
        body.update(size=(high - low).tolist(), centre=((low + high) / 2)[:2].tolist(), bottom=float(low[2]))
    shaped = [name for name in loose if urdf.links[name].collisions]
    if shaped:
        description.notes.append(f"links that move are left out of the outline: {', '.join(shaped)}")
    mass, centre, inertia = urdf.inertia(rest)
    if mass:
        body.update(mass=mass, com=centre.tolist())
        if inertia.min() > 1e-9:
            body["inertia"] = inertia.tolist()


def _laser(urdf: UrdfFile, description: Description, frame: str) -> None:
    """Its place, and what a sensor of Gazebo says of its rays."""
    sensors = {}
    for holder in urdf.xml.findall("gazebo"):
        for sensor in holder.findall("sensor"):
            flat = float(sensor.findtext(".//vertical/samples") or 1) <= 1
            if sensor.get("type") in _RAYS and flat and _looks_around(urdf, holder.get("reference"), sensor):
                named = (sensor.findtext("plugin/frameName") or sensor.findtext("plugin/frame_name") or "").strip()
                sensors[named if named in urdf.links else holder.get("reference")] = sensor
    named = [name for name in urdf.links if _LASER.search(name)]
    leaves = [
        name for name in named if not any(name in [joint.parent for joint in urdf.above(other)] for other in named)
    ]
    candidates = [frame] if frame in urdf.links else list(sensors) or leaves
    if not candidates:
        description.notes.append(
            "there is no laser: no link is named after one, and no sensor of Gazebo has rays" + urdf.choices
        )
        description.values["laser"].update({"frame": frame} if frame else {})
        return
    if len(candidates) > 1:
        lasers = ", ".join(candidates)
        description.notes.append(f"of the lasers {lasers} the first is taken: one planar scanner is simulated")
    frame = candidates[0]
    pose, laser = urdf.pose(frame), description.values["laser"]
    x, y, z = pose[:3, 3].tolist()
    laser.update(frame=frame, pose=[x, y, atan2(pose[1, 0], pose[0, 0])], height=z)
    if abs(pose[2, 2]) < 0.99:
        description.notes.append(f"{frame} is tilted: the simulators hold it level")
    sensor = sensors.get(frame, next(iter(sensors.values())) if len(sensors) == 1 else None)
    if sensor is None:
        return
    places = {
        "beams": ".//horizontal/samples",
        "first_angle": ".//horizontal/min_angle",
        "last_angle": ".//horizontal/max_angle",
        "range_min": ".//range/min",
        "range_max": ".//range/max",
        "rate": "update_rate",
        "noise": ".//noise/stddev",
    }
    for name, place in places.items():
        text = sensor.findtext(place)
        with contextlib.suppress(TypeError, ValueError):
            laser[name] = int(float(text)) if name == "beams" else float(text)
    if pose[2, 2] < 0 and {"first_angle", "last_angle"} <= set(laser):  # upside down
        laser.update(first_angle=-laser["last_angle"], last_angle=-laser["first_angle"])
    topic = (sensor.findtext("plugin/topicName") or "").strip()
    if topic:
        description.values["topics"]["scan"] = topic


def _looks_around(urdf: UrdfFile, link: str, sensor: Any) -> bool:
    """Whether it is level and wide: cliff sensors and sonars are rays for Gazebo as well."""
    ends = [sensor.findtext(f".//horizontal/{name}_angle") or "0" for name in ("min", "max")]
    return link in urdf.links and abs(urdf.pose(link)[2, 2]) > 0.99 and float(ends[1]) - float(ends[0]) > 0.6
