"""The schema of robot.yaml, each field once with type, limits, unit, default and sentence, and the Robot made of it.

folder.py fills it, new_robot.py asks for fields that other files leave out, the site's reference page lists them.
Positions are in the robot's base frame, x ahead. Fields without a default have to be given.
"""

from __future__ import annotations

import copy
import os
from dataclasses import dataclass, field, replace
from typing import Any, Dict, NamedTuple, Optional, Tuple

from pydantic import BaseModel, ConfigDict, Field, StrictBool, StrictFloat, model_validator
from typing_extensions import Annotated, Literal

from applr_ros1.common.errors import ApplrError, did_you_mean
from applr_ros1.common.trees import branch, merged
from applr_ros1.planner.parameters.check import complete
from applr_ros1.robots.parameter_files import read_parameters

FILE = "robot.yaml"
PATH = "[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*"
Name = Annotated[str, Field(pattern=f"^/?{PATH}$")]  # of a topic
Frame = Annotated[str, Field(pattern=r"^/?[A-Za-z0-9_][A-Za-z0-9_.:-]*(/[A-Za-z0-9_.:-]+)*$")]  # in tf2
Length = Annotated[StrictFloat, Field(ge=0.01, le=10.0)]
Place = Annotated[StrictFloat, Field(ge=-10.0, le=10.0)]
Inertia = Annotated[StrictFloat, Field(ge=1e-9, le=1e5)]
Length3 = Tuple[Length, Length, Length]
Place2 = Tuple[Place, Place]
Place3 = Tuple[Place, Place, Place]
Inertia3 = Tuple[Inertia, Inertia, Inertia]
Ground = Literal["plain", "gazebo"]


class Section(BaseModel):
    """A mapping in robot.yaml: its names are the fields of the derived class."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _is_known(cls, content: Any) -> Any:
        for name in content if isinstance(content, dict) else ():
            if name not in cls.model_fields:
                advice = did_you_mean(name, cls.model_fields) or "give one of " + ", ".join(cls.model_fields)
                raise ValueError(f"{name} is unknown: {advice}")
        return content


def real(unit: str, low: float, high: float, about: str, default: Any = ...) -> Any:
    """A field that holds a finite number from low to high, in this unit ("" for none)."""
    return Field(default, ge=low, le=high, strict=True, description=about, json_schema_extra={"unit": unit})


def value(unit: str, about: str, default: Any = ..., **bounds: Any) -> Any:
    """A field that holds a list, a text or a count; bounds as pydantic.Field takes them."""
    return Field(default, description=about, json_schema_extra={"unit": unit}, **bounds)


class Base(Section):
    """Wheels, their positions, and what the base's controller allows."""

    drive: Literal["skid_steer", "two_wheel"] = value(
        "",
        "skid_steer (four wheels, the two of a side turn together) or two_wheel (two driven wheels on the base frame's "
        "y axis, and casters)",
    )
    max_speed: float = real("m/s", 0.01, 20.0, "largest speed that the base's controller allows")
    max_yaw_rate: float = real("rad/s", 0.01, 20.0, "largest turn rate that it allows")
    max_acceleration: float = real("m/s^2", 0.01, 100.0, "largest acceleration that it allows")
    max_yaw_acceleration: float = real("rad/s^2", 0.01, 200.0, "largest angular acceleration that it allows")
    wheel_radius: float = real("m", 0.005, 2.0, "radius of a driven wheel")
    wheel_width: float = real("m", 0.001, 2.0, "width of a driven wheel")
    track: float = real("m", 0.01, 10.0, "distance between the middles of left and right wheels")
    axle_height: float = real("m", -2.0, 2.0, "of the axles above the base frame")
    wheelbase: float = real("m", 0.0, 10.0, "between front and rear axle, 0 for two_wheel", 0.0)
    wheel_mass: float = real("kg", 0.001, 500.0, "of one driven wheel", 0.5)
    wheel_inertia: Optional[Inertia3] = value(
        "kg m^2", "about x, y (the axle), z; without it that of a full cylinder", None
    )
    wheel_friction: float = real("", 0.01, 3.0, "Coulomb coefficient of a driven wheel on the ground", 0.5)
    casters: Tuple[Place2, ...] = value(
        "m", "[[x, y], ...], where the base stands on the ground beside its wheels", (), max_length=8
    )
    caster_friction: float = real("", 0.0, 3.0, "Coulomb coefficient of a caster on the ground", 0.1)
    command_timeout: float = real(
        "s", 0.0, 60.0, "the base stops when no command has come for this long; 0 where it never does", 0.0
    )

    @property
    def wheels(self) -> int:
        """Number of driven wheels."""
        return 4 if self.drive == "skid_steer" else 2


