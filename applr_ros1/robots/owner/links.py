"""Finds wheels, casters, body and laser among the links of a URDF: `read_urdf`, by sections of robot.yaml.

urdf.py reads the file, training/new_robot.py writes the folder of a robot from what this finds.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from math import atan2, hypot, inf, isfinite, nan, pi
from typing import Any, Dict, Iterable, List, Mapping, Set, Tuple

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.robots.owner.urdf import LASER, Box, UrdfFile, around

_OMNI = re.compile(r"mecanum|omni", re.IGNORECASE)
_SIDEWAYS_PLUGIN = re.compile(r"mecanum|planar_move|force_based_move", re.IGNORECASE)
_STEERING = re.compile(r"steer", re.IGNORECASE)
_WHEEL = re.compile(r"wheel", re.IGNORECASE)
AXES = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5**0.5, 0.5**0.5, 0], [0.5**0.5, -(0.5**0.5), 0]])  # and diagonals
STEEL = 7850.0  # kg/m^3
LIGHTEST = 5.0  # kg/m^3 of the box around a part: a smaller mass stands in for one that nobody knows
FLAT = 0.01  # m: what is drawn no higher above the ground is the mark of a frame
_SENSOR = re.compile(rf"{LASER.pattern}|camera|imu|gps|sonar|sensor", re.IGNORECASE)
ARRANGEMENTS = ((4, 2, 2, 1), (2, 0, 1, 0))  # of wheels: how many, in front, on the left, in front on the left
_RAYS = ("ray", "gpu_ray", "lidar", "gpu_lidar")
_OURS = "the planners and simulators here are for four wheels on two axles (skid steer) and for two on one axle"
_CONTROLLER = " (where others drive it, give the controller's file, whose left_wheel and right_wheel are those)"
_SIDEWAYS = " is of an omni base, which also drives sideways"


@dataclass
class Description:
    """Content of a URDF. values: by section and field of robot.yaml; what it does not say is not there.

    notes: sentences about what was left out or looks odd.
    """

    values: Dict[str, Dict[str, Any]] = field(default_factory=dict)
    notes: List[str] = field(default_factory=list)


def read_urdf(
    path: str, arguments: Mapping[str, str], base_frame: str = "", laser_frame: str = "", driven: Iterable[str] = ()
) -> Description:
    """The description of the robot in a URDF or xacro file.

    Args:
        path: The file. Packages that it names are looked for around it and in ROS_PACKAGE_PATH.
        arguments: Of the xacro file, by name.
        base_frame: Link in which places are given; "": base_link, else base_footprint, else the root of the tree.
        driven: Joints that a controller of the wheels names.
        laser_frame: Link that is the scanner's; "": the one that a sensor of Gazebo or a link's name says.

    Raises:
        ApplrError: The file is no URDF, or its wheels are not two on one axle or four on two.
    """
    urdf = UrdfFile(path, arguments, base_frame)
    description = Description(
        {"base": {}, "body": {}, "laser": {}, "topics": {}, "frames": {"base": base_frame or urdf.base}}
    )
    if base_frame and not urdf.link(base_frame):
        description.notes.append(
            f"{path} has no link {base_frame}, which the parameter files name as robot_base_frame: places are in "
            f"{urdf.base}; where a static transform moves or turns one against the other, write robot_base_frame: "
            f"{urdf.base} into a copy of the parameter file"
        )
    wheels = _wheels(urdf, set(driven))
    undrawn = {} if wheels else _undrawn(urdf, set(driven))
    fixed = {} if wheels or undrawn else _loosened(urdf)
    if fixed:
        kinds = " or ".join(sorted(set(fixed.values())))
        description.notes.append(f"taken for driven wheels, though they are {kinds}: {', '.join(fixed)}")
        wheels = _wheels(urdf, set(fixed))
    base = description.values["base"]
    if not wheels:
        description.notes.append(_no_wheels(urdf))
        wheels = undrawn
    found, ahead = _drive(urdf, wheels, description.notes) if wheels else ({}, 0.0)
    base.update(found)
    marks = _marks(urdf, wheels, base)
    driven = {joint.name for joint, _ in wheels.values()}
    suspension = {j.name for joint, _ in wheels.values() for j in urdf.moving[joint.child]} - driven
    rest = [name for name in urdf.links if not driven & {j.name for j in urdf.moving[name]}]
    rigid = [name for name in rest if {j.name for j in urdf.moving[name]} <= suspension]
    loose = [name for name in rest if name not in rigid]
    carrying: Set[str] = set()
    if base.get("drive") == "two_wheel" and "wheel_radius" in base:
        above = {joint.parent for name in wheels for joint in urdf.above(name)}
        drawn = [name for name in above if _is_drawn_only(urdf, name)]  # a link that carries a wheel is none itself
        able = [name for name in rest if name not in {*marks, *drawn}]
        places, standing = _casters(urdf, able, base["axle_height"], base["wheel_radius"], ahead)
        if places:
            base["casters"] = places
        swivels = {joint.name for name in standing for joint in urdf.moving[name]}
        carrying = standing & above & set(rigid)  # a body whose casters are shapes of its own
        rigid = [name for name in rigid if name not in standing]
        loose = [name for name in loose if not swivels & {joint.name for joint in urdf.moving[name]}]
    _body(urdf, description, ahead, rest, [name for name in rigid if name not in marks], carrying)
    shaped = [name for name in loose if urdf.links[name].collisions]
    if shaped:
        description.notes.append(f"links that move are left out of the outline: {', '.join(shaped)}")
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
    """Tell whether a joint turns for ever, or nearly: a wheel may be revolute with limits of many turns."""
    return _range(joint) > 4 * pi


def _range(joint: Any) -> float:
    """The angle [rad] by which a joint turns."""
    limit = joint.limit
    stated = joint.type == "revolute" and limit is not None and None not in (limit.lower, limit.upper)
    return inf if joint.type == "continuous" else limit.upper - limit.lower if stated else 0.0


def _named(urdf: UrdfFile, driven: Set[str]) -> Set[str]:
    """The joints that drive: what a controller's file or a drive plugin of Gazebo names, else what transmissions do.

    Some files have one for each joint: what is below a free swivel, and smaller than the others, is a caster.
    """
    plugins = [part for part in urdf.xml.iter("plugin") if re.search("drive|skid", str(part.get("filename")))]
    words = {word for part in plugins for inner in part.iter() for word in re.split(r"[\s,]+", inner.text or "")}
    moved = {joint.get("name", "") for part in urdf.xml.iter("transmission") for joint in part.iter("joint")}
    known = {joint.name: joint for joint in urdf.joints}
    named = next(filter(None, (names & set(known) for names in (driven | words, moved))), set())
    if not (driven | words) & named:
        heights = {name: _height(urdf, known[name]) for name in named if abs(urdf.axis(known[name])[2]) < 0.3}
        swivels = {name: _free_swivels(urdf, known[name]) for name in heights}
        most = 0.9 * max((heights[name] for name, above in swivels.items() if not above), default=0.0)
        casters = {name for name, above in swivels.items() if above and heights[name] < most}
        named -= casters.union(*(swivels[name] for name in casters))
    return named | {joint.name for joint in urdf.joints if joint.mimic is not None and joint.mimic.joint in named}


def _height(urdf: UrdfFile, joint: Any) -> float:
    """The height of what a joint turns [m]; 0 where nothing is drawn."""
    boxes = _shape(urdf, [name for name, joints in urdf.moving.items() if joints[:1] == [joint]])
    return float(np.ptp(around(boxes), axis=0)[2]) if boxes else 0.0


def _free_swivels(urdf: UrdfFile, joint: Any) -> Set[str]:
    """The joints above one that turn for ever about an upright axis."""
    return {j.name for j in urdf.moving[joint.child][1:] if abs(urdf.axis(j)[2]) > 0.7 and _turns(j)}


def _shape(urdf: UrdfFile, names: Iterable[str]) -> List[Box]:
    """Boxes around the collision shapes of links, else around what is drawn of them."""
    names = list(names)
    return urdf.boxes(names) or urdf.boxes(names, "visuals")


def _is_drawn_only(urdf: UrdfFile, name: str) -> bool:
    """Tell whether a link can neither touch anything nor weigh anything."""
    return not urdf.links[name].collisions and not urdf.inertia([name])[0]


def _marks(urdf: UrdfFile, wheels: Iterable[str], base: Mapping[str, Any]) -> Set[str]:
    """The links that lie flat on the ground and only show where a frame is, as base_footprint's often does."""
    if "wheel_radius" not in base:
        return set()
    ground, found = base["axle_height"] - base["wheel_radius"], set()
    above = {joint.parent for name in wheels for joint in urdf.above(name)}
    for name in filter(lambda name: _is_drawn_only(urdf, name), urdf.links):
        boxes = urdf.boxes([name], "visuals")
        high = max(FLAT, base["wheel_radius"] / 2) if name in above else FLAT
        if boxes and around(boxes)[0, 2] < ground + FLAT and around(boxes)[1, 2] < ground + high:
            found.add(name)
    return found


