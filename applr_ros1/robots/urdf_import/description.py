"""Description of a robot's wheels, outline and laser from its URDF: `describe`.

Ambiguous values are left out. training/robot writes the description and lists all values to
fill in.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from math import atan2, inf, isfinite, nan
from typing import Any, Dict, Iterable, Iterator, List, NamedTuple, Sequence, Tuple

import numpy as np

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError, did_you_mean
from applr_ros1.common.scan import LEAST_LEVEL_COS
from applr_ros1.robots import check, geometry
from applr_ros1.robots.robot import FILE
from applr_ros1.robots.urdf_import.urdf import UrdfFile

# Names of wheels and plugins of omnidirectional bases
_SIDEWAYS = re.compile(r"mecanum|omni|planar_move|force_based_move", re.IGNORECASE)
_DRIVEN_TAG = re.compile("(left|right).*joint", re.IGNORECASE)  # tags of such a plugin
_DRIVE_PLUGIN = re.compile(r"diff_drive|skid_steer_drive")  # files of Gazebo's drive plugins
# Names of links to choose from if none has a ray sensor
_LASER_NAME = re.compile(r"laser|lidar|scan|hokuyo|sick", re.IGNORECASE)
_RAYS = ("ray", "gpu_ray", "lidar", "gpu_lidar")  # types of laser scanners in Gazebo
LEAST_ACROSS_COS = 0.95  # cosine of the angle to the lateral up to which an axis counts as lateral
LEAST_UPRIGHT_COS = 0.7  # cosine of the tilt up to which an axis counts as vertical
SAME_SHARE = 0.05  # tolerance of two statements of one length, as a share of it
SAME_M = 0.01  # tolerance of positions and sizes that should agree [m]
LEAST_MASS_KG = 0.01  # smaller masses are placeholders, as in a URDF for RViz alone [kg]
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


# Proposals (value, origin) for fields to fill in, by (section, field) of robot.yaml
Hints = Dict[Tuple[str, str], Tuple[Any, str]]


@dataclass
class Description:
    """Content of a URDF.

    Attributes:
        values: Unambiguous values, by section and field of robot.yaml.
        hints: Proposals for fields to fill in.
        notes: Messages about values used and left out.
    """

    values: Dict[str, Dict[str, Any]] = field(default_factory=dict)
    hints: Hints = field(default_factory=dict)
    notes: List[str] = field(default_factory=list)


class StatedWheels(NamedTuple):
    """Statements of a controller's file or a drive plugin about the driven wheels.

    Attributes:
        origin: The file or plugin, for messages.
        sides: "left" or "right" by joint.
        radius: Radius of a wheel [m], nan if it is not stated.
        separation: Distance between left and right wheels [m], nan if it is not stated.
    """

    origin: str
    sides: Dict[str, str]
    radius: float = nan
    separation: float = nan


def describe(
    urdf: UrdfFile,
    controllers: Sequence[StatedWheels],
    footprint: Array,
    laser: str,
    sensor_frame: str,
) -> Description:
    """Return the description of a robot.

    Args:
        urdf: URDF of the robot.
        controllers: What a controller's file states about the driven wheels; empty without one.
        footprint: Outline (n, 2) [m] in the parameter files; empty if there is none.
        laser: Link of the laser given by the user; "" for none.
        sensor_frame: Frame of the laser in the costmap's source; "" for none.

    Raises:
        ApplrError: There is no link `laser`.
    """
    description = Description({"base": {}, "body": {}, "laser": {}, "topics": {}})
    # From the surest source to the least sure one
    statements = [*controllers, *_drive_plugins(urdf)]
    joints = _wheels(urdf, statements, description.notes)
    _base(urdf, joints, description)
    for stated in statements:
        description.notes += _contradictions(urdf, stated, joints, description.values["base"])
    _body(urdf, joints, footprint, description)
    _masses(urdf, joints, description.hints)
    _laser(urdf, laser, sensor_frame, description)
    return description


def _wheels(urdf: UrdfFile, statements: Sequence[StatedWheels], notes: List[str]) -> List[Any]:
    """Return the joints of the driven wheels, left side first, or none if they are unknown."""
    unstated = StatedWheels("pairs of continuous joints", {})
    origin, sides, *_ = next((stated for stated in statements if stated.sides), unstated)
    missing_names = sorted(set(sides) - set(urdf.joints))
    if sides:
        joints = [urdf.joints[name] for name in sides if name in urdf.joints]
    else:
        joints = [joint for joint in urdf.joints.values() if _turns_alone(urdf, joint)]
    if missing_names:
        problem = f"{origin} names {', '.join(missing_names)}, which {urdf.path} does not have"
    else:
        problem = _why_no_wheels(urdf, joints)
    if problem:
        notes.append(f"driven wheels not identified: {problem}; fill them in")
        return []
    notes.append(f"the driven wheels are {_names_of(joints)}, according to {origin}")
    return sorted(joints, key=lambda joint: -_lateral(urdf, joint))


def _names_of(joints: List[Any]) -> str:
    """Return the names of joints for a message."""
    return ", ".join(joint.name for joint in joints) or "none"


def _lateral(urdf: UrdfFile, joint: Any) -> float:
    """Return the y of a joint's child in the base frame [m], which is positive on the left."""
    return float(urdf.pose(joint.child)[1, 3])


