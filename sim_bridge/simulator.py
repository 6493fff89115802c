"""Common interface of the simulated robots, PybulletSimulator and KinematicSimulator.

The ROS bridge, the training environment and the evaluation drive through this interface. Time is
simulated, so no function here reads a clock.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from math import inf, isfinite
from typing import Any, List, NamedTuple, Optional, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose, Twist, normalize_angle, normalize_angle_modulo
from applr_ros1.common.arrays import Array32
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.scan import LaserScan
from applr_ros1.robots import Robot, geometry, load
from worlds import World

from .laser_errors import LaserErrors
from .lidar import Lidar
from .mechanics import STEP, mechanics
from .odometry import Odometry
from .passers_by import PassersBy
from .wheels import Surface, new_vehicle, rim_table

# Constant, or range (low, high) from which a value is drawn at every reset
Span = Union[float, Tuple[float, float]]
SOON_S = 1e-9  # rounding error of a sum of times: a command so soon is in force [s]


@dataclass
class RobotState:
    """State of the robot at one instant.

    Poses are (x, y, yaw) [m, m, rad], twists (v, w) [m/s, rad/s].
    """

    time: float = 0.0
    pose: Pose = (0.0, 0.0, 0.0)  # true pose in the world frame
    twist: Twist = (0.0, 0.0)  # true twist in the body frame
    odom_pose: Pose = (0.0, 0.0, 0.0)  # pose estimated by the odometry, in frame odom
    odom_twist: Twist = (0.0, 0.0)
    contact: bool = False  # whether the robot touched an obstacle during the last advance()
    flipped: bool = False
    imu: Tuple[float, float] = (0.0, 0.0)  # forward acceleration [m/s^2], yaw rate [rad/s]


@dataclass(frozen=True)
class Randomisation:
    """Deviations from the nominal robot.

    From a range (low, high), a number is drawn at every reset.
    """

    start_xy: float = 0.0  # maximum shift of the start along x and y [m]
    start_yaw: float = 0.0  # maximum rotation of the start [rad]
    scan_noise: Span = 1.0  # scale factor for laser noise, unless the robot names its sensor
    latency: Span = 0.0  # delay from command() to the wheels [s]
    friction: Span = 1.0  # scale factor for wheel friction
    slip: Span = 1.0  # scale factor for random slip and drift
    ground: Span = 1.0  # blend from plain ground (0) to simulation.ground (1), see wheels.py
    odometry: Span = 1.0  # scale factor for odometry errors

    def __post_init__(self) -> None:
        for name, span in vars(self).items():
            lowest, highest = span if isinstance(span, (tuple, list)) else (span, span)
            if not 0 <= lowest <= highest:
                remedy = "give a number >= 0 or a range (low, high)"
                raise ApplrError(f"randomisation {name} = {span!r}: {remedy}")

    def draw(self, rng: np.random.Generator) -> Randomisation:
        """Return a copy in which each range is replaced by a number drawn uniformly from it."""
        drawn_values = {}
        for name, span in vars(self).items():  # A seed's draws depend on the order of the fields.
            if name.startswith("start_"):
                continue
            if isinstance(span, (tuple, list)):
                drawn_values[name] = float(rng.uniform(*span))
            else:
                drawn_values[name] = float(span)
        return replace(self, **drawn_values)


class _Pending(NamedTuple):
    """Command that the latency delays."""

    time: float  # simulated time at which the command comes into force [s]
    v: float  # [m/s]
    w: float  # [rad/s]


@dataclass
class _Command:
    """Command in force, and those that follow it."""

    v: float = 0.0  # [m/s]
    w: float = 0.0  # [rad/s]
    until: float = -1.0  # simulated time at which the base stops on its own [s]
    pending: List[_Pending] = field(default_factory=list)  # in the order of their times


class Simulator(ABC):
    """One robot in one world.

    The origin of frame `odom` is the start position, and its axes are parallel to those of the
    world, as for Gazebo's Jackal. A rotated start therefore does not move a goal in frame `odom`.

    Args:
        robot: Description of the robot; the Jackal by default.
        **randomisation: Fields of Randomisation.

    Attributes:
        vehicle: Record (1,) of the present Vehicle: its ground, controller and wheels.
    """

    world: World  # world of the last reset()
    passers_by: PassersBy  # its moving obstacles
    drawn: Any  # Randomisation of this reset, with every range replaced by a number

    def __init__(self, robot: Optional[Robot] = None, **randomisation: Any) -> None:
        self.robot = load("jackal") if robot is None else robot
        self.randomisation = Randomisation(**randomisation)
        self._radius = geometry.radius(self.robot)
        self.state = RobotState()
        self.odom_origin = (0.0, 0.0)
        self._lidar: Any = None
        self._command = _Command()
        self._mechanics = mechanics(self.robot)
        self._table = rim_table(self.robot)

    # -- public ------------------------------------------------------------------------------------
    def reset(self, world: World, seed: int, start: Optional[Sequence[float]] = None) -> RobotState:
        """Place the robot at rest at `start`, by default that of the course, and set time to 0.

        `start` is a pose (x, y, yaw) in the world frame. The same world, seed and commands
        give bit-identical states and scans.
        """
        # Start pose and randomised values
        x, y, yaw = map(float, world.course.start if start is None else start)
        self._rng = np.random.default_rng(seed)
        self.drawn = self.randomisation.draw(self._rng)
        dx, dy, turn = self._rng.uniform(-1, 1, 3).tolist()
        x += dx * self.drawn.start_xy
        y += dy * self.drawn.start_xy
        yaw = normalize_angle_modulo(yaw + turn * self.drawn.start_yaw)
        pose = (x, y, yaw)

        # The drives in one world share its lidar, which prepares the sides of all boxes.
        new_world = self._lidar is None or world is not self.world
        if new_world:
            self._lidar = Lidar(self.robot.laser, world.cylinders, world.boxes)
        self.world = world
        self.passers_by = PassersBy(world, self._radius)
        self.odom_origin = (x, y)

        # Each source of errors has its own random numbers, so that one does not shift those of
        # another.
        errors_seed = int(self._rng.integers(2**31))
        odometry_rng = np.random.default_rng(errors_seed)
        self._odometry = Odometry(self.robot.odometry, yaw, odometry_rng, self.drawn.odometry)
        self._noise = np.random.default_rng([errors_seed, 1])
        self._angle_seed = [errors_seed, 2]

        self._surface = self._drawn_surface()
        self._command = _Command()
        self._steps = 0
        self._elapsed = 0.0
        self.state = RobotState(pose=pose, odom_pose=self._odometry.pose)
        self._laser_errors: Optional[LaserErrors] = None
        if self.robot.laser.has_errors:
            laser_rng = np.random.default_rng([errors_seed, 3])
            self._laser_errors = LaserErrors(self.robot.laser, self.state, laser_rng)
        self._place(pose, new_world)
        return self.state

    def command(self, v: float, w: float) -> None:
        """Set the velocity command [m/s, rad/s]. The base stops after its command timeout."""
        if not (isfinite(v) and isfinite(w)):
            raise ApplrError(f"command ({v!r}, {w!r}) is not finite: give finite velocities")
        base = self.robot.base
        # Limits first, then the dead band of the motors
        v = min(max(v, -base.max_speed), base.max_speed)
        w = min(max(w, -base.max_yaw_rate), base.max_yaw_rate)
        smallest_v, smallest_w = base.dead_band
        if abs(v) < smallest_v:
            v = 0.0
        if abs(w) < smallest_w:
            w = 0.0
        start_time = self.state.time + self.drawn.latency + self.robot.simulation.command_delay
        # Latency and delay put the command off, but keep the order of commands.
        self._command.pending.append(_Pending(start_time, v, w))

    def advance(self, duration: float) -> RobotState:
        """Simulate `duration` [s]. The total time is rounded to whole physics steps."""
        # Steps are counted from the total time, so that rounding errors do not add up.
        self._elapsed += duration
        steps = int(round(self._elapsed / STEP)) - self._steps
        if steps > 0:
            self.passers_by.look(self.state.time, self.state.pose)
            self._drive(steps)
        if self._laser_errors is not None:
            self._laser_errors.remember(self.state)
        return self.state

    def loses_scan(self) -> bool:
        """Return whether the laser has no scan now, although one is due (laser.gaps)."""
        return self._laser_errors is not None and self._laser_errors.loses_scan()

    def scan(self) -> Array32:
        """Return the laser ranges (beams,) float32 [m] now, with new noise at each call.

        As in REP 117 and Gazebo, +inf means no return, and -inf an obstacle nearer than range_min.
        """
        laser = self.robot.laser
        errors = self._laser_errors
        state = self.state if errors is None else errors.past[0]
        laser_pose = laser.pose_for(state.pose)
        ranges: Array32 = self._lidar.scan(*laser_pose, self.passers_by.circles(state.time))
        if errors is not None:
            errors.add(ranges, laser_pose)
        # The factor stands for what is unknown of a laser. The errors of a named one are known.
        factor = 1.0 if laser.sensor else self.drawn.scan_noise
        noise = self._rng.standard_normal(laser.beams, dtype=np.float32)
        # In place, because a scan is drawn in every control cycle of a training.
        noise *= np.float32(laser.noise * factor)
        return np.add(ranges, noise, out=ranges)

    def laser_scan(self) -> LaserScan:
        """Take a scan with the laser's place by odometry, as the robot's own nodes know it."""
        laser = self.robot.laser
        return LaserScan(
            self.state.time,
            laser.first_angle,
            laser.increment,
            laser.range_min,
            laser.range_max,
            self.scan(),
            laser.pose_for(self.state.odom_pose),
            laser.height,
        )

    def to_odom(self, pose: Pose) -> Pose:
        """Transform a pose (x, y, yaw) from the world frame to frame odom."""
        return pose[0] - self.odom_origin[0], pose[1] - self.odom_origin[1], pose[2]

    def set_odometry(self, pose: Pose) -> None:
        """Set the pose (x, y, yaw) of the odometry in frame odom without moving the robot."""
        self._odometry.place(pose, self.state.pose[2])
        self.state = replace(self.state, odom_pose=self._odometry.pose)

    def teleport(self, pose: Sequence[float]) -> RobotState:
        """Place the robot at rest at `pose` (x, y, yaw) in the world frame, while time goes on.

        As in Gazebo, the position of the odometry is unchanged, because it comes from the wheels.
        Its heading follows, because it comes from the IMU.
        """
        x = float(pose[0])
        y = float(pose[1])
        yaw = normalize_angle(float(pose[2]))
        self._move_to((x, y, yaw))
        self.state = replace(
            self.state, pose=(x, y, yaw), twist=(0.0, 0.0), contact=False, flipped=False
        )
        if self._laser_errors is not None:
            # What was measured at the old place would be taken for the new one.
            self._laser_errors.past = [self.state]
        odom_x, odom_y, _ = self.state.odom_pose
        self.set_odometry((odom_x, odom_y, yaw))
        self.odom_origin = (x - odom_x, y - odom_y)
        return self.state

    def close(self) -> None:
        """Release all resources. Only `close` itself may be called afterwards."""
        self._lidar = None

    def _drawn_surface(self) -> Surface:
        """Return the ground of this reset."""
        ground = 0.0
        if self.robot.simulation.ground == "gazebo":
            ground = min(self.drawn.ground, 1.0)
        friction = self.robot.base.wheel_friction * self.drawn.friction
        return Surface(self.drawn.slip, friction, ground)

    # -- implemented by derived classes ------------------------------------------------------------
    @abstractmethod
    def _place(self, pose: Pose, new_world: bool) -> None:
        """Build self.world, and place the robot at rest at `pose`."""

    @abstractmethod
    def _move_to(self, pose: Pose) -> None:
        """Place the robot at rest at `pose` while time goes on. The caller updates self.state."""

    @abstractmethod
    def _drive(self, steps: int) -> None:
        """Simulate `steps` steps towards `_target(time)`; count self._steps, and call _update()."""

    def _reset_wheels(self) -> None:
        """Set all wheels to rest, with new angles and without noise."""
        constants = self._mechanics.constants
        self.vehicle = new_vehicle(constants, self._surface, self._angle_seed)
        self._supports = self._mechanics.supports.copy()

    def _update(
        self,
        pose: Pose,
        twist: Twist,
        rolled: float,
        duration: float,
        contact: bool,
        flipped: bool = False,
    ) -> None:
        """Store the state after the last steps.

        Args:
            pose: True pose of base_link [m, m, rad].
            twist: True twist [m/s, rad/s].
            rolled: Mean speed of the wheels' rims in these steps [m/s].
            duration: Duration of these steps [s].
            contact: Whether the robot touched an obstacle.
            flipped: Whether the robot has fallen over.
        """
        acceleration = (twist[0] - self.state.twist[0]) / duration
        odometry = self._odometry
        odometry.integrate(duration, rolled, pose[2], twist[1], acceleration)
        self.state = RobotState(
            time=self._steps * STEP,
            pose=pose,
            twist=twist,
            odom_pose=odometry.pose,
            odom_twist=odometry.twist,
            contact=contact,
            flipped=flipped,
            imu=odometry.imu,
        )

    def _target(self, time: float) -> Twist:
        """Return the command (v, w) that the base follows at `time`, after latency and time-out."""
        command = self._command
        while command.pending and command.pending[0].time <= time + SOON_S:
            pending = command.pending.pop(0)
            command.v = pending.v
            command.w = pending.w
            command.until = pending.time + (self.robot.base.command_timeout or inf)
        # After the command timeout the base stops on its own.
        if time < command.until - SOON_S:
            return command.v, command.w
        return 0.0, 0.0


def warm_up(simulator: Simulator, world: World) -> None:
    """Compile or load all kernels of a simulator. The simulator must be reset afterwards."""
    simulator.reset(world, 0)
    simulator.command(0.5, 0.5)
    for _ in range(10):
        simulator.advance(0.01)
    simulator.scan()