def _wheels(urdf: UrdfFile, driven: Set[str]) -> Dict[str, Tuple[Any, Box]]:
    """Joints of the driven wheels and boxes around these, by link.

    Driven is what a transmission, drive plugin or controller (driven) names and touches the ground; where none does,
    the largest of what turns about an axis across the robot and touches the ground. ApplrError for another base.
    """
    named = _named(urdf, driven)
    wrong: Dict[str, str] = {}
    steered: Dict[str, str] = {}  # also those that are not driven
    found: Dict[str, Tuple[Any, Box]] = {}
    for joint in urdf.joints:
        carriers, axis = urdf.moving.get(joint.child, [])[1:], urdf.axis(joint)
        swivels = [j for j in carriers if abs(urdf.axis(j)[2]) > 0.7 and j.type != "prismatic"]
        limited = [j for j in swivels if _range(j) < pi or j.name in named]
        if joint.name not in named and any(map(_turns, carriers)) and not limited:
            continue  # a caster below its swivel, a roller on a wheel's rim
        if joint.type == "fixed" or abs(axis[2]) > 0.3 or not (_turns(joint) or joint.name in named):
            continue  # a swivel, a turret
        parts = [name for name, joints in urdf.moving.items() if joints[:1] == [joint]]
        boxes = _shape(urdf, parts)
        disc = bool(boxes) and _is_disc(around(boxes))
        across = abs(axis[1]) > 0.95 or disc
        if not (disc or _turns(joint) and across or _rolls(urdf, parts, axis)):
            continue  # a leg, a swivel that lies
        locked = [j for j in urdf.above(joint.child) if not _range(j) and _STEERING.search(j.name)]
        rollers = [j.name for j in urdf.joints if joint in urdf.moving.get(j.child, [])[1:] and _turns(j)]
        if swivels or locked:
            wrong[joint.child] = f"{(swivels + locked)[0].name} steers the wheel of {joint.name}"
            wrong[joint.child] += _CONTROLLER * all(map(_turns, swivels + locked))
            steered.update({joint.child: wrong[joint.child]} if limited or locked else {})
        elif not across:
            wrong[joint.child] = f"{joint.name}, which turns about an axis not across the robot,{_SIDEWAYS}"
        elif len(rollers) > 2 or _OMNI.search(f"{joint.name} {joint.child}"):
            wrong[joint.child] = f"{joint.name}{_SIDEWAYS}"
        if boxes:
            found[joint.child] = (joint, around(boxes))
    lowest = min((box[0, 2] for _, box in found.values()), default=0.0)
    found = {name: (j, box) for name, (j, box) in found.items() if box[0, 2] < lowest + (box[1, 2] - box[0, 2]) / 4}
    most = 0.9 * max((box[1, 2] - box[0, 2] for _, box in found.values()), default=0.0)
    largest = {name: wheel for name, wheel in found.items() if wheel[1][1, 2] - wheel[1][0, 2] > most}
    driving = {name: wheel for name, wheel in found.items() if wheel[0].name in named} or largest
    apart = np.ptp([box.mean(axis=0) for _, box in driving.values()], axis=0) if len(driving) == 2 else np.zeros(2)
    if apart[0] > apart[1]:
        links = ["base_footprint"] * ("base_footprint" in urdf.links) + list(urdf.links)
        ahead = next((name for name in links if abs(urdf.pose(name)[0, 1]) > 0.95), "one that you add")
        raise ApplrError(
            f"{urdf.path}: the wheels {' and '.join(driving)} roll along y of {urdf.base}: give as robot_base_frame a "
            f"link whose x points ahead, such as {ahead}"
        )
    refused = [steered[name] for name in found if name in steered] + [wrong[name] for name in driving if name in wrong]
    plugins = [str(plugin.get("filename")) for plugin in urdf.xml.iter("plugin") if len(driving) != 2]
    refused += [file + _SIDEWAYS for file in plugins if _SIDEWAYS_PLUGIN.search(file)]
    if refused:  # what turns above the ground, such as a gripper, is no wheel
        raise ApplrError(f"{urdf.path}: {refused[0]}: {_OURS}")
    return driving