class Body(Section):
    """The box that meets obstacles beside the wheels."""

    size: Length3 = value("m", "[length, width, height] of the box around all but the wheels")
    mass: float = real("kg", 0.01, 5000.0, "of all but the driven wheels")
    centre: Place2 = value("m", "of the box, along x and y", (0.0, 0.0))
    bottom: float = real("m", -2.0, 2.0, "its underside above the base frame", 0.0)
    round: bool = value("", "whether it is an upright cylinder, round or oval, that fills the box", False)
    com: Optional[Place3] = value("m", "centre of mass; without it the middle of the box", None)
    inertia: Optional[Inertia3] = value(
        "kg m^2", "about x, y, z through the centre of mass; without it that of the full box", None
    )
    friction: float = real("", 0.01, 3.0, "Coulomb coefficient against obstacles", 0.5)

    @property
    def centre_of_mass(self) -> Tuple[float, float, float]:
        """`com`, or the middle of the box."""
        return self.com or (*self.centre, self.bottom + self.size[2] / 2)


class Laser(Section):
    """A planar scanner, whose beams are evenly spread between both angles."""

    frame: Frame = value("", "frame of its scans in tf")
    pose: Place3 = value("m, m, rad", "[x, y, yaw] of the scanner in the base frame")
    height: float = real("m", -2.0, 5.0, "of the scanner above the base frame")
    beams: int = value("", "number of ranges in a scan", ge=2, le=8192, strict=True)
    first_angle: float = real("rad", -6.2832, 6.2832, "angle_min of the scans")
    last_angle: float = real("rad", -6.2832, 6.2832, "angle_max of the scans")
    range_min: float = real("m", 0.0, 10.0, "range_min of the scans")
    range_max: float = real("m", 0.1, 200.0, "range_max of the scans")
    rate: float = real("Hz", 0.5, 200.0, "scans per second")
    noise: float = real("m", 0.0, 1.0, "standard deviation of a range", 0.0)
    no_return: Optional[float] = real(
        "m", 0.0, 1000.0, "what its driver states where nothing returns, if that is not +inf, such as 0.0", None
    )

    @property
    def increment(self) -> float:
        """Angle from one beam to the next [rad]."""
        return (self.last_angle - self.first_angle) / (self.beams - 1)

    def period_in(self, cycle: float) -> float:
        """Time between two scans [s] where there is at most one in each cycle of `cycle` [s]; 0: one in every cycle."""
        return 1.0 / self.rate if self.rate * cycle < 1.0 else 0.0


class Topics(Section):
    """Names that the robot publishes and listens on, relative to its namespace."""

    scan: Name = "scan"
    more_scans: Tuple[Name, ...] = value("", "of further lasers, whose scans the collision monitor takes, too", ())
    odometry: Name = "odom"
    cmd_vel: Name = "cmd_vel"
    imu: Name = "imu"


class Frames(Section):
    """Names of frames in tf."""

    base: Frame
    odom: Frame = "odom"
    map: Frame = "map"


class OdometryErrors(Section):
    """Errors of the odometry: wheels for the distance, IMU for the heading."""

    rate: float = real("Hz", 1.0, 240.0, "of the messages", 50.0)
    scale_error: float = real("", 0.0, 0.5, "standard deviation of the wheels' scale, drawn at a start", 0.005)
    heading_drift: float = real("rad", 0.0, 1.0, "standard deviation of the heading's slow error", 0.002)
    heading_time: float = real("s", 0.1, 1e4, "correlation time of the heading's slow error", 60.0)
    heading_noise: float = real("rad", 0.0, 1.0, "what changes from one heading to the next", 0.003)
    speed_noise: float = real("m/s", 0.0, 1.0, "standard deviation of the speed given with the pose", 0.005)
    gyro_noise: float = real("rad/s", 0.0, 1.0, "standard deviation of the IMU's turn rate", 0.005)
    accelerometer_noise: float = real("m/s^2", 0.0, 5.0, "standard deviation of the IMU's acceleration", 0.005)
    lag: float = real("s", 0.0, 1.0, "time constant of the filter that joins wheels and IMU", 0.0)


class Monitoring(Section):
    """Numbers that the collision monitor relies on; see MonitorSettings."""

    margin: float = real("m", 0.0, 1.0, "distance kept from every obstacle point", 0.03)
    reaction_time: float = real("s", 0.01, 2.0, "from a command until the base follows the next one", 0.15)
    creep_speed: float = real("m/s", 0.0, 1.0, "fastest speed of any point in space that no scan has shown", 0.1)
    deceleration: float = real("m/s^2", 0.01, 100.0, "how hard the base brakes, at most max_acceleration", 4.0)
    yaw_deceleration: float = real(
        "rad/s^2", 0.01, 200.0, "how hard it ends a turn, at most max_yaw_acceleration", 12.0
    )
    turn_gain: float = real("", 0.5, 3.0, "how many times as fast as commanded the base may turn", 1.0)
    turn_ahead: float = real("m", -2.0, 2.0, "how far ahead of base_link the point lies about which it turns", 0.0)


