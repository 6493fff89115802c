"""What a robot description holds: the sections of robot.yaml as pydantic models, which check their values.

reader.py fills them. Places are in the robot's base frame, x ahead. Fields without a default have to be given.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import Any, Dict, NamedTuple, Optional, Tuple

from typing_extensions import Literal, get_args

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import branch
from applr_ros1.robots.field_types import Inertia3, Length3, Name, Place2, Place3, Section, real, values, whole

Ground = Literal["plain", "gazebo"]
GROUNDS = get_args(Ground)


class Base(Section):
    """Wheels, their places, and what the base's controller allows.

    drive: skid_steer (four wheels, the two of a side turn together) or two_wheel (two driven wheels on the base frame's
    y axis, and casters). track: distance between left and right wheels' middles. wheelbase: between front and rear
    axle, 0 for two_wheel. axle_height: of the axles above the base frame. wheel_inertia: about x, y (the axle), z;
    without it that of a full cylinder. wheel_friction, caster_friction: Coulomb coefficients on the ground. casters:
    where they touch the ground. command_timeout: the base stops when no command has come for this long; 0 where it
    never does.
    """

    drive: Literal["skid_steer", "two_wheel"]
    max_speed: float = real("m/s", 0.01, 20.0)
    max_yaw_rate: float = real("rad/s", 0.01, 20.0)
    max_acceleration: float = real("m/s^2", 0.01, 100.0)
    max_yaw_acceleration: float = real("rad/s^2", 0.01, 200.0)
    wheel_radius: float = real("m", 0.005, 2.0)
    wheel_width: float = real("m", 0.001, 2.0)
    track: float = real("m", 0.01, 10.0)
    axle_height: float = real("m", -2.0, 2.0)
    wheelbase: float = real("m", 0.0, 10.0, 0.0)
    wheel_mass: float = real("kg", 0.001, 500.0, 0.5)
    wheel_inertia: Optional[Inertia3] = values("kg m^2", None)
    wheel_friction: float = real("", 0.01, 3.0, 0.5)
    casters: Tuple[Place2, ...] = values("m", (), max_length=8)
    caster_friction: float = real("", 0.0, 3.0, 0.1)
    command_timeout: float = real("s", 0.0, 60.0, 0.0)

    @property
    def wheels(self) -> int:
        """How many wheels are driven."""
        return 4 if self.drive == "skid_steer" else 2


class Body(Section):
    """The box that meets obstacles beside the wheels.

    size: length, width, height. centre: of the box along x and y; bottom: its underside above the base frame. com:
    centre of mass, without it the middle of the box. inertia: about x, y, z through it, without it that of the full
    box. friction: against obstacles.
    """

    size: Length3 = values("m")
    mass: float = real("kg", 0.01, 5000.0)
    centre: Place2 = values("m", (0.0, 0.0))
    bottom: float = real("m", -2.0, 2.0, 0.0)
    com: Optional[Place3] = values("m", None)
    inertia: Optional[Inertia3] = values("kg m^2", None)
    friction: float = real("", 0.01, 3.0, 0.5)


class Laser(Section):
    """A planar scanner, whose beams are evenly spread between both angles.

    pose: x, y [m] and yaw [rad]. height: above the base frame. no_return: what its driver states where nothing returns,
    if that is not +inf, such as 0.0.
    """

    frame: Name
    pose: Place3
    height: float = real("m", -2.0, 5.0)
    beams: int = whole(2, 8192)
    first_angle: float = real("rad", -6.2832, 6.2832)
    last_angle: float = real("rad", -6.2832, 6.2832)
    range_min: float = real("m", 0.0, 10.0)
    range_max: float = real("m", 0.1, 200.0)
    rate: float = real("Hz", 0.5, 200.0)
    noise: float = real("m", 0.0, 1.0, 0.0)
    no_return: Optional[float] = real("m", 0.0, 1000.0, None)

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
    odometry: Name = "odom"
    cmd_vel: Name = "cmd_vel"
    imu: Name = "imu"


class Frames(Section):
    """Names of frames in tf."""

    base: Name
    odom: Name = "odom"
    map: Name = "map"


class OdometryErrors(Section):
    """How the odometry errs: wheels for the distance, IMU for the heading. Standard deviations.

    scale_error: of the wheels' scale, drawn at a start. heading_drift: of the heading's slow error, heading_time its
    correlation time, heading_noise what changes from one reading to the next. speed_noise: of the speed given with the
    pose. gyro_noise, accelerometer_noise: of the IMU. lag: time constant of the
    filter that joins them. rate: of the messages.
    """

    rate: float = real("Hz", 1.0, 240.0, 50.0)
    scale_error: float = real("", 0.0, 0.5, 0.005)
    heading_drift: float = real("rad", 0.0, 1.0, 0.002)
    heading_time: float = real("s", 0.1, 1e4, 60.0)
    heading_noise: float = real("rad", 0.0, 1.0, 0.003)
    speed_noise: float = real("m/s", 0.0, 1.0, 0.005)
    gyro_noise: float = real("rad/s", 0.0, 1.0, 0.005)
    accelerometer_noise: float = real("m/s^2", 0.0, 5.0, 0.005)
    lag: float = real("s", 0.0, 1.0, 0.0)


class Monitoring(Section):
    """What the collision monitor relies on; see MonitorSettings."""

    margin: float = real("m", 0.0, 1.0, 0.03)
    reaction_time: float = real("s", 0.01, 2.0, 0.15)
    creep_speed: float = real("m/s", 0.0, 1.0, 0.1)
    deceleration: float = real("m/s^2", 0.01, 100.0, 4.0)
    yaw_deceleration: float = real("rad/s^2", 0.01, 200.0, 12.0)


class Simulation(Section):
    """Numbers of both simulators that are chosen or fitted, not measured on the robot.

    ground: plain, where tyres pull against their slip, or gazebo, with the friction of Gazebo's Jackal. There a wheel
    turns track_multiplier times as fast for a turn as its track says, stands on both edges of its rim, and has
    edge_shift more of its load on the outer one for each m/s^2 of lateral acceleration. command_delay: from a command
    to the wheels.

    grip_limit: on plain ground the tyres hold curves up to this v w. tyre_creep: slip speed at which a tyre has
    .7 of its full friction. grip_noise, grip_time: uneven ground, relative standard deviation of each wheel's
    friction and its correlation time. wheel_noise, wheel_time: the same of each side's speed; wheel_shake: its absolute
    deviation while it moves. ground_stiffness, ground_damping: of one tyre. motor_torque: of one
    wheel against obstacles. full_lift: a wheel this high above the ground pulls no more. wheel_rub, body_rub,
    undo: of the kinematic simulator, fitted to pybullet's contacts: friction of a wheel and of the body along an
    obstacle, and the share of an overlap that is undone in a step.
    """

    grip_limit: float = real("m/s^2", 0.05, 50.0)
    ground: Ground = "plain"
    track_multiplier: Optional[float] = real("", 0.5, 5.0, None)
    edge_shift: float = real("s^2/m", 0.0, 2.0, 0.0)
    command_delay: float = real("s", 0.0, 1.0, 0.0)
    tyre_creep: float = real("m/s", 1e-4, 0.5, 0.02)
    grip_noise: float = real("", 0.0, 1.0, 0.10)
    grip_time: float = real("s", 0.01, 60.0, 0.5)
    wheel_noise: float = real("", 0.0, 0.5, 0.005)
    wheel_time: float = real("s", 0.01, 60.0, 0.5)
    wheel_shake: float = real("m/s", 0.0, 0.5, 0.01)
    ground_stiffness: float = real("N/m", 100.0, 1e7, 3.0e4)
    ground_damping: float = real("N s/m", 1.0, 1e5, 400.0)
    motor_torque: float = real("N m", 0.01, 1000.0, 10.0)
    full_lift: float = real("m", 1e-4, 0.5, 0.005)
    wheel_rub: float = real("", 0.0, 1.0, 0.66)
    body_rub: float = real("", 0.0, 1.0, 0.94)
    undo: float = real("", 0.02, 1.0, 0.51)


@dataclass(frozen=True)
class Setting:
    """One dynamic_reconfigure value of move_base that follows a parameter of the space.

    server: below move_base's name, such as DWAPlannerROS. names: accepted names, the newest first (servers differ:
    path_distance_bias was pdist_scale before). negated: it takes the negative value.
    """

    server: str
    names: Tuple[str, ...]
    negated: bool = False


@dataclass(frozen=True)
class SpaceParameter:
    """One parameter that a policy or a search sets, within low to high. The first setting is where it is read back.

    paper: whether policies in the paper's form see and set it, too.
    """

    name: str
    low: float
    high: float
    integer: bool
    settings: Tuple[Setting, ...]
    paper: bool = True


class LoadedFile(NamedTuple):
    """A file of move_base parameters. values: nested dicts, which stand below `namespace`."""

    file: str
    namespace: str
    values: Dict[str, Any]


@dataclass(frozen=True)
class MoveBaseSetup:
    """The robot's move_base parameters, as its launch file loads them: nested dicts, {name: value or dict}.

    The files are those that the trees were joined from, in their order; later values count.
    """

    with_map: Optional[Dict[str, Any]]  # None where robot.yaml describes no setup with a map
    without_map: Dict[str, Any]
    files_with_map: Tuple[LoadedFile, ...] = ()
    files_without_map: Tuple[LoadedFile, ...] = ()


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
    method: str = field(default="applr", repr=False, compare=False)  # which launch files start; no trial depends on it

    @property
    def local_planner(self) -> str:
        """The local planner that its files name, without the package."""
        return str(self.move_base.without_map.get("base_local_planner", "TrajectoryPlannerROS")).rpartition("/")[2]

    def parameters(self, with_map: bool = False) -> Dict[str, Any]:
        """The nested move_base parameters of its files, a copy; ApplrError where there is no setup with a map."""
        tree = self.move_base.with_map if with_map else self.move_base.without_map
        if tree is None:
            raise ApplrError(f"robot {self.name}: robot.yaml has no move_base.with_map: give its files for a map")
        return copy.deepcopy(tree)


def find(tree: Dict[str, Any], server: str, names: Tuple[str, ...]) -> Optional[float]:
    """A value of a server in a nested parameter tree under the first of `names` that is there, else None.

    Files without a list of layers ("plugins") give a layer's values beside those of its costmap, as before ROS hydro.
    """
    branches = [branch(tree, server)]
    costmap, _, layer = server.rpartition("/")
    if layer and costmap and "plugins" not in branch(tree, costmap):
        branches.append(branch(tree, costmap))
    values = [branch[name] for branch in branches for name in names if name in branch]
    numbers = [value for value in values if isinstance(value, (int, float)) and not isinstance(value, bool)]
    return float(numbers[0]) if numbers else None