def _rolls(urdf: UrdfFile, parts: List[str], axis: np.ndarray) -> bool:
    """Tell whether parts are a disc about a level axis."""
    axes = np.array([np.cross(axis, (0.0, 0.0, 1.0)), axis, (0.0, 0.0, 1.0)])
    boxes = urdf.boxes(parts, "collisions", axes) or urdf.boxes(parts, "visuals", axes)
    return bool(boxes) and _is_disc(around(boxes))


def _is_disc(box: Box) -> bool:
    """Tell whether it is round seen from the side, and narrow."""
    x, y, z = box[1] - box[0]
    return bool(abs(x - z) < 0.1 * z and y < 0.9 * z)


def _loosened(urdf: UrdfFile) -> Dict[str, str]:
    """Lets the largest things turn that stand on the ground, are discs, and do not turn; {joint: what it was}."""
    round_ones = {}
    for joint in (j for j in urdf.joints if not _turns(j) or abs(urdf.axis(j)[2]) > 0.3):
        boxes = _shape(urdf, [joint.child])
        if boxes and _is_disc(around(boxes)):
            (_, _, low), (_, _, high) = around(boxes)
            round_ones[joint.name] = joint, low, high - low
    lowest = min((low for _, low, _ in round_ones.values()), default=0.0)
    largest = max((z for _, low, z in round_ones.values() if low < lowest + z / 4), default=0.0)
    found = {name: j for name, (j, low, z) in round_ones.items() if low < lowest + z / 4 and z > 0.9 * largest}
    found = {name: j for name, j in found.items() if not any(above.name in found for above in urdf.above(j.parent))}
    kinds = {name: joint.type for name, joint in found.items()}
    for joint in found.values():
        joint.type, joint.axis = "continuous", urdf.pose(joint.child)[:3, :3].T @ [0.0, 1.0, 0.0]
    urdf.moving.update((name, [j for j in urdf.above(name) if j.type != "fixed"]) for name in urdf.links)
    return kinds


