"""Schema of robot.yaml: type, limits, unit, default and meaning of each field; class Robot.

folder.py validates with the schema, new_robot.py asks for fields without a known value, and the
reference page of the site lists all fields. Positions are in the robot's base frame, x ahead.
Fields without a default are required.
"""

from __future__ import annotations

import copy
import os
from dataclasses import dataclass, field, replace
from math import pi
from typing import Any, Callable, Dict, NamedTuple, Optional, Tuple

from pydantic import BaseModel, ConfigDict, Field, StrictBool, StrictFloat, model_validator
from typing_extensions import Annotated, Literal

from applr_ros1.common.angles import Pose, transform_point
from applr_ros1.common.errors import ApplrError, did_you_mean, shown
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.declarations import LOCAL_PLANNERS, Server, namespace, servers
from applr_ros1.planner.parameters.layers import COSTMAPS
from applr_ros1.planner.parameters.obstacle_range import seeing
from applr_ros1.planner.parameters.trees import Tree, branch, merged
from applr_ros1.robots.parameter_files import nested, of_move_base, read_yaml

FILE = "robot.yaml"
SENSORS = "sensors.yaml"  # errors of scanners by name, beside this file
SENSORS_PATH = os.path.join(os.path.dirname(os.path.abspath(__file__)), SENSORS)
PATH = "[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*"
Name = Annotated[str, Field(pattern=f"^/?{PATH}$")]  # name of a topic
Frame = Annotated[
    str, Field(pattern=r"^/?[A-Za-z0-9_][A-Za-z0-9_.:-]*(/[A-Za-z0-9_.:-]+)*$")
]  # frame in tf2
Length = Annotated[StrictFloat, Field(ge=0.01, le=10.0)]
Place = Annotated[StrictFloat, Field(ge=-10.0, le=10.0)]
Inertia = Annotated[StrictFloat, Field(ge=1e-9, le=1e5)]
Speed = Annotated[StrictFloat, Field(ge=0.0, le=2.0)]
Length3 = Tuple[Length, Length, Length]
Place2 = Tuple[Place, Place]
Place3 = Tuple[Place, Place, Place]
Inertia3 = Tuple[Inertia, Inertia, Inertia]
Ground = Literal["plain", "gazebo"]
WORLD_SCALES = (0.05, 20.0)  # range of the size of a robot's worlds relative to the Jackal's


