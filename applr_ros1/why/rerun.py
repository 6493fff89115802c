"""Planner of a robot that runs control cycles again, each from what it was given in it.

A question holds all that the planner needs, so that questions may be asked in any order.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, List, NamedTuple, Optional, Sequence

import numpy as np

from applr_ros1.common.angles import Pose, Twist
from applr_ros1.common.scan import LaserScan, ObservationBuffer, PointCloud, observe
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.parameter import Parameter
from applr_ros1.planner.parameters.settings import Settings
from applr_ros1.planner.plan_cut import half_size
from applr_ros1.robots import Robot
from applr_ros1.robots.learned import TRAJECTORY
from applr_ros1.why.moment import (
    Asked,
    ComparedSamples,
    CycleMoment,
    LocalMap,
    MapSnapshot,
    Memory,
    arc,
)


class CycleResult(NamedTuple):
    """Command v [m/s], w [rad/s] of a cycle, and the memory after it."""

    command: Twist
    memory: Memory


class Ahead(NamedTuple):
    """How a robot drives on if it follows the planner's commands on the map of a cycle.

    Attributes:
        track: (n, 2) positions, one per control cycle [m].
        lethal_points: (k, 2) centres of the lethal cells [m].
    """

    track: np.ndarray
    lethal_points: np.ndarray


def with_meter_scoring(robot: Robot, is_per_metre: bool) -> Robot:
    """Return a robot whose move_base counts distance biases per metre, or per cell."""
    planner = {TRAJECTORY: {"meter_scoring": is_per_metre}}
    return replace(robot.with_parameters(planner, robot.name), is_running=True)


class RerunPlanner:
    """Local planner of a robot with its costmap, by the parameters of the robot's files.

    Attributes:
        name: Name of the planner, which is that of its server.
        period: Control period [s].
        goal_tolerance: Distance from the goal at which the robot has arrived [m].
        start_settings: Parameters of all servers at start-up, without move_base's own, which stay
            as they are while it drives.
        start_values: All parameters of the planner at start-up, static ones included.
    """

    def __init__(self, robot: Robot):
        self._move_base = MoveBase(robot.driven_parameters())
        self._local: Any = self._move_base.local_planner
        self._costmap = self._move_base.local_costmap
        self._settings: Optional[Settings] = None  # Those that the MoveBase has, if they are known
        self._shown: Optional[MapSnapshot] = None  # The map that the costmap shows, if it is known
        self.name = self._move_base.local_planner_name
        rate = self._move_base.configuration("")["controller_frequency"]
        self.period = 1.0 / max(rate, 1.0)
        self.goal_tolerance = self._move_base.goal_tolerance
        self.start_values = dict(self._move_base.parameters[self.name])
        start_settings = Settings.from_tree(self._move_base.parameters)
        values_by_server = {}
        for server in start_settings:
            if server:
                values_by_server[server] = start_settings[server]
        self.start_settings = Settings(values_by_server)

    # -- what is known of it -----------------------------------------------------------------------
    @property
    def cut_radius(self) -> float:
        """Radius around the robot in which a plan is followed [m]: half of the costmap's side."""
        return half_size(self._costmap)

    @property
    def prunes(self) -> bool:
        """True if points of the plan behind the robot are dropped."""
        return bool(self.start_values["prune_plan"])

    @property
    def resolution(self) -> float:
        """Edge of the costmap's cells [m]."""
        return self._costmap.resolution

    @property
    def tunable_servers(self) -> List[str]:
        """Servers of the planner and of the local costmap's inflation layers."""
        layers = [f"local_costmap/{layer.name}" for layer in self._costmap.inflation_layers]
        return [self.name, *layers]

    def parameters(self, server: str) -> Sequence[Parameter]:
        """Return the declared parameters of a server."""
        return self._move_base.servers[server].parameters

    def footprint(self, settings: Settings) -> np.ndarray:
        """Return the vertices (n, 2) [m] of the padded footprint with some settings."""
        self._put_in_force(settings)
        return self._costmap.footprint.copy()

    def inscribed_radius(self, settings: Settings) -> float:
        """Return the radius of the largest circle in the footprint with some settings [m]."""
        self._put_in_force(settings)
        return self._costmap.inscribed_radius

    def cloud(self, scan: LaserScan) -> PointCloud:
        """Return the points of a scan in its frame, as the local costmap takes them."""
        return observe(scan, self._buffer.source.inf_is_valid)

    @property
    def _buffer(self) -> ObservationBuffer:
        """Observations of the first source of the local costmap."""
        return self._costmap.obstacle_layers[0].buffers[0]

    @property
    def first_memory(self) -> Memory:
        """Memory of the planner before the first cycle."""
        return Memory([0] * len(self._local.planner.state))

    # -- maps --------------------------------------------------------------------------------------
    def first_map(self, settings: Settings) -> MapSnapshot:
        """Return the map before the first cycle, with these parameters."""
        self._put_in_force(settings)
        self._costmap.reset_layers()
        return self._remembered()

    def reconfigured(
        self, map_before: MapSnapshot, before: Settings, after: Settings
    ) -> MapSnapshot:
        """Return a map after a change of parameters: a call of the costmap's server clears it."""
        self._put_in_force(before)
        self._show(map_before)
        self._put_in_force(after)
        return self._remembered()

    def updated(
        self, map_before: MapSnapshot, settings: Settings, pose: Pose, cloud: PointCloud
    ) -> MapSnapshot:
        """Return a map after an update at a pose with the points of a scan."""
        self._put_in_force(settings)
        self._show(map_before)
        self._buffer.add_cloud(cloud, cloud.stamp)
        self._costmap.update_costs(pose)
        return self._remembered()

    def cleared(self, map_before: MapSnapshot, settings: Settings) -> MapSnapshot:
        """Return a map after a call to clear the costmaps."""
        self._put_in_force(settings)
        self._show(map_before)
        self._costmap.reset_layers()
        return self._remembered()

    # -- cycles ------------------------------------------------------------------------------------
    def run(self, asked: Asked) -> CycleResult:
        """Return what the planner does in a cycle."""
        command = self._command(asked)
        return CycleResult(command, self._memory())

    def clears_flags(self, asked: Asked) -> bool:
        """Return whether the plan of a cycle, if it is new, clears flags of the planner."""
        self._remember(asked.memory)
        self._local.set_plan(asked.plan)
        return self._memory() != asked.memory

    def followed(self, asked: Asked, command: Twist) -> Memory:
        """Return the memory after a cycle in which the robot followed another command."""
        self._put_in_force(asked.settings)
        self._remember(asked.memory)
        self._local.planner.remember(asked.pose, *command)
        return self._memory()

    def moment(self, asked: Asked, scan_points: np.ndarray, lookahead: float) -> CycleMoment:
        """Return what the planner says in a cycle, with all that it compares.

        Args:
            asked: What it is given.
            scan_points: (n, 2) points of the latest scan in the odometry frame [m].
            lookahead: Distance of the point of the plan that shows where it leads [m].
        """
        command = self._command(asked)
        velocities, costs, cost_parts = self._local.planner.sample_costs(self._costmap, command)
        x, y, _, _, trajectory_costs = self._local.trajectory_cloud(self._costmap).T
        return CycleMoment(
            asked=asked,
            planner=self.name,
            lookahead=lookahead,
            command=command,
            samples=ComparedSamples(velocities, costs, cost_parts),
            trajectory_points=np.column_stack([x, y, trajectory_costs]),
            map=self._map(),
            scan_points=scan_points,
        )

    def ahead(self, asked: Asked, settings: Settings, cycle_count: int) -> Ahead:
        """Return how the robot drives on from a cycle with other parameters.

        The base is taken to reach each command at once.

        Raises:
            ApplrError: The parameters contradict each other.
        """
        self._put_in_force(settings)
        # The recorded map is inflated anew, by these parameters.
        self._shown = None
        self._costmap.restore(asked.map, asked.pose)
        self._take(asked)
        poses = [asked.pose]
        twist = asked.twist
        while len(poses) <= cycle_count:
            twist = self._local.compute_velocity(poses[-1], twist, self._costmap)[1]
            v, w = twist
            poses.append(arc(poses[-1], v, w, self.period))
        return Ahead(np.array(poses)[:, :2], self._map().lethal_points)

    # -- state of the MoveBase, which each question sets anew --------------------------------------
    def _command(self, asked: Asked) -> Twist:
        self._put_in_force(asked.settings)
        self._show(asked.map)
        self._take(asked)
        command: Twist
        _, command = self._local.compute_velocity(asked.pose, asked.twist, self._costmap)
        return command

    def _put_in_force(self, settings: Settings) -> None:
        """Set the parameters of the local planner and of the costmaps' layers."""
        if settings is self._settings:
            return
        # A call of a costmap's server clears it, and a refused value leaves some of the others set.
        self._settings = None
        self._shown = None
        self._move_base.put_in_force(settings)
        self._settings = settings

    def _show(self, map_shown: MapSnapshot) -> None:
        if map_shown is not self._shown:
            self._costmap.restore(map_shown)
            self._shown = map_shown

    def _remembered(self) -> MapSnapshot:
        self._shown = self._costmap.snapshot()
        return self._shown

    def _take(self, asked: Asked) -> None:
        """Give the planner the plan and the memory of a cycle."""
        self._remember(asked.memory)
        # A new plan may clear flags. The same plan, given again, must not.
        self._local.set_plan(asked.plan)
        if not asked.is_new:
            self._remember(asked.memory)

    def _remember(self, memory: Memory) -> None:
        self._local.planner.state = memory.flags
        self._local.is_turning = memory.is_turning

    def _memory(self) -> Memory:
        return Memory(self._local.planner.state, self._local.is_turning)

    def _map(self) -> LocalMap:
        return LocalMap(
            cells=self._costmap.cells.copy(),
            origin=self._costmap.origin.copy(),
            resolution=self._costmap.resolution,
            footprint=self._costmap.footprint.copy(),
        )
