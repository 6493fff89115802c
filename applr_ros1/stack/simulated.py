"""Simulated robot: a simulator, and what drives in it, one control cycle after the other.

SimulatedRobot.cycle() is the only place where a simulator and a stack meet. It owns the clock of
the laser and the frame of the map. Drives along a course are in drives/simulate.py.
"""

import zlib
from typing import NamedTuple, Optional, Protocol, Sequence, Union

import numpy as np

from applr_ros1.common.angles import Pose, Twist, compose, inverse, transform_motions
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.scan import LaserScan
from applr_ros1.common.times import TIME_TOLERANCE_S
from applr_ros1.planner.costmap.static_layer import StaticMap
from applr_ros1.robots import Robot
from applr_ros1.stack.stack import Stack, Step
from sim_bridge.simulator import RobotState, Simulator
from worlds import World
from worlds.world import Grid

# Duration of a control cycle [s], 20 Hz as on the Jackal; slower parts of MoveBase skip cycles
CONTROL_PERIOD = 0.05


class BaseDriver(Protocol):
    """Commander of a robot's base: a Stack, or a script in its place."""

    @property
    def goal_tolerance(self) -> float:
        """Distance to the goal within which the driver counts it as reached [m]."""

    def reset(self, now: float, seed: Union[int, Sequence[int]]) -> None:
        """Forget everything at time `now` [s]."""

    def set_goal(self, goal: Pose, now: float) -> None:
        """Send a goal (x, y, yaw) at time `now` [s]."""

    def step(
        self,
        now: float,
        pose: Pose,
        twist: Twist,
        scan: Optional[LaserScan] = None,
        local_origin: Optional[Pose] = None,
    ) -> Step:
        """Run one control cycle, as Stack.step does."""


class Tick(NamedTuple):
    """One control cycle of a simulated robot.

    Attributes:
        before: State at the beginning, on which the command is based.
        scan: Scan at the beginning; None if none was due.
        step: What the driver did.
        after: State at the end.
        place: Pose at the end, in the frame of plan and goal.
        planner_pose: Pose at the beginning, in the frame of the local costmap.
    """

    before: RobotState
    scan: Optional[LaserScan]
    step: Step
    after: RobotState
    place: Pose
    planner_pose: Pose