class Section(BaseModel):
    """A mapping in robot.yaml, whose keys are the fields of the derived class."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _is_known(cls, content: Any) -> Any:
        """Raise ValueError for an unknown key, with the name that may have been meant."""
        if not isinstance(content, dict):
            return content  # pydantic's own error follows.
        for name in content:
            if name not in cls.model_fields:
                names = ", ".join(cls.model_fields)
                advice = did_you_mean(name, cls.model_fields) or f"give one of {names}"
                raise ValueError(f"{name} is unknown: {advice}")
        return content


def real(unit: str, low: float, high: float, about: str, default: Any = ...) -> Any:
    """Return a field for a finite number from low to high in a unit ("" for none)."""
    return Field(
        default, ge=low, le=high, strict=True, description=about, json_schema_extra={"unit": unit}
    )


def value(unit: str, about: str, default: Any = ..., **bounds: Any) -> Any:
    """Return a field for a list, a text or a count, with the bounds of pydantic.Field."""
    return Field(default, description=about, json_schema_extra={"unit": unit}, **bounds)


class Base(Section):
    """Wheels, their positions, and the limits of the base's controller."""

    drive: Literal["skid_steer", "two_wheel"] = value(
        "",
        "skid_steer (four wheels, coupled on each side) or two_wheel (two driven wheels on the "
        "base frame's y axis, and casters)",
    )
    max_speed: float = real("m/s", 0.01, 20.0, "largest speed that the base's controller allows")
    max_yaw_rate: float = real("rad/s", 0.01, 20.0, "largest yaw rate that the controller allows")
    max_acceleration: float = real(
        "m/s^2", 0.01, 100.0, "largest acceleration that the controller allows"
    )
    max_yaw_acceleration: float = real(
        "rad/s^2", 0.01, 200.0, "largest yaw acceleration that the controller allows"
    )
    wheel_radius: float = real("m", 0.005, 2.0, "radius of a driven wheel")
    wheel_width: float = real("m", 0.001, 2.0, "width of a driven wheel")
    track: float = real("m", 0.01, 10.0, "distance between the centres of left and right wheels")
    axle_height: float = real("m", -2.0, 2.0, "height of the axles above the base frame")
    wheelbase: float = real(
        "m", 0.0, 10.0, "distance between front and rear axle, 0 for two_wheel", 0.0
    )
    wheel_mass: float = real("kg", 0.001, 500.0, "mass of one driven wheel", 0.5)
    wheel_inertia: Optional[Inertia3] = value(
        "kg m^2",
        "moments of inertia of a wheel about x, y (the axle), z; by default of a solid cylinder",
        None,
    )
    wheel_friction: float = real(
        "", 0.01, 3.0, "Coulomb coefficient of a driven wheel on the ground", 0.5
    )
    casters: Tuple[Place2, ...] = value(
        "m",
        "contact points [[x, y], ...] of casters with the ground, which carry only what the driven "
        "wheels cannot",
        (),
        max_length=8,
    )
    caster_friction: float = real(
        "", 0.0, 3.0, "Coulomb coefficient of a caster on the ground", 0.1
    )
    command_timeout: float = real(
        "s",
        0.0,
        60.0,
        "time without a command after which the base stops; 0 if it never stops",
        0.0,
    )
    dead_band: Tuple[Speed, Speed] = value(
        "m/s, rad/s",
        "[v, w]: a smaller commanded speed or turn rate counts as 0",
        (0.0, 0.0),
    )

    @property
    def wheels(self) -> int:
        """Number of driven wheels."""
        return 4 if self.drive == "skid_steer" else 2


class Body(Section):
    """Box around everything except the wheels, for contacts with obstacles."""

    size: Length3 = value(
        "m", "[length, width, height] of the box around everything except the wheels"
    )
    mass: float = real("kg", 0.01, 5000.0, "mass of everything except the driven wheels")
    centre: Place2 = value("m", "centre of the box along x and y", (0.0, 0.0))
    bottom: float = real(
        "m", -2.0, 2.0, "height of the underside of the box above the base frame", 0.0
    )
    round: bool = value(
        "", "whether the body is an upright cylinder, round or oval, that fills the box", False
    )
    com: Optional[Place3] = value(
        "m", "centre of mass of the body, by default the centre of the box", None
    )
    inertia: Optional[Inertia3] = value(
        "kg m^2",
        "moments of inertia about x, y, z through the centre of mass; by default of a solid box",
        None,
    )
    friction: float = real("", 0.01, 3.0, "Coulomb coefficient against obstacles", 0.5)

    @property
    def centre_of_mass(self) -> Tuple[float, float, float]:
        """`com`, or the centre of the box."""
        return self.com or (*self.centre, self.bottom + self.size[2] / 2)