def _drive_plugins(urdf: UrdfFile) -> Iterator[StatedWheels]:
    """Yield what the tags of Gazebo's drive plugins state."""
    for plugin in urdf.xml.iter("plugin"):
        if not _DRIVE_PLUGIN.search(str(plugin.get("filename"))):
            continue
        sides = {}
        for tag in plugin.iter():
            side = _DRIVEN_TAG.match(tag.tag)
            if side:
                names = re.split(r"[\s,]+", (tag.text or "").strip())
                sides.update(dict.fromkeys(filter(None, names), side[1].lower()))
        radius = _number(plugin, "wheelDiameter") / 2
        yield StatedWheels("the drive plugin", sides, radius, _number(plugin, "wheelSeparation"))


def _contradictions(
    urdf: UrdfFile, stated: StatedWheels, joints: List[Any], base: Dict[str, Any]
) -> Iterator[str]:
    """Yield what is stated about the driven wheels otherwise than by their joints and shapes."""
    for joint in joints:
        y = _lateral(urdf, joint)
        side = stated.sides.get(joint.name)
        if side and (side == "left") != (y > 0):
            problem = f"{joint.name} is on the {side}, but at y = {y:.3g} m"
            yield f"{stated.origin}: {problem}: turns are mirrored, exchange left and right there"
    lengths = [("radius of a wheel", stated.radius, base.get("wheel_radius", nan))]
    # The file of a skid_steer base may state how far apart wheels without slip would be.
    if base.get("drive") == "two_wheel":
        lengths.append(("separation of the wheels", stated.separation, base["track"]))
    for name, stated_length, length in lengths:
        if abs(stated_length - length) > SAME_SHARE * length:
            values = f"{stated_length:.3g} m in {stated.origin}, but {length:.3g} m in {urdf.path}"
            yield f"the {name} is {values}: correct the wrong one"


def _turns_alone(urdf: UrdfFile, joint: Any) -> bool:
    """Return whether a joint turns about a lateral axis, below no other continuous joint."""
    if joint.type != "continuous" or not _is_across(urdf, joint):
        return False
    # The wheel of a caster hangs below the caster's swivel, which is continuous, too.
    joints_above = urdf.moving[joint.child][1:]
    return not any(joint_above.type == "continuous" for joint_above in joints_above)


def _is_across(urdf: UrdfFile, joint: Any) -> bool:
    """Return whether a joint's axis is lateral."""
    _, y, _ = urdf.axis(joint)
    return bool(abs(y) > LEAST_ACROSS_COS)


def _is_steered(urdf: UrdfFile, joint: Any) -> bool:
    """Return whether a joint hangs below another one with a vertical axis."""
    for joint_above in urdf.moving[joint.child][1:]:
        _, _, z = urdf.axis(joint_above)
        if abs(z) > LEAST_UPRIGHT_COS:
            return True
    return False