def _no_wheels(urdf: UrdfFile) -> str:
    """Return what to say where no wheel is drawn."""
    still = [j for j in urdf.joints if _WHEEL.search(f"{j.name} {j.child}") and not _turns(j)]
    called = ", ".join(f"{joint.name} is {joint.type}" for joint in still)[:200]
    remedy = f"{called}: make the wheels' joints continuous" if called else "where they are in another URDF, give that"
    if urdf.lost and any(map(_turns, urdf.joints)):
        remedy = f"put the package of {sorted(urdf.lost)[0]} beside its own, or source the workspace that has it"
    turns = "no continuous joint turns a link with a shape about an axis across the robot"
    return f"no wheels are drawn: {turns}; {remedy}"


def _undrawn(urdf: UrdfFile, driven: Set[str]) -> Dict[str, Tuple[Any, Box]]:
    """Joints of wheels without a shape, two on one axle or four on two, and their places, by link; {} for others."""
    named, found = _named(urdf, driven), {}
    for joint in urdf.joints:
        called = joint.name in named or not named and _WHEEL.search(f"{joint.name} {joint.child}")
        if called and _turns(joint) and abs(urdf.axis(joint)[1]) > 0.95 and not _free_swivels(urdf, joint):
            found[joint.child] = joint, np.tile(urdf.pose(joint.child)[:3, 3], (2, 1))
    return found if _arrangement(found)[0] in ARRANGEMENTS else {}