class Laser(Section):
    """Planar laser scanner, whose beams are evenly spaced between two angles."""

    frame: Frame = value("", "tf frame of the scans")
    pose: Place3 = value("m, m, rad", "[x, y, yaw] of the scanner in the base frame")
    height: float = real("m", -2.0, 5.0, "height of the scanner above the base frame")
    beams: int = value("", "number of ranges in a scan", ge=2, le=8192, strict=True)
    first_angle: float = real("rad", -6.2832, 6.2832, "angle_min of the scans")
    last_angle: float = real("rad", -6.2832, 6.2832, "angle_max of the scans")
    range_min: float = real("m", 0.0, 10.0, "range_min of the scans")
    range_max: float = real("m", 0.1, 200.0, "range_max of the scans")
    rate: float = real("Hz", 0.5, 200.0, "scans per second")
    sensor: Optional[str] = value(
        "", f"scanner of {SENSORS} whose errors the simulators use for the fields below", None
    )
    noise: float = real("m", 0.0, 1.0, "standard deviation of a range", 0.0)
    range_noise: float = real(
        "", 0.0, 0.2, "further standard deviation of a range, per metre of range", 0.0
    )
    incidence_error: float = real(
        "m",
        -0.2,
        0.2,
        "error of a range at normal incidence, which vanishes within 20 degrees",
        0.0,
    )
    dark: float = real("", 0.0, 1.0, "share of surfaces that are dark or glossy", 0.0)
    dropouts: float = real(
        "", 0.0, 1.0, "share of the ranges on dark or glossy surfaces without a return", 0.0
    )
    mixed: float = real(
        "",
        0.0,
        1.0,
        "share of the edges of near surfaces at which a range lies behind the edge",
        0.0,
    )
    gaps: float = real("", 0.0, 0.9, "share of scans that are missing", 0.0)
    stamp_delay: float = real("s", 0.0, 1.0, "time from the measurement to the scan's stamp", 0.0)
    no_return: Optional[float] = real(
        "m",
        0.0,
        1000.0,
        "range that the driver publishes without a return, such as 0.0, if this is not +inf",
        None,
    )

    @model_validator(mode="before")
    @classmethod
    def _with_sensor(cls, content: Any) -> Any:
        """Add the errors of the named scanner, except those that the file gives itself."""
        name = content.get("sensor") if isinstance(content, dict) else None
        if name is None:
            return content
        sensors = read_yaml(SENSORS_PATH)
        if name not in sensors:
            raise ValueError(f"sensor is {shown(name)}: give one of {', '.join(sensors)}")
        return {**sensors[name], **content}

    @property
    def fan(self) -> Tuple[float, float, float, float]:
        """Angles and limits of its scans (drive.Scans.fan)."""
        return self.first_angle, self.increment, self.range_min, self.range_max

    @property
    def has_errors(self) -> bool:
        """Whether scans have other errors than white noise."""
        return bool(
            self.range_noise
            or self.incidence_error
            or self.dropouts
            or self.mixed
            or self.gaps
            or self.stamp_delay
        )

    @property
    def increment(self) -> float:
        """Angle from one beam to the next [rad]."""
        return (self.last_angle - self.first_angle) / (self.beams - 1)

    @property
    def view(self) -> Tuple[float, float]:
        """Directions of the first and the last beam in the base frame [rad]."""
        return self.first_angle + self.pose[2], self.last_angle + self.pose[2]

    @property
    def covers_full_turn(self) -> bool:
        """True if the last beam is next to the first one, up to half a beam."""
        return self.view[1] - self.view[0] + 1.5 * self.increment >= 2.0 * pi

    def pose_for(self, base: Pose) -> Pose:
        """Return the pose (x, y, yaw) of the scanner if the base frame is at a pose."""
        x_in_base, y_in_base, yaw_in_base = self.pose
        x, y = transform_point(base, x_in_base, y_in_base)
        return x, y, base[2] + yaw_in_base

    def period_in(self, cycle: float) -> float:
        """Return the time between two scans [s]; 0 if every control cycle has one.

        cycle: Period of the control cycles [s].
        """
        return 1.0 / self.rate if self.rate * cycle < 1.0 else 0.0


class Topics(Section):
    """Topics that the robot publishes and subscribes to, relative to its namespace."""

    scan: Name = "scan"
    more_scans: Tuple[Name, ...] = value(
        "", "topics of further lasers, whose scans the collision monitor uses as well", ()
    )
    odometry: Name = "odom"
    cmd_vel: Name = "cmd_vel"
    imu: Name = "imu"


class Frames(Section):
    """Names of tf frames."""

    base: Frame
    odom: Frame = "odom"
    map: Frame = "map"
    matched: Frame = value("", "frame of the collision monitor's matched poses", "matched")