def _why_no_wheels(urdf: UrdfFile, joints: List[Any]) -> str:
    """Return why joints are not two wheels on one axle or four on two axles; "" if they are."""
    sideways = _sideways_name(urdf, joints)
    if sideways:
        return f"{sideways} belongs to a base that also drives sideways, which is not supported"
    wheel_centres = np.empty((len(joints), 3))
    for row, joint in enumerate(joints):
        is_across = joint.type == "continuous" and _is_across(urdf, joint)
        if not is_across or _is_steered(urdf, joint):
            return f"{joint.name} is steered, or not continuous about a lateral axis"
        wheel_centres[row] = urdf.pose(joint.child)[:3, 3]
    # The wheels of both sides, from rear to front, mirror each other.
    wheel_centres = wheel_centres[np.argsort(wheel_centres[:, 0])]
    left_centres = wheel_centres[wheel_centres[:, 1] > 0]
    right_centres = wheel_centres[wheel_centres[:, 1] < 0]
    mirrored_centres = right_centres * [1.0, -1.0, 1.0]
    is_paired = len(left_centres) == len(right_centres) and len(joints) in (2, 4)
    is_paired = is_paired and np.allclose(left_centres, mirrored_centres, atol=SAME_M)
    is_one_axle = len(left_centres) == 2 and np.ptp(left_centres[:, 0]) < SAME_M
    if not is_paired or is_one_axle:
        return f"the candidate joints ({_names_of(joints)}) do not form one or two pairs"
    return ""


def _sideways_name(urdf: UrdfFile, joints: List[Any]) -> str:
    """Return a name that belongs to an omnidirectional base, or ""."""
    # Nothing in a URDF says that a wheel has rollers, but its names do.
    candidate_names = []
    for joint in joints:
        candidate_names += [joint.name, joint.child]
    if len(joints) != 2:  # Two wheels cannot drive sideways, whatever plugins the file has.
        for plugin in urdf.xml.iter("plugin"):
            candidate_names.append(str(plugin.get("filename")))
    return next(filter(_SIDEWAYS.search, candidate_names), "")


def _base(urdf: UrdfFile, joints: List[Any], description: Description) -> None:
    """Fill the section base: kind of the drive, and dimensions of the driven wheels."""
    if not joints:
        return
    wheels = [_wheel(urdf, joint) for joint in joints]
    x, y, z = np.array([wheel.centre for wheel in wheels]).T
    base = description.values["base"]
    wheels_per_side = len(joints) // 2  # The left side comes first.
    base["drive"] = "two_wheel"
    base["track"] = float(y[:wheels_per_side].mean() - y[wheels_per_side:].mean())
    base["axle_height"] = float(z.mean())
    if wheels_per_side == 2:
        base["drive"] = "skid_steer"
        base["wheelbase"] = float(np.ptp(x))
    # Wheels of different sizes are asked for: the model has one radius and one width.
    for field_name in ("radius", "width"):
        sizes = [getattr(wheel, field_name) for wheel in wheels]
        if all(sizes) and np.ptp(sizes) < SAME_M:
            base[f"wheel_{field_name}"] = float(np.mean(sizes))
    centre_x = float(x.mean())
    if abs(centre_x) > SAME_M:
        description.notes.append(
            f"the centre of the wheels is at x = {centre_x:.3f} m in {urdf.base}, but the "
            "simulators place it at the origin: give base.casters and body.com relative to the "
            "centre of the wheels"
        )


class _Wheel(NamedTuple):
    """Radius and width of a wheel, 0 if unknown, and its centre (3,) in the base frame [m]."""

    radius: float
    width: float
    centre: Array


def _wheel(urdf: UrdfFile, joint: Any) -> _Wheel:
    """Return the wheel that turns with a joint, as its collision shapes define it."""
    shapes = []
    collision_count = 0
    for link_name in urdf.parts(joint):
        shapes += urdf.shapes(link_name)
        collision_count += len(urdf.links[link_name].collisions)
    # A mesh that was not found, or a box, says nothing about the radius.
    lowest, highest = _extent(shapes)
    length, width, height = highest - lowest
    is_round = abs(length - height) < 0.1 * height
    if len(shapes) < collision_count or not is_round:
        return _Wheel(radius=0.0, width=0.0, centre=urdf.pose(joint.child)[:3, 3])
    if width >= 0.9 * height:  # A wheel modelled as a sphere has no known width.
        width = 0.0
    return _Wheel(float(height / 2), float(width), (lowest + highest) / 2)


def _extent(shapes: List[Array]) -> Tuple[Array, Array]:
    """Return the smallest and the largest coordinates (3,) of shapes [m]; zeros without shapes."""
    if not shapes:
        return np.zeros(3), np.zeros(3)
    vertices = np.concatenate(shapes)
    return vertices.min(axis=0), vertices.max(axis=0)