class Simulation(Section):
    """Numbers of both simulators that are chosen or fitted, not measured on the robot.

    On plain ground tyres pull against their slip. On ground gazebo, with the friction of Gazebo's Jackal, a wheel turns
    track_multiplier times as fast for a turn as its track says and stands on both edges of its rim.
    """

    grip_limit: float = real("m/s^2", 0.05, 50.0, "on plain ground the tyres hold curves up to this v w")
    ground: Ground = value("", "plain or gazebo", "plain")
    track_multiplier: Optional[float] = real("", 0.5, 5.0, "that of the wheels' controller, on ground gazebo", None)
    edge_shift: float = real(
        "s^2/m", 0.0, 2.0, "share of a wheel's load that the outer edge has more per lateral acceleration", 0.0
    )
    command_delay: float = real("s", 0.0, 1.0, "from a command to the wheels", 0.0)
    tyre_creep: float = real("m/s", 1e-4, 0.5, "slip speed at which a tyre has .7 of its full friction", 0.02)
    grip_noise: float = real("", 0.0, 1.0, "uneven ground: relative standard deviation of a wheel's friction", 0.10)
    grip_time: float = real("s", 0.01, 60.0, "its correlation time", 0.5)
    wheel_noise: float = real("", 0.0, 0.5, "relative standard deviation of each side's speed", 0.005)
    wheel_time: float = real("s", 0.01, 60.0, "its correlation time", 0.5)
    wheel_shake: float = real("m/s", 0.0, 0.5, "absolute deviation of each side's speed while it moves", 0.01)
    ground_stiffness: float = real("N/m", 100.0, 1e7, "of one tyre", 3.0e4)
    ground_damping: float = real("N s/m", 1.0, 1e5, "of one tyre", 400.0)
    motor_torque: float = real("N m", 0.01, 1000.0, "of one wheel against obstacles", 10.0)
    full_lift: float = real("m", 1e-4, 0.5, "a wheel this high above the ground pulls no more", 0.005)
    wheel_rub: float = real("", 0.0, 1.0, "kinematic simulator: friction of a wheel along an obstacle", 0.66)
    body_rub: float = real("", 0.0, 1.0, "kinematic simulator: friction of the body along an obstacle", 0.94)
    undo: float = real("", 0.02, 1.0, "kinematic simulator: share of an overlap that is undone in a step", 0.51)


Bound = Annotated[StrictFloat, Field(ge=-1e6, le=1e6)]
ParameterName = Annotated[str, Field(pattern="^[A-Za-z][A-Za-z0-9_]*$")]
ValueName = Annotated[str, Field(pattern=f"^{PATH}$")]


class Setting(Section):
    """One dynamic_reconfigure value of move_base that follows a parameter of the space.

    server: below move_base's name, such as DWAPlannerROS; "" is move_base itself. name: in the file, without it the
    parameter's. aliases: names in other versions of the server (path_distance_bias was pdist_scale before). negated: it
    takes the negative value.
    """

    server: Annotated[str, Field(pattern=f"^({PATH})?$")]
    name: ValueName
    aliases: Tuple[ValueName, ...] = ()
    negated: StrictBool = False

    @property
    def names(self) -> Tuple[str, ...]:
        """Accepted names, the newest first."""
        return (self.name, *self.aliases)

    @property
    def sign(self) -> float:
        """-1 where the value is negated, else 1."""
        return -1.0 if self.negated else 1.0


class SpaceParameter(Section):
    """One parameter that a policy or a search sets, within its range. The first setting is where it is read back.

    name: in the file, its key. paper: whether policies in the paper's encoding see and set it, too.
    """

    name: ParameterName
    range: Tuple[Bound, Bound]
    sets: Tuple[Setting, ...] = Field(min_length=1)
    integer: StrictBool = False
    paper: StrictBool = True

    @property
    def low(self) -> float:
        """Its smallest value."""
        return self.range[0]

    @property
    def high(self) -> float:
        """Its largest value."""
        return self.range[1]

    @model_validator(mode="after")
    def _agrees(self) -> SpaceParameter:
        low, high = self.range
        if not low < high:
            raise ValueError(f"range is [{low:g}, {high:g}]: give a smaller number and a larger one")
        if self.integer and not (low.is_integer() and high.is_integer()):
            raise ValueError(f"range is [{low:g}, {high:g}]: give whole numbers for an integer")
        if self.sets[0].negated:
            raise ValueError("sets[0] is negated: give the value that has the parameter's own sign first")
        return self