class OdometryErrors(Section):
    """Errors of the odometry: distance from the wheels, heading from the IMU."""

    rate: float = real("Hz", 1.0, 240.0, "rate of the messages", 50.0)
    scale_error: float = real(
        "", 0.0, 0.5, "standard deviation of the scale of distances, drawn at each start", 0.005
    )
    heading_drift: float = real(
        "rad", 0.0, 1.0, "standard deviation of the heading's slow error", 0.002
    )
    heading_time: float = real("s", 0.1, 1e4, "correlation time of the heading's slow error", 60.0)
    heading_noise: float = real(
        "rad", 0.0, 1.0, "standard deviation of the white noise of the heading", 0.003
    )
    speed_noise: float = real(
        "m/s", 0.0, 1.0, "standard deviation of the speed in the messages", 0.005
    )
    gyro_noise: float = real("rad/s", 0.0, 1.0, "standard deviation of the IMU's yaw rate", 0.005)
    accelerometer_noise: float = real(
        "m/s^2", 0.0, 5.0, "standard deviation of the IMU's acceleration", 0.005
    )
    lag: float = real("s", 0.0, 1.0, "time constant of the filter that fuses wheels and IMU", 0.0)


class Monitoring(Section):
    """Settings of the collision monitor; see MonitorSettings."""

    margin: float = real("m", 0.0, 1.0, "distance kept from every obstacle point", 0.03)
    reaction_time: float = real(
        "s", 0.01, 2.0, "delay from a command until the base follows the next command", 0.15
    )
    creep_speed: float = real(
        "m/s", 0.0, 1.0, "largest speed of any point of the robot in unobserved space", 0.1
    )
    deceleration: float = real(
        "m/s^2", 0.01, 100.0, "deceleration of the braking base, at most max_acceleration", 4.0
    )
    yaw_deceleration: float = real(
        "rad/s^2",
        0.01,
        200.0,
        "yaw deceleration of the braking base, at most max_yaw_acceleration",
        12.0,
    )
    turn_gain: float = real(
        "", 0.5, 3.0, "largest ratio of the yaw rate to the commanded yaw rate", 1.0
    )
    turn_ahead: float = real(
        "m", -2.0, 2.0, "distance of the centre of rotation ahead of base_link", 0.0
    )
    mover_acceleration: float = real(
        "m/s^2", 0.0, 20.0, "largest acceleration of a tracked moving obstacle", 1.0
    )
    passive_safety: bool = value(
        "", "whether the robot stands before a tracked moving obstacle touches it", True
    )


class Simulation(Section):
    """Parameters of both simulators, assumed or fitted instead of measured on the robot.

    With ground `plain`, friction opposes the slip of a tyre. Ground `gazebo` reproduces the
    friction of the Jackal in Gazebo: in a turn, a wheel runs track_multiplier times as fast as
    without slip, and stands on both edges of its rim.
    """

    grip_limit: float = real(
        "m/s^2",
        0.05,
        50.0,
        "friction limit: largest lateral acceleration v w of a curve on plain ground",
    )
    ground: Ground = value("", "friction model of the ground", "plain")
    track_multiplier: Optional[float] = real(
        "", 0.5, 5.0, "track multiplier of the wheels' controller, for ground gazebo", None
    )
    edge_shift: float = real(
        "s^2/m",
        0.0,
        2.0,
        "share of a wheel's load that moves to the outer edge per lateral acceleration",
        0.0,
    )
    command_delay: float = real("s", 0.0, 1.0, "delay from a command to the wheels", 0.0)
    tyre_creep: float = real(
        "m/s", 1e-4, 0.5, "slip speed at which a tyre has .7 of its full friction", 0.02
    )
    grip_noise: float = real(
        "", 0.0, 1.0, "relative standard deviation of a wheel's friction, for uneven ground", 0.10
    )
    grip_time: float = real("s", 0.01, 60.0, "correlation time of grip_noise", 0.5)
    wheel_noise: float = real(
        "", 0.0, 0.5, "relative standard deviation of each side's speed", 0.005
    )
    wheel_time: float = real("s", 0.01, 60.0, "correlation time of wheel_noise", 0.5)
    wheel_shake: float = real(
        "m/s", 0.0, 0.5, "standard deviation of each side's speed while the robot moves", 0.01
    )
    ground_stiffness: float = real("N/m", 100.0, 1e7, "stiffness of one tyre", 3.0e4)
    ground_damping: float = real("N s/m", 1.0, 1e5, "damping of one tyre", 400.0)
    motor_torque: float = real(
        "N m", 0.01, 1000.0, "largest torque of one wheel against obstacles", 10.0
    )
    full_lift: float = real(
        "m", 1e-4, 0.5, "height above the ground at which a wheel has no more friction", 0.005
    )
    wheel_rub: float = real(
        "", 0.0, 1.0, "kinematic simulator: friction of a wheel along an obstacle", 0.66
    )
    body_rub: float = real(
        "", 0.0, 1.0, "kinematic simulator: friction of the body along an obstacle", 0.94
    )
    undo: float = real(
        "", 0.02, 1.0, "kinematic simulator: share of an overlap that is resolved in a step", 0.51
    )