def _body(urdf: UrdfFile, joints: List[Any], footprint: Array, description: Description) -> None:
    """Fill the section body with the bounds of the fixed collision shapes above the axles.

    If they reach down to the ground, propose these bounds; if they are unusable, the footprint's
    size. Shapes below the axles, such as casters, are ignored.
    """
    base = description.values["base"]
    body = description.values["body"]
    # Without wheels nothing is above the axles, and the outline is asked for.
    axle_height = base.get("axle_height", inf)
    shapes = []
    for link_name, moving_joints in urdf.moving.items():
        if moving_joints:
            continue
        for shape in urdf.shapes(link_name):
            if shape[:, 2].max() > axle_height:
                shapes.append(shape)
    lowest, highest = _extent(shapes)
    lowest_bottom = axle_height - base.get("wheel_radius", inf) + CLEARANCE_M
    reaches_ground = False
    centre = ((lowest + highest) / 2)[:2].tolist()
    # A box that is too large stops the robot at doors, one that is too small lets it touch.
    if urdf.lost:
        mesh_names = ", ".join(sorted(urdf.lost))
        problem = f"{mesh_names} is missing (put its package beside the package of the URDF)"
    elif not shapes:
        problem = "no fixed collision shapes above the axles are known"
    elif highest[1] - lowest[1] < base["track"] / 2:
        problem = "the fixed collision shapes are narrower than half the track"
    elif lowest[2] < lowest_bottom:
        problem = "the fixed collision shapes reach down to the ground, as casters do"
        reaches_ground = True
    else:
        body["size"] = (highest - lowest).tolist()
        body["centre"] = centre
        body["bottom"] = float(lowest[2])
        if geometry.is_oval(np.concatenate(shapes)[:, :2]):
            body["round"] = True
        for joint in joints:
            for link_name in urdf.parts(joint):
                shapes += urdf.shapes(link_name)
        sizes = check.unlike_sizes(footprint, np.concatenate(shapes)[:, :2])
        if sizes:
            description.notes.append(f"{sizes}: correct the footprint, or body in {FILE}")
        _note_excluded_links(urdf, joints, description.notes)
        return
    description.notes.append(f"outline not identified: {problem}; fill it in")
    if reaches_ground:
        # One mesh of the whole base may include casters.
        origin = "bounds of the fixed collision shapes, which may include casters"
        bottom = round(float(lowest_bottom), 3)
        length, width, _ = (highest - lowest).tolist()
        body["centre"] = centre
        description.hints["body", "size"] = [length, width, float(highest[2]) - bottom], origin
        description.hints["body", "bottom"] = bottom, origin
        _note_excluded_links(urdf, joints, description.notes)
    elif len(footprint):
        body["centre"] = ((footprint.min(axis=0) + footprint.max(axis=0)) / 2).tolist()
        origin = "length and width of the footprint in the parameter files"
        description.hints["body", "size"] = np.ptp(footprint, axis=0).tolist(), origin


def _note_excluded_links(urdf: UrdfFile, joints: List[Any], notes: List[str]) -> None:
    """Add a note about moving links with collision shapes that are no parts of wheels."""
    driven_names = {joint.name for joint in joints}
    excluded_links = []
    for link_name, moving_joints in urdf.moving.items():
        is_wheel = any(joint.name in driven_names for joint in moving_joints)
        if moving_joints and not is_wheel and urdf.links[link_name].collisions:
            excluded_links.append(link_name)
    if excluded_links:
        notes.append(f"the outline excludes moving links: {', '.join(excluded_links)}")


def _masses(urdf: UrdfFile, joints: List[Any], hints: Hints) -> None:
    """Propose the masses in the URDF for a driven wheel and for everything else."""
    body_links = set(urdf.links)
    wheel_masses = []
    for joint in joints:
        wheel_links = urdf.parts(joint)
        wheel_masses.append(urdf.mass(wheel_links))
        body_links -= set(wheel_links)
    if not joints:
        return
    wheels_have_mass = min(wheel_masses) >= LEAST_MASS_KG
    if wheels_have_mass:
        hints["base", "wheel_mass"] = float(np.mean(wheel_masses)), "the wheel's mass in the URDF"

    volumes = {}
    for link_name in sorted(body_links):
        lowest, highest = _extent(urdf.shapes(link_name))
        volumes[link_name] = float(np.prod(highest - lowest))
    largest_link = max(volumes, key=lambda link_name: volumes[link_name])
    body_mass = urdf.mass(body_links)
    # The mass of a part such as the laser alone is not that of the body. A link without a shape may
    # have it, but then the wheels have theirs, because Gazebo drops links without a mass.
    is_complete = wheels_have_mass or urdf.mass([largest_link]) > 0.0
    if body_mass < LEAST_MASS_KG or not is_complete:
        return
    origin = "the sum of the other masses in the URDF"
    missing_links = [name for name in volumes if volumes[name] and not urdf.mass([name])]
    if missing_links:
        origin += f", which has none for {', '.join(missing_links)}"
    hints["body", "mass"] = body_mass, origin


