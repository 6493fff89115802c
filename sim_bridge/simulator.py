"""The one interface of the simulated robot.

PybulletSimulator and KinematicSimulator implement it; the ROS bridge, the training environment and the evaluation drive
through it. Time is simulated: nothing here reads a clock.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from math import inf, isfinite
from typing import Any, List, Optional, Sequence, Tuple, Union

import numpy as np

from applr_ros1.common import angles
from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import Robot, load
from worlds import World

from .lidar import Lidar
from .mechanics import STEP
from .odometry import Odometry

Pose = Tuple[float, float, float]
Span = Union[float, Tuple[float, float]]  # a number, or (low, high): drawn anew at every reset


class SimulatorError(ApplrError):
    """A wrong argument to a simulator: one line that says which, its value and what to do."""


@dataclass
class RobotState:
    """State of the robot at one instant.

    Poses are (x, y, yaw) [m, m, rad], twists (v, w) [m/s, rad/s].
    """

    time: float = 0.0
    pose: Tuple[float, float, float] = (0.0, 0.0, 0.0)  # true, world frame
    twist: Tuple[float, float] = (0.0, 0.0)  # true, along and about the body's axes
    odom_pose: Tuple[float, float, float] = (0.0, 0.0, 0.0)  # as the odometry believes, frame odom
    odom_twist: Tuple[float, float] = (0.0, 0.0)
    contact: bool = False  # touched anything since the last advance() began
    flipped: bool = False
    imu: Tuple[float, float] = (0.0, 0.0)  # forward acceleration [m/s^2], yaw rate [rad/s]


@dataclass(frozen=True)
class Randomisation:
    """Differences from the nominal robot.

    Each is a number or a (low, high) span drawn at reset from the seed.
    """

    start_xy: float = 0.0  # the start is moved by up to this much along x and y [m]
    start_yaw: float = 0.0  # and turned by up to this much [rad]
    scan_noise: Span = 1.0  # multiplies the laser's noise
    latency: Span = 0.0  # from command() to the wheels [s]
    friction: Span = 1.0  # multiplies the wheels' friction
    slip: Span = 1.0  # multiplies slip and drift beyond what physics gives
    ground: Span = 1.0  # share of the robot's own ground, 1 or more all of it; the rest is plain
    odometry: Span = 1.0  # multiplies the odometry's errors

    def __post_init__(self):
        for name, value in vars(self).items():
            low, high = value if isinstance(value, (tuple, list)) else (value, value)
            if not 0 <= low <= high:
                raise SimulatorError(f"randomisation {name} = {value!r}: give a number >= 0 or a span (low, high)")

    def draw(self, rng: np.random.Generator) -> Randomisation:
        """One robot: the same fields, every span replaced by a number drawn uniformly from it."""

        def pick(span):
            return float(rng.uniform(*span)) if isinstance(span, (tuple, list)) else float(span)

        names = [name for name in vars(self) if not name.startswith("start_")]  # in this order
        return replace(self, **{name: pick(getattr(self, name)) for name in names})


@dataclass
class _Command:
    v: float = 0.0
    w: float = 0.0
    until: float = -1.0  # sim time at which the base stops by itself
    # (effective from, v, w) held back by the latency
    pending: List[Tuple[float, float, float]] = field(default_factory=list)


class Simulator(ABC):
    """One robot in one world.

    Frames: the world's own, and `odom`, whose origin is the start position and whose axes stay parallel to
    the world's (as on Gazebo's Jackal), so a start that is turned does not move a goal given in odom.

    Args:
        robot: Description of the robot; the Jackal without one.
        **randomisation: Fields of Randomisation.
    """

    world: World  # since the last reset()
    drawn: Any  # the Randomisation of this reset: every span replaced by a number

    def __init__(self, robot: Optional[Robot] = None, **randomisation: Any):
        self.robot = load("jackal") if robot is None else robot
        self.randomisation = Randomisation(**randomisation)
        self.state = RobotState()
        self.odom_origin = (0.0, 0.0)
        self._lidar: Any = None
        self._command = _Command()

    # -- for everybody -----------------------------------------------------------------------------
    def reset(self, world: World, seed: int, start: Optional[Sequence[float]] = None) -> RobotState:
        """Put the robot at `start` (world frame, default the course's) at time 0, standing.

        The same world, seed and commands give the same states and scans, to the last bit.
        """
        place = tuple(float(value) for value in (world.course.start if start is None else start))
        self._rng = np.random.default_rng(seed)
        self.drawn = self.randomisation.draw(self._rng)
        shift = self._rng.uniform(-1, 1, 3).tolist()
        pose = (
            place[0] + shift[0] * self.drawn.start_xy,
            place[1] + shift[1] * self.drawn.start_xy,
            angles.normalize_angle_modulo(place[2] + shift[2] * self.drawn.start_yaw),
        )
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
        """Take the newest velocity command [m/s, rad/s]. The base stops its command timeout after the last one."""
        if not (isfinite(v) and isfinite(w)):
            raise SimulatorError(f"command ({v!r}, {w!r}): velocities must be finite")
        base = self.robot.base
        v = min(max(v, -base.max_speed), base.max_speed)
        w = min(max(w, -base.max_yaw_rate), base.max_yaw_rate)
        self._command.pending.append((self.state.time + self.drawn.latency + self.robot.simulation.command_delay, v, w))

    def advance(self, duration: float) -> RobotState:
        """Let `duration` seconds pass (rounded to whole physics steps by what has passed in total)."""
        self._elapsed += duration
        steps = int(round(self._elapsed / STEP)) - self._steps
        if steps > 0:
            self._drive(steps)
        return self.state

    def scan(self) -> np.ndarray:
        """Return ranges (beams,) float32 [m] from the laser at the present instant.

        +inf where nothing returns and -inf nearer than range_min (REP 117, as Gazebo's laser does). Each call draws new
        noise.
        """
        pose = self.state.pose
        laser = self.robot.laser
        place = angles.transform_point(pose, laser.pose[0], laser.pose[1])
        ranges = self._lidar.scan(*place, pose[2] + laser.pose[2], self.mover_circles())
        noise = self._rng.standard_normal(laser.beams, dtype=np.float32)
        noise *= np.float32(laser.noise * self.drawn.scan_noise)
        return np.add(ranges, noise, out=ranges)

    def to_odom(self, pose: Pose) -> Pose:
        """Return a pose (x, y, yaw) of the world frame in frame odom."""
        return pose[0] - self.odom_origin[0], pose[1] - self.odom_origin[1], pose[2]

    def set_odometry(self, pose: Pose) -> None:
        """Make the odometry believe in `pose` (x, y, yaw) of frame odom; the robot stays where it is."""
        self._odometry.set(pose, self.state.pose[2])
        self.state = replace(self.state, odom_pose=self._odometry.pose)

    def teleport(self, pose: Sequence[float]) -> RobotState:
        """Put the robot at `pose` (x, y, yaw) of the world frame, standing; time and commands go on.

        The odometry notices nothing of the way: its position stays, as in Gazebo, where it comes from the wheels. Its
        heading follows, since that comes from the IMU.
        """
        x, y, yaw = float(pose[0]), float(pose[1]), angles.normalize_angle(float(pose[2]))
        self._move_to((x, y, yaw))
        self.state = replace(self.state, pose=(x, y, yaw), twist=(0.0, 0.0), contact=False, flipped=False)
        odom_x, odom_y, _ = self.state.odom_pose
        self.set_odometry((odom_x, odom_y, yaw))
        self.odom_origin = (x - odom_x, y - odom_y)
        return self.state

    def mover_circles(self, time: Optional[float] = None) -> np.ndarray:
        """Return (k, 3) x, y, radius of the world's moving cylinders, now or at a simulated time [s]."""
        movers = self.world.movers
        if not movers:
            return _NO_CIRCLES
        time = self.state.time if time is None else time
        return np.array([(*mover.position(time), mover.radius) for mover in movers], dtype=np.float64)

    def close(self) -> None:
        """Give back what the simulator holds. It can be called twice, but nothing else after it."""
        self._lidar = None

    # -- for the implementations -------------------------------------------------------------------
    @abstractmethod
    def _place(self, pose, new_world: bool) -> None:
        """Let the robot stand at `pose` in self.world."""

    @abstractmethod
    def _move_to(self, pose: Pose) -> None:
        """Put the robot at `pose`, standing, in the middle of a drive; the caller renews self.state."""

    @abstractmethod
    def _drive(self, steps: int) -> None:
        """Move on by `steps` of STEP, renew self._steps and self.state; the wheels are asked for `_target(time)`."""

    def _ground(self) -> float:
        """Return what wheels.tyres() takes for the ground of this reset."""
        return min(self.drawn.ground, 1.0) if self.robot.simulation.ground == "gazebo" else 0.0

    def _target(self, time: float):
        """Return (v, w) in force at `time`: latency and time-out included."""
        command = self._command
        while command.pending and command.pending[0][0] <= time + 1e-9:
            since, command.v, command.w = command.pending.pop(0)
            command.until = since + (self.robot.base.command_timeout or inf)
        return (command.v, command.w) if time < command.until - 1e-9 else (0.0, 0.0)


_NO_CIRCLES = np.empty((0, 3))


def warm_up(simulator: Simulator, world: World) -> None:
    """Have a simulator compile or load all its kernels; it needs a reset afterwards."""
    simulator.reset(world, 0)
    simulator.command(0.5, 0.5)
    for _ in range(10):
        simulator.advance(0.01)
    simulator.scan()