Bound = Annotated[StrictFloat, Field(ge=-1e6, le=1e6)]
ParameterName = Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_]*$")]
ValueName = Annotated[str, Field(pattern=f"^{PATH}$")]


class Target(Section):
    """Address of one dynamic_reconfigure value of move_base that follows a parameter of the space.

    Attributes:
        server: Server below move_base, such as DWAPlannerROS; "" is move_base itself.
        name: Name of the value, by default that of the parameter.
        aliases: Names in other versions of the server (path_distance_bias was pdist_scale before).
        negated: Whether the value has the opposite sign.
    """

    server: Annotated[str, Field(pattern=f"^({PATH})?$")]
    name: ValueName
    aliases: Tuple[ValueName, ...] = ()
    negated: StrictBool = False

    @property
    def names(self) -> Tuple[str, ...]:
        """Accepted names, the latest first."""
        return (self.name, *self.aliases)

    def signed(self, number: Any) -> Any:
        """Convert a parameter's number, or an array, to the value at this address, or back."""
        return -number if self.negated else number

    def value_in(self, tree: Tree) -> Any:
        """Return the value at this address in a complete tree (check.complete), or None."""
        return branch(tree, self.server).get(self.name)


class SpaceParameter(Section):
    """One parameter that a policy or a search sets within its range.

    Attributes:
        name: Key of the parameter in the file.
        sets: Values of servers that follow the parameter. The parameter is read back from the first
            one.
        paper: Whether policies in the paper's encoding observe and set the parameter.
    """

    name: ParameterName
    range: Tuple[Bound, Bound]
    sets: Tuple[Target, ...] = Field(min_length=1)
    integer: StrictBool = False
    paper: StrictBool = True

    @property
    def low(self) -> float:
        """Smallest value."""
        return self.range[0]

    @property
    def high(self) -> float:
        """Largest value."""
        return self.range[1]

    @model_validator(mode="after")
    def _agrees(self) -> SpaceParameter:
        """Raise ValueError for a range without values, or one that its integers do not fit."""
        lowest, highest = self.range
        if not lowest < highest:
            raise ValueError(
                f"range is [{lowest:g}, {highest:g}]: give a smaller number and a larger one"
            )
        if self.integer and not (lowest.is_integer() and highest.is_integer()):
            raise ValueError(
                f"range is [{lowest:g}, {highest:g}]: give whole numbers for an integer"
            )
        if self.sets[0].negated:
            raise ValueError(
                "sets[0] is negated: first give a value with the sign of the parameter"
            )
        return self