def _laser(urdf: UrdfFile, laser: str, sensor_frame: str, description: Description) -> None:
    """Fill the section laser with its pose, and with the settings of Gazebo's ray sensor.

    By default, the laser is the link `sensor_frame` of the costmap's source, or the link of the
    only ray sensor.
    """
    sensors = _ray_sensors(urdf)
    if laser and laser not in urdf.links:
        advice = (
            did_you_mean(laser, urdf.links) or f"give one of its links{_choices(urdf, sensors)}"
        )
        raise ApplrError(f"{urdf.path} has no link {laser}: {advice}")
    # The user's word comes first, then the costmaps', which drive with this laser.
    link = laser or sensor_frame
    if not link and len(sensors) == 1:
        (link,) = sensors
    values = description.values["laser"]
    if link not in urdf.links:
        problem = "no file names it"
        if link:
            problem = f"{urdf.path} has no link {link}, the sensor_frame of the costmaps"
            values["frame"] = link
        remedy = f"give it with --laser LINK{_choices(urdf, sensors)}"
        if urdf.variables:
            remedy += f", or set {' or '.join(urdf.variables)} as on the robot"
        description.notes.append(f"laser not identified: {problem}; {remedy}")
        return
    pose = urdf.pose(link)
    rotation = pose[:3, :3]
    x, y, z = pose[:3, 3].tolist()
    cos_tilt = rotation[2, 2]
    if abs(cos_tilt) < LEAST_LEVEL_COS:
        problem = f"{link} is tilted, but scans must be level"
        remedy = f"give another link with --laser{_choices(urdf, sensors)}"
        raise ApplrError(f"{urdf.path}: {problem}; {remedy}")
    values["frame"] = link
    values["pose"] = [x, y, atan2(rotation[1, 0], rotation[0, 0])]
    values["height"] = z
    # With several sensors at one link, it is unknown which of them publishes the scans.
    if len(sensors.get(link, [])) == 1:
        values.update(_sensor_values(sensors[link][0], is_upside_down=cos_tilt < 0.0))


def _choices(urdf: UrdfFile, sensors: Iterable[str]) -> str:
    """Return the links with ray sensors, or with names of lasers, in brackets; "" without any."""
    links = list(sensors) or list(filter(_LASER_NAME.search, urdf.links))
    return f" ({', '.join(links)})" if links else ""


def _ray_sensors(urdf: UrdfFile) -> Dict[str, List[Any]]:
    """Return the tags of Gazebo's ray sensors by their links."""
    sensors: Dict[str, List[Any]] = {}
    for gazebo_tag in urdf.xml.findall("gazebo"):
        for sensor in gazebo_tag.findall("sensor"):
            if sensor.get("type") in _RAYS:
                sensors.setdefault(str(gazebo_tag.get("reference")), []).append(sensor)
    return sensors


def _sensor_values(sensor: Any, is_upside_down: bool) -> Dict[str, Any]:
    """Return the values of a ray sensor by field of robot.yaml, without missing ones."""
    numbers = {field_name: _number(sensor, tag) for field_name, tag in _TAGS.items()}
    # Gazebo interpolates between rays: `resolution` times as many ranges are published.
    ranges_per_ray = _number(sensor, ".//horizontal/resolution")
    if isfinite(ranges_per_ray):
        numbers["beams"] *= ranges_per_ray
    if is_upside_down:  # Its angles run clockwise, seen from above.
        first_angle = numbers["first_angle"]
        last_angle = numbers["last_angle"]
        numbers.update(first_angle=-last_angle, last_angle=-first_angle)
    values = {}
    for field_name, number in numbers.items():
        if isfinite(number):
            values[field_name] = int(number) if field_name == "beams" else number
    return values


def _number(sensor: Any, tag: str) -> float:
    """Return the number in a tag of a sensor, or nan if the tag has none."""
    try:
        return float(sensor.findtext(tag) or "nan")
    except ValueError:
        return nan