class SimulatedRobot:
    """A robot in a simulator, driven by a stack.

    Args:
        simulator: Simulator of the robot. Its laser scans at its own rate, at most once per control
            cycle.
        driver: Stack, or script.
        with_map: Stack for worlds with a map, whose planner has the parameters of Robot.on_map;
            None for the same driver. A planner with a static layer gets the map and the robot's
            true pose; others explore.

    Attributes:
        robot: Robot with the parameters in use in the present world (robot_in).
        ranges: Latest scan (beams,) float32 [m] of a control cycle; empty before the first one.
        goal: Goal (x, y, yaw) of the course in the frame of plan and goal.
        goal_count: Number of goals sent so far.
    """

    def __init__(self, simulator: Simulator, driver: BaseDriver, with_map: Optional[Stack] = None):
        self.simulator = simulator
        self.driver = driver
        self.robot = simulator.robot
        self.goal: Pose = (0.0, 0.0, 0.0)
        self.goal_count = 0
        self.ranges = np.empty(0, np.float32)
        self._without_map = driver
        self._with_map = with_map or driver
        # Pose of the world's frame in the map's, if the planner has the map
        self._to_map: Optional[Pose] = None
        # Scan interval [s]; 0: one scan per cycle
        self._scan_period = self.robot.laser.period_in(CONTROL_PERIOD)
        self._scan_due = 0.0  # time of the next scan [s]

    @property
    def stack(self) -> Stack:
        """Stack that drives in the present world. A script has none."""
        assert isinstance(self.driver, Stack)
        return self.driver

    @property
    def state(self) -> RobotState:
        """True and measured state of the robot now."""
        return self.simulator.state

    @property
    def frame(self) -> str:
        """Name of the frame of plan and goal.

        It is the map's; without a map that of the monitor's matched poses, or the odometry's.
        """
        frames = self.robot.frames
        if self._to_map is not None:
            return frames.map
        return frames.odom if self.correction is None else frames.matched

    @property
    def place(self) -> Pose:
        """Pose of the robot in the frame of plan and goal.

        It is the true pose on a map, or the odometry's without a map, as the monitor corrects it.
        """
        state = self.state
        if self._to_map is not None:
            return compose(self._to_map, state.pose)
        if self.correction is not None:
            return compose(self.correction, state.odom_pose)
        return state.odom_pose

    @property
    def origin(self) -> Optional[Pose]:
        """Pose of the odometry's frame in that of plan and goal; None if both are the same."""
        if self._to_map is None:
            return self.correction
        return compose(self.place, inverse(self.state.odom_pose))

    @property
    def correction(self) -> Optional[Pose]:
        """Pose of the odometry frame in that of the monitor's matched poses (Stack.correction).

        None if plan and goal are in another frame.
        """
        return self.driver.correction if isinstance(self.driver, Stack) else None

    @property
    def movers(self) -> Array:
        """Tracked moving obstacles (n, 4): x, y [m], vx, vy [m/s] in the frame of plan and goal."""
        movers = self.stack.movers
        if self.origin is None:
            return movers
        return transform_motions(self.origin, movers)

    def robot_in(self, world: World) -> Robot:
        """Return the robot with the parameters in use in a world (Robot.on_map)."""
        robot = self.simulator.robot
        if world.map is None or self._with_map is self._without_map:
            return robot
        return robot.on_map()

    def reset(self, world: World, seed: int) -> None:
        """Place the robot at the start of the world's course, and restore the driver's parameters.

        If the planner's fidelity is random, the reset draws the fidelity.
        """
        self.robot = self.robot_in(world)
        self.driver = self._without_map
        self._to_map = None
        if world.map is not None:
            self.driver = self._with_map
            self._show_map(world.map)
        state = self.simulator.reset(world, seed)
        # Because the seed includes the name, a random planner fidelity differs from world to world.
        self.driver.reset(state.time, seed=[seed, zlib.crc32(world.name.encode())])
        self._scan_due = state.time
        self.ranges = np.empty(0, np.float32)

    def _show_map(self, world_map: Grid) -> None:
        """Give the planner the map, if it has a static layer."""
        if not isinstance(self.driver, Stack) or not self.stack.move_base.map_topics:
            return
        self._to_map = inverse(world_map.origin)
        cells, resolution, _ = world_map
        static_map = StaticMap(cells, resolution, (0.0, 0.0), self.robot.frames.map)
        self.stack.move_base.set_map(static_map)

    def send_goal(self) -> None:
        """Send the goal of the world's course."""
        sent_goal = self.simulator.world.course.sent_goal
        if self._to_map is not None:
            self.goal = compose(self._to_map, sent_goal)
        else:
            self.goal = self.simulator.to_odom(sent_goal)
            # As on the robot, later corrections move the odometry's frame, and not the goal.
            if self.correction is not None:
                self.goal = compose(self.correction, self.goal)
        self.goal_count += 1
        self.driver.set_goal(self.goal, self.state.time)

    def cycle(self) -> Tick:
        """Drive one control cycle: scan, plan, command and move."""
        before = self.state
        scan = None
        if before.time + TIME_TOLERANCE_S >= self._scan_due:
            scan = self._scan()
        # Pose of the odometry's frame in the map's
        origin = None
        planner_pose = self.place
        if self._to_map is not None:
            origin = self.origin
            planner_pose = before.odom_pose
        step = self.driver.step(before.time, before.odom_pose, before.odom_twist, scan, origin)
        if step.command is not None:
            self.simulator.command(*step.command)
        after = self.simulator.advance(CONTROL_PERIOD)
        return Tick(before, scan, step, after, self.place, planner_pose)

    def _scan(self) -> Optional[LaserScan]:
        """Take the scan of the simulated laser that is due. Return None if the laser loses it."""
        self._scan_due += self._scan_period
        if self.simulator.loses_scan():
            return None
        scan = self.simulator.laser_scan()
        self.ranges = scan.ranges
        return scan

    def look(self) -> Array32:
        """Return the scan (beams,) float32 [m] on which a decision is based now.

        It is the latest one of a laser that is slower than the control cycle, and else a new one.
        """
        return self.ranges if self._scan_period else self.simulator.scan()
