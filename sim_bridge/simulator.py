"""Common interface of the simulated robots, PybulletSimulator and KinematicSimulator.

The ROS bridge, the training environment and the evaluation drive through this interface. Time is simulated, so no
function here reads a clock.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from math import inf, isfinite
from typing import Any, List, Optional, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common.angles import Pose, normalize_angle, normalize_angle_modulo, transform_point
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import Robot, load
from worlds import World

from .lidar import Lidar
from .mechanics import STEP
from .odometry import Odometry

Span = Union[float, Tuple[float, float]]  # constant, or range (low, high) from which a value is drawn at every reset


@dataclass
class RobotState:
    """State of the robot at one instant. Poses are (x, y, yaw) [m, m, rad], twists (v, w) [m/s, rad/s]."""

    time: float = 0.0
    pose: Pose = (0.0, 0.0, 0.0)  # true pose in the world frame
    twist: Tuple[float, float] = (0.0, 0.0)  # true twist in the body frame
    odom_pose: Pose = (0.0, 0.0, 0.0)  # pose estimated by the odometry, in frame odom
    odom_twist: Tuple[float, float] = (0.0, 0.0)
    contact: bool = False  # whether the robot touched an obstacle during the last advance()
    flipped: bool = False
    imu: Tuple[float, float] = (0.0, 0.0)  # forward acceleration [m/s^2], yaw rate [rad/s]


@dataclass(frozen=True)
class Randomisation:
    """Deviations from the nominal robot: numbers, or ranges (low, high) from which numbers are drawn at reset."""

    start_xy: float = 0.0  # maximum shift of the start along x and y [m]
    start_yaw: float = 0.0  # maximum rotation of the start [rad]
    scan_noise: Span = 1.0  # scale factor for laser noise
    latency: Span = 0.0  # delay from command() to the wheels [s]
    friction: Span = 1.0  # scale factor for wheel friction
    slip: Span = 1.0  # scale factor for random slip and drift
    ground: Span = 1.0  # blend from ground plain (0) to the robot's simulation.ground (1), see wheels.py
    odometry: Span = 1.0  # scale factor for odometry errors

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            low, high = value if isinstance(value, (tuple, list)) else (value, value)
            if not 0 <= low <= high:
                raise ApplrError(f"randomisation {name} = {value!r}: give a number >= 0 or a range (low, high)")

    def draw(self, rng: np.random.Generator) -> Randomisation:
        """Return a copy in which each range is replaced by a number drawn uniformly from it."""

        def pick(span: Span) -> float:
            return float(rng.uniform(*span)) if isinstance(span, (tuple, list)) else float(span)

        names = [name for name in vars(self) if not name.startswith("start_")]  # A seed's draws depend on the order.
        return replace(self, **{name: pick(getattr(self, name)) for name in names})


@dataclass
class _Command:
    v: float = 0.0
    w: float = 0.0
    until: float = -1.0  # simulated time at which the base stops on its own [s]
    # commands (start time [s], v, w) delayed by the latency
    pending: List[Tuple[float, float, float]] = field(default_factory=list)


class Simulator(ABC):
    """One robot in one world.

    The origin of frame `odom` is the start position, and its axes are parallel to those of the world, as for Gazebo's
    Jackal. A rotated start therefore does not move a goal in frame `odom`.

    Args:
        robot: Description of the robot; the Jackal by default.
        **randomisation: Fields of Randomisation.
    """

    world: World  # world of the last reset()
    drawn: Any  # Randomisation of this reset, with every range replaced by a number

    def __init__(self, robot: Optional[Robot] = None, **randomisation: Any) -> None:
        self.robot = load("jackal") if robot is None else robot
        self.randomisation = Randomisation(**randomisation)
        self.state = RobotState()
        self.odom_origin = (0.0, 0.0)
        self._lidar: Any = None
        self._command = _Command()

    # -- public ------------------------------------------------------------------------------------
    def reset(self, world: World, seed: int, start: Optional[Sequence[float]] = None) -> RobotState:
        """Place the robot at rest at `start` in the world frame, by default the start of the course, and set time to 0.

        The same world, seed and commands give bit-identical states and scans.
        """
        x, y, yaw = map(float, world.course.start if start is None else start)
        self._rng = np.random.default_rng(seed)
        self.drawn = self.randomisation.draw(self._rng)
        dx, dy, turn = self._rng.uniform(-1, 1, 3).tolist()
        most, yaw = self.drawn.start_xy, normalize_angle_modulo(yaw + turn * self.drawn.start_yaw)
        pose = x + dx * most, y + dy * most, yaw
        new_world = self._lidar is None or world is not self.world
        if new_world:
            self._lidar = Lidar(self.robot.laser, world.cylinders, world.boxes)
        self.world = world
        self.odom_origin = pose[:2]
        self._command = _Command()
        seed = int(self._rng.integers(2**31))
        self._odometry = Odometry(self.robot.odometry, pose[2], np.random.default_rng(seed), self.drawn.odometry)
        self._noise, self._angle_seed = np.random.default_rng([seed, 1]), [seed, 2]
        self._steps, self._elapsed = 0, 0.0
        self.state = RobotState(pose=pose, odom_pose=self._odometry.pose)
        self._place(pose, new_world)
        return self.state

    def command(self, v: float, w: float) -> None:
        """Set the velocity command [m/s, rad/s]. The base stops when its command timeout has passed."""
        if not (isfinite(v) and isfinite(w)):
            raise ApplrError(f"command ({v!r}, {w!r}) is not finite: give finite velocities")
        base = self.robot.base
        v = min(max(v, -base.max_speed), base.max_speed)
        w = min(max(w, -base.max_yaw_rate), base.max_yaw_rate)
        v, w = (0.0 if abs(speed) < least else speed for speed, least in zip((v, w), base.dead_band))
        self._command.pending.append((self.state.time + self.drawn.latency + self.robot.simulation.command_delay, v, w))

    def advance(self, duration: float) -> RobotState:
        """Simulate `duration` [s]. The total time is rounded to whole physics steps."""
        self._elapsed += duration
        steps = int(round(self._elapsed / STEP)) - self._steps
        if steps > 0:
            self._drive(steps)
        return self.state

    def scan(self) -> Array32:
        """Return the laser ranges (beams,) float32 [m] at the current time, with new noise at each call.

        As in REP 117 and Gazebo, +inf means no return, and -inf an obstacle nearer than range_min.
        """
        pose, laser = self.state.pose, self.robot.laser
        place = transform_point(pose, laser.pose[0], laser.pose[1])
        ranges: Array32 = self._lidar.scan(*place, pose[2] + laser.pose[2], self.mover_circles())
        noise = self._rng.standard_normal(laser.beams, dtype=np.float32)
        noise *= np.float32(laser.noise * self.drawn.scan_noise)
        return np.add(ranges, noise, out=ranges)

    def to_odom(self, pose: Pose) -> Pose:
        """Transform a pose (x, y, yaw) from the world frame to frame odom."""
        return pose[0] - self.odom_origin[0], pose[1] - self.odom_origin[1], pose[2]

    def set_odometry(self, pose: Pose) -> None:
        """Set the pose (x, y, yaw) of the odometry in frame odom without moving the robot."""
        self._odometry.set(pose, self.state.pose[2])
        self.state = replace(self.state, odom_pose=self._odometry.pose)

    def teleport(self, pose: Sequence[float]) -> RobotState:
        """Place the robot at rest at `pose` (x, y, yaw) in the world frame, while time and commands go on.

        As in Gazebo, the position of the odometry is unchanged, because it comes from the wheels. Its heading follows,
        because it comes from the IMU.
        """
        x, y, yaw = float(pose[0]), float(pose[1]), normalize_angle(float(pose[2]))
        self._move_to((x, y, yaw))
        self.state = replace(self.state, pose=(x, y, yaw), twist=(0.0, 0.0), contact=False, flipped=False)
        odom_x, odom_y, _ = self.state.odom_pose
        self.set_odometry((odom_x, odom_y, yaw))
        self.odom_origin = (x - odom_x, y - odom_y)
        return self.state

    def mover_circles(self, time: Optional[float] = None) -> Array:
        """Return the moving cylinders (k, 3) x, y, radius [m] of the world, now or at a simulated time [s]."""
        time = self.state.time if time is None else time
        circles = [(*mover.position(time), mover.radius) for mover in self.world.movers]
        return np.array(circles, dtype=np.float64).reshape(-1, 3)

    def close(self) -> None:
        """Release all resources. Only `close` itself may be called afterwards."""
        self._lidar = None

    # -- implemented by derived classes ------------------------------------------------------------
    @abstractmethod
    def _place(self, pose: Pose, new_world: bool) -> None:
        """Build self.world, and place the robot at rest at `pose`."""

    @abstractmethod
    def _move_to(self, pose: Pose) -> None:
        """Place the robot at rest at `pose` while time goes on. The caller updates self.state."""

    @abstractmethod
    def _drive(self, steps: int) -> None:
        """Simulate `steps` steps of STEP [s] towards `_target(time)`, and update self._steps and self.state."""

    def _ground(self) -> float:
        """Return the argument `ground` of wheels.tyres() for this reset."""
        return min(self.drawn.ground, 1.0) if self.robot.simulation.ground == "gazebo" else 0.0

    def _target(self, time: float) -> Tuple[float, float]:
        """Return the command (v, w) that the base follows at `time`, after latency and time-out."""
        command = self._command
        while command.pending and command.pending[0][0] <= time + 1e-9:
            since, command.v, command.w = command.pending.pop(0)
            command.until = since + (self.robot.base.command_timeout or inf)
        return (command.v, command.w) if time < command.until - 1e-9 else (0.0, 0.0)


def warm_up(simulator: Simulator, world: World) -> None:
    """Compile or load all kernels of a simulator. The simulator must be reset afterwards."""
    simulator.reset(world, 0)
    simulator.command(0.5, 0.5)
    for _ in range(10):
        simulator.advance(0.01)
    simulator.scan()