def _arrangement(wheels: Mapping[str, Tuple[Any, Box]]) -> Tuple[Tuple[int, ...], np.ndarray, np.ndarray]:
    """How many wheels there are, in front, on the left, in front on the left; and (n,) whether each is so placed."""
    boxes = np.array([box for _, box in wheels.values()]).reshape(-1, 2, 3)
    middles, radius = boxes.mean(axis=1), float(np.ptp(boxes[:, :, 2], axis=1).sum()) / max(1, 2 * len(boxes))
    if not wheels:
        return (0, 0, 0, 0), np.zeros(0, bool), np.zeros(0, bool)
    front = middles[:, 0] > middles[:, 0].mean() + max(radius / 4, FLAT)
    left = middles[:, 1] > middles[:, 1].mean() + 1e-6
    return (len(wheels), int(front.sum()), int(left.sum()), int(left[front].sum())), front, left


def _drive(urdf: UrdfFile, wheels: Dict[str, Tuple[Any, Box]], notes: List[str]) -> Tuple[Dict[str, Any], float]:
    """Kind of the drive and measures of the wheels, and how far their middle lies ahead of the base frame [m].

    notes: gets a sentence about what cannot be.
    """
    boxes = np.array([box for _, box in wheels.values()])
    middles, sizes = boxes.mean(axis=1), boxes[:, 1] - boxes[:, 0]
    ahead, radius = float(middles[:, 0].mean()), float(sizes[:, 2].mean() / 2)
    pairs, front, left = _arrangement(wheels)
    if pairs not in ARRANGEMENTS:
        found_ones = [*sorted(wheels), *(f"{name} is {kind}" for name, kind in _loosened(urdf).items())]
        raise ApplrError(f"{urdf.path}: the driven wheels are {', '.join(found_ones)}{_CONTROLLER}: {_OURS}")
    found: Dict[str, Any] = {
        "drive": "two_wheel" if len(wheels) == 2 else "skid_steer",
        "wheel_radius": radius or None,
        "wheel_width": float(sizes[:, 1].mean()) or None,
        "track": float(middles[left, 1].mean() - middles[~left, 1].mean()),
        "axle_height": float(middles[:, 2].mean()),
    }
    if front.any():
        found["wheelbase"] = float(middles[front, 0].mean() - middles[~front, 0].mean())
    round_ones = [name for name in wheels if any(c.geometry.sphere for c in urdf.links[name].collisions)]
    if round_ones:  # balls that stand for wheels say nothing about their width
        seen = urdf.boxes(round_ones, "visuals")
        found.update(wheel_width=float(np.mean([b[1, 1] - b[0, 1] for b in seen])) if seen else None)
    weighed = [name for name in wheels if urdf.inertia([name])[0]]
    if weighed:
        found["wheel_mass"] = urdf.inertia(weighed)[0] / len(weighed)
        full = STEEL * pi * radius**2 * (found["wheel_width"] or inf) if radius else inf
        if found["wheel_mass"] > full:
            notes.append(
                f"a wheel weighs {found['wheel_mass']:.3g} kg in {urdf.path}, and {full:.3g} kg if it were "
                "all of steel: look at base.wheel_mass"
            )
        own = np.mean([urdf.inertia([name])[2] for name in weighed], axis=0)
        if own.min() > 1e-9:
            found["wheel_inertia"] = own.tolist()
    return {name: value for name, value in found.items() if value is not None}, ahead