class ParameterFile(Section):
    """A file, by its path from the robot's folder, and the namespace below which its parameters stand."""

    file: str
    namespace: Annotated[str, Field(pattern=f"^(/?{PATH})?$")] = ""

    def loaded(self, folder: str) -> Dict[str, Any]:
        """Return the nested parameters of the file in a folder. ApplrError if it cannot be read."""
        tree: Dict[str, Any] = {}
        branch(tree, self.namespace, create=True).update(read_parameters(os.path.join(folder, self.file)))
        return tree


class FileGroup(Section):
    """Files in the order in which they are loaded, and parameters that come after them; later values count."""

    files: Tuple[ParameterFile, ...] = ()
    parameters: Dict[str, Any] = {}

    def loaded_over(self, tree: Dict[str, Any], folder: str) -> Dict[str, Any]:
        """Return a tree with the parameters of the files in a folder on top."""
        for file in self.files:
            tree = merged(tree, file.loaded(folder))
        return merged(tree, self.parameters)


class MoveBaseSection(FileGroup):
    """Files that are always loaded, and those that are loaded after them with and without a map."""

    with_map: Optional[FileGroup] = None
    without_map: FileGroup = FileGroup()

    def loaded(self, folder: str) -> MoveBaseSetup:
        """Return the parameters of the files in `folder` that the section names."""
        always = self.loaded_over({}, folder)
        with_map = None if self.with_map is None else self.with_map.loaded_over(always, folder)
        return MoveBaseSetup(self.without_map.loaded_over(always, folder), with_map)


class RobotFile(Section):
    """The content of robot.yaml."""

    base: Base
    body: Body
    laser: Laser
    frames: Frames
    simulation: Simulation
    move_base: MoveBaseSection
    topics: Topics = Topics()
    odometry: OdometryErrors = OdometryErrors()
    monitor: Monitoring = Monitoring()
    world_scale: float = real("", 0.05, 20.0, "size of its worlds beside the Jackal's")
    parameter_space: Optional[Dict[ParameterName, SpaceParameter]] = None

    @model_validator(mode="before")
    @classmethod
    def _named(cls, content: Any) -> Any:
        """Take empty sections out, and give each parameter of the space, and its values, the name that is its key."""
        content = {name: value for name, value in content.items() if value is not None}
        for name, given in content.get("parameter_space", {}).items():
            given["name"] = name
            for one in given.get("sets", ()):
                one.setdefault("name", name)
        return content


class MoveBaseSetup(NamedTuple):
    """The robot's move_base parameters, nested, as its launch file loads them."""

    without_map: Dict[str, Any]
    with_map: Optional[Dict[str, Any]] = None  # None if robot.yaml describes no setup with a map


@dataclass(frozen=True)
class Robot:
    """A robot as its folder describes it. name: of the folder. world_scale: size of its worlds beside the Jackal's."""

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
    move_base: MoveBaseSetup = field(repr=False, hash=False, compare=False)

    @property
    def local_planner(self) -> str:
        """The local planner that its files name, without the package."""
        return str(self.move_base.without_map.get("base_local_planner", "TrajectoryPlannerROS")).rpartition("/")[2]

    @property
    def goal_tolerance(self) -> float:
        """Distance from a goal [m] within which its planner takes the goal's place for reached."""
        return float(branch(self.all_parameters(), self.local_planner)["xy_goal_tolerance"])

    def parameters(self, with_map: bool = False) -> Dict[str, Any]:
        """Return the move_base parameters of its files, a copy; ApplrError if there is no setup with a map."""
        tree = self.move_base.with_map if with_map else self.move_base.without_map
        if tree is None:
            raise ApplrError(f"robot {self.name}: robot.yaml has no move_base.with_map: give its files for a map")
        return copy.deepcopy(tree)

    def with_parameters(self, tree: Dict[str, Any], name: str) -> Robot:
        """Return the robot under another name, with more parameters of move_base on top of its own."""
        return replace(
            self, name=name, move_base=self.move_base._replace(without_map=merged(self.move_base.without_map, tree))
        )

    def all_parameters(self) -> Dict[str, Any]:
        """Return the parameters without a map with every absent one at its default (check.complete); a copy."""
        return complete(self.parameters())


def number_at(tree: Dict[str, Any], server: str, names: Tuple[str, ...]) -> Optional[float]:
    """A number of a server in a nested parameter tree (layers.arranged) under the first of `names` that has one."""
    found = [branch(tree, server).get(name) for name in names]
    numbers = [number for number in found if isinstance(number, (int, float)) and not isinstance(number, bool)]
    return float(numbers[0]) if numbers else None