class ParameterFile(Section):
    """Path of a parameter file in the robot's folder, and namespace of its parameters."""

    file: str
    namespace: Annotated[str, Field(pattern=f"^(/?{PATH})?$")] = ""

    def loaded(self, folder: str) -> Tree:
        """Return the nested parameters of the file in a folder.

        Raise ApplrError if it cannot be read.
        """
        path = os.path.join(folder, self.file)
        file_parameters = of_move_base(nested(path), path)
        tree: Tree = {}
        branch(tree, self.namespace, create=True).update(file_parameters)
        return tree


class FileGroup(Section):
    """Files in the order of loading, and parameters loaded after them.

    Later values override earlier ones.
    """

    files: Tuple[ParameterFile, ...] = ()
    parameters: Tree = {}

    def loaded_over(self, tree: Tree, folder: str) -> Tree:
        """Return `tree` with the parameters of this group, read from `folder`, on top."""
        for parameter_file in self.files:
            tree = merged(tree, parameter_file.loaded(folder))
        return merged(tree, self.parameters)


class MoveBaseSection(FileGroup):
    """Files that are always loaded, and files loaded after them with or without a map."""

    with_map: Optional[FileGroup] = None
    without_map: FileGroup = FileGroup()

    def loaded(self, folder: str) -> MoveBaseSetup:
        """Return the parameters of the section's files in a folder."""
        always = self.loaded_over({}, folder)
        without_map = self.without_map.loaded_over(always, folder)
        if self.with_map is None:
            return MoveBaseSetup(without_map)
        return MoveBaseSetup(without_map, self.with_map.loaded_over(always, folder))


class RobotFile(Section):
    """Content of robot.yaml."""

    base: Base
    body: Body
    laser: Laser
    frames: Frames
    simulation: Simulation
    move_base: MoveBaseSection
    topics: Topics = Topics()
    odometry: OdometryErrors = OdometryErrors()
    monitor: Monitoring = Monitoring()
    world_scale: float = real(
        "", *WORLD_SCALES, "size of the robot's worlds relative to the Jackal's"
    )
    parameter_space: Optional[Dict[ParameterName, SpaceParameter]] = None

    @classmethod
    def _is_section(cls, name: str) -> bool:
        """Return whether the entry of this name holds a section."""
        entry = cls.model_fields.get(name)
        kind = None if entry is None else entry.annotation
        return isinstance(kind, type) and issubclass(kind, Section)

    @model_validator(mode="before")
    @classmethod
    def _named(cls, content: Any) -> Any:
        """Empty what has no value, and name parameters of the space and targets by their keys."""
        filled = {}
        for name, value in content.items():
            if value is not None:
                filled[name] = value
            elif cls._is_section(name):
                # Each field that a section without values lacks is then reported by its name.
                filled[name] = {}
        content = filled
        space = content.get("parameter_space", {})
        parameters = space.items() if isinstance(space, dict) else ()
        for name, parameter in parameters:
            if not isinstance(parameter, dict):
                raise ValueError(
                    f"parameter_space.{name} is {shown(parameter)}: give range and sets"
                )
            parameter["name"] = name
            for target in parameter.get("sets") or ():
                if isinstance(target, dict):
                    target.setdefault("name", name)
        return content


class MoveBaseSetup(NamedTuple):
    """Nested move_base parameters of a robot, as its launch file loads them."""

    without_map: Tree
    with_map: Optional[Tree] = None  # None if robot.yaml describes no setup with a map

    def changed(self, change_of: Callable[[Tree], Tree]) -> MoveBaseSetup:
        """Return the set-up with the change merged into each tree that `change_of` gives for it."""
        without_map = merged(self.without_map, change_of(self.without_map))
        if self.with_map is None:
            return MoveBaseSetup(without_map)
        return MoveBaseSetup(without_map, merged(self.with_map, change_of(self.with_map)))