def _casters(
    urdf: UrdfFile, rest: List[str], axle: float, radius: float, ahead: float
) -> Tuple[List[List[float]], Set[str]]:
    """Return where links other than the wheels touch the ground (x, y), and which do.

    What touches it right below the axle, at x = ahead, holds nothing up.
    """
    places: List[List[float]] = []
    standing = set()
    for name in rest:
        for box in _shape(urdf, [name]):
            x, y = box.mean(axis=0)[:2].tolist()
            if not _stands(box, axle, radius):
                continue
            standing.add(name)
            if abs(x - ahead) > FLAT and all(hypot(x - other[0], y - other[1]) > radius for other in places):
                places.append([x, y])
    return places, standing


def _stands(box: Box, axle: float, radius: float) -> bool:
    """Tell whether it is on the ground, and neither the mark of a frame nor a body that hangs low."""
    return bool(box[0, 2] <= axle - 0.85 * radius and 0.005 < np.max((box[1] - box[0])[:3]) < 4 * radius)


def _body(
    urdf: UrdfFile, description: Description, ahead: float, rest: List[str], rigid: List[str], carrying: Set[str]
) -> None:
    """Box around the body, whether it is round, and its mass. What reaches a bit below the ground ends there.

    ahead: x of the wheels' middle [m]. rest: all but the wheels. rigid: what of it is fixed.
    carrying: links that have casters among their shapes; the others of these shapes are the body's.
    """
    base = description.values["base"]
    radius, track = base.get("wheel_radius", 0.0), base.get("track", 0.0)
    ground = base["axle_height"] - radius if radius else -inf
    body, kinds = description.values["body"], ("collisions", "visuals")
    ends = {}
    for kind in kinds:
        own = urdf.boxes(carrying, kind, AXES)
        boxes = [*urdf.boxes(rigid, kind, AXES), *(box for box in own if not _stands(box, base["axle_height"], radius))]
        if boxes:
            ends[kind] = around(boxes)
    for kind, (low, high) in list(ends.items()):
        beside = max(low[0] - ahead, ahead - high[0]) > radius > 0.0
        if beside or high[1] - low[1] < track / 2:
            del ends[kind]  # marks of frames, and boxes of sensors
    if ends:
        kind, (low, high) = next(iter(ends.items()))
        low[2] = ground if ground - radius / 4 < low[2] < ground else low[2]
        x, y, z, *diagonals = (high - low).tolist()
        body.update(size=[x, y, z], centre=((low + high) / 2)[:2].tolist(), bottom=float(low[2]))
        # along its diagonals a rectangle measures x + y, an ellipse hypot(x, y), both over sqrt(2)
        if max(diagonals) < (0.15 * (x + y) + 0.85 * hypot(x, y)) / 2**0.5:
            body["round"] = True
        if kind == "visuals":
            description.notes.append("the body has no collision shapes: its outline is that of what is seen")
    mass, centre, inertia = urdf.inertia(rest)
    unweighed = _unweighed(urdf, rest)
    if mass and unweighed:
        having = ", ".join(f"{name} ({urdf.inertia([name])[0]:.3g} kg)" for name in rest if urdf.inertia([name])[0])
        description.notes.append(f"{unweighed}, the largest part of the body, has no mass: {having} is not the whole")
    elif mass:
        body.update(mass=mass, com=centre.tolist())
        if inertia.min() > 1e-9:
            body["inertia"] = inertia.tolist()


def _unweighed(urdf: UrdfFile, rest: List[str]) -> str:
    """Return the largest part of the body, where no link gives its mass; "" where one does.

    A link that is not drawn, or by a mesh that is not there, may do so for another, unless it is a sensor.
    """
    masses = {name: urdf.inertia([name])[0] for name in rest}
    volumes = {name: sum(float(np.ptp(box, axis=0).prod()) for box in _shape(urdf, [name])) for name in rest}
    for name, mass in masses.items():
        if not volumes[name] and not _SENSOR.search(name) and mass > LIGHTEST * max(volumes.values()):
            return ""
    largest = max(volumes, key=lambda name: (volumes[name], name == urdf.base), default="")
    return "" if not largest or masses[largest] > LIGHTEST * volumes[largest] else largest