@dataclass(frozen=True)
class Robot:
    """Robot described by a folder of the same name.

    Its fields are those of RobotFile, and `uses_map`: whether it drives with its parameters for a
    map, and `is_running`: whether these were read from a running move_base
    (driven_parameters).
    """

    name: str
    folder: str
    base: Base
    body: Body
    laser: Laser
    topics: Topics
    frames: Frames
    odometry: OdometryErrors
    monitor: Monitoring
    simulation: Simulation
    world_scale: float
    space: Tuple[SpaceParameter, ...]
    move_base: MoveBaseSetup = field(repr=False, hash=False)  # Dicts have no hash.
    uses_map: bool = False
    is_running: bool = field(default=False, repr=False)

    def on_map(self) -> Robot:
        """Return the robot with its parameters for driving on a map in use.

        Raise ApplrError if there are none.
        """
        if self.move_base.with_map is None:
            problem = "robot.yaml has no move_base.with_map"
            raise ApplrError(f"robot {self.name}: {problem}: give its files for a map")
        return replace(self, uses_map=True)

    def in_matched_frame(self) -> Robot:
        """Return the robot that drives without a map in the frame of the monitor's matched poses.

        On a map, or in another frame than the odometry's, localisation corrects the odometry: the
        robot stays as it is.
        """
        parameters = self.all_parameters()
        costmap_frames = {parameters[costmap]["global_frame"].lstrip("/") for costmap in COSTMAPS}
        if costmap_frames != {self.frames.odom.lstrip("/")}:
            return self
        change = {costmap: {"global_frame": self.frames.matched} for costmap in COSTMAPS}
        without_map = merged(self.move_base.without_map, change)
        return replace(self, move_base=self.move_base._replace(without_map=without_map))

    @property
    def _tree_in_use(self) -> Tree:
        """Nested move_base parameters with which the robot drives."""
        without_map, with_map = self.move_base
        if self.uses_map and with_map is not None:
            return with_map
        return without_map

    @property
    def local_planner(self) -> str:
        """Local planner named by the files, without its package."""
        return namespace(str(self._tree_in_use.get("base_local_planner", LOCAL_PLANNERS[0])))

    @property
    def goal_tolerance(self) -> float:
        """Distance from a goal [m] within which the planner considers the position reached."""
        return float(self.all_parameters()[self.local_planner]["xy_goal_tolerance"])

    def parameters(self) -> Tree:
        """Return a copy of the move_base parameters in use (on_map)."""
        # A copy, because a caller may change it, and robots are shared by all.
        return copy.deepcopy(self._tree_in_use)

    def driven_parameters(self) -> Tree:
        """Return a copy of the parameters in use with which a planner of this package drives.

        Its distance biases are per costmap cell, unless a running move_base said otherwise.
        """
        parameters = self.parameters()
        if not self.is_running:
            branch(parameters, namespace(LOCAL_PLANNERS[0]), create=True)["meter_scoring"] = False
        return parameters

    def with_parameters(self, tree: Tree, name: str) -> Robot:
        """Return the robot under another name, with parameters that override its files."""
        return replace(self, name=name, move_base=self.move_base.changed(lambda _: tree))

    def seeing(self, obstacle_range: Optional[float]) -> Robot:
        """Return the robot whose costmaps mark obstacles up to a range [m], itself for None."""
        if obstacle_range is None:
            return self
        move_base = self.move_base.changed(lambda tree: seeing(tree, obstacle_range))
        return replace(self, move_base=move_base)

    @property
    def servers(self) -> Dict[str, Server]:
        """Declarations of all parameters that reconfigure changes, by server of move_base."""
        return servers(self.all_parameters())

    def all_parameters(self) -> Tree:
        """Return a copy of the parameters in use, with all defaults filled in."""
        return complete(self.parameters())


def number_at(tree: Tree, server: str, names: Tuple[str, ...]) -> Optional[float]:
    """Return a server's number under the first of `names` in a parameter tree, or None."""
    # YAML's true and false are numbers in Python.
    section = branch(tree, server)
    for name in names:
        value = section.get(name)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            return float(value)
    return None