def _laser(urdf: UrdfFile, description: Description, frame: str) -> None:
    """Its place, and what a sensor of Gazebo says of its rays."""
    places: Dict[Any, List[Any]] = {}
    for holder in urdf.xml.findall("gazebo"):
        for sensor in holder.findall("sensor"):
            flat = not _number(sensor, ".//vertical/samples") > 1
            if sensor.get("type") in _RAYS and flat and _looks_around(urdf, holder.get("reference"), sensor):
                named = (sensor.findtext("plugin/frameName") or sensor.findtext("plugin/frame_name") or "").strip()
                places.setdefault(named if named in urdf.links else holder.get("reference"), []).append(sensor)
    sensors = {link: several[0] for link, several in places.items()}
    for link, several in places.items():
        if several[1:]:
            names = ", ".join(str(sensor.get("name")) for sensor in several)
            description.notes.append(f"of the sensors {names} of {link} the first is taken")
    named = [name for name in urdf.links if LASER.search(name)]
    leaves = [
        name for name in named if not any(name in [joint.parent for joint in urdf.above(other)] for other in named)
    ]
    candidates = [urdf.link(frame)] if urdf.link(frame) else list(sensors) or leaves
    if not candidates:
        description.notes.append(
            "there is no laser: no link is named after one, and no sensor of Gazebo has rays" + urdf.choices
        )
        description.values["laser"].update({"frame": frame} if frame else {})
        return
    if len(candidates) > 1:
        lasers = ", ".join(candidates)
        description.notes.append(f"of the lasers {lasers} the first is taken: one planar scanner is simulated")
    link, base = candidates[0], description.values["frames"]["base"]
    prefix = base[: -len(urdf.base)] if base.endswith("/" + urdf.base) else ""
    pose, laser = urdf.pose(link), description.values["laser"]
    x, y, z = pose[:3, 3].tolist()
    frame = frame if urdf.link(frame) else prefix + link
    laser.update(frame=frame, pose=[x, y, atan2(pose[1, 0], pose[0, 0])], height=z)
    if abs(pose[2, 2]) < 0.99:
        description.notes.append(f"{link} is tilted: the simulators hold it level")
    sensor = sensors.get(link, next(iter(sensors.values())) if len(sensors) == 1 else None)
    if sensor is None:
        return
    tags = {
        "beams": ".//horizontal/samples",
        "first_angle": ".//horizontal/min_angle",
        "last_angle": ".//horizontal/max_angle",
        "range_min": ".//range/min",
        "range_max": ".//range/max",
        "rate": "update_rate",
        "noise": ".//noise/stddev",
    }
    found = {name: _number(sensor, place) for name, place in tags.items()}
    resolution = _number(sensor, ".//horizontal/resolution")  # ranges for each ray
    found["beams"] *= resolution if isfinite(resolution) else 1.0
    laser.update((name, int(x) if name == "beams" else x) for name, x in found.items() if isfinite(x))
    if {"first_angle", "last_angle"} <= set(laser):
        sign = -1.0 if pose[2, 2] < 0 else 1.0  # upside down
        ends = sorted((sign * laser["first_angle"], sign * laser["last_angle"]))
        laser.update(first_angle=ends[0], last_angle=ends[1])
    topic = (sensor.findtext("plugin/topicName") or "").strip()
    if topic:
        description.values["topics"]["scan"] = topic


def _looks_around(urdf: UrdfFile, link: str, sensor: Any) -> bool:
    """Tell whether it is level and wide: cliff sensors and sonars are rays for Gazebo as well."""
    first, last = (_number(sensor, f".//horizontal/{name}_angle") for name in ("min", "max"))
    return link in urdf.links and abs(urdf.pose(link)[2, 2]) > 0.8 and abs(last - first) > 0.6


def _number(sensor: Any, place: str) -> float:
    """Return what a tag of a sensor holds, nan where that is no number."""
    try:
        return float(sensor.findtext(place) or "nan")
    except ValueError:
        return nan
