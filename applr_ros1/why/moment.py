"""Moment of a drive: what the local planner is given in a control cycle, and what it says."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, List, Mapping, NamedTuple, Optional, Tuple

import numpy as np

from applr_ros1.common.angles import (
    Pose,
    Twist,
    compose,
    inverse,
    normalize_angle_modulo,
    transform_point,
)
from applr_ros1.common.paths import distances
from applr_ros1.planner.costmap import footprint as footprints
from applr_ros1.planner.costmap.grid import LETHAL
from applr_ros1.planner.parameters.settings import Settings
from applr_ros1.planner.sampling_planner import CostParts
from applr_ros1.why.stretch import SLOW

# A sample drives on if it is at least SLOW, or nearly the fastest sample if this is slower.
FASTEST = 0.95
STEP_S = 0.1  # interval between the poses at which an illegal sample is checked [s]
NEAR_M = 0.1  # distance from an obstacle cell within which a point of a scan shows it [m]
BACK = np.pi / 2  # angle between plan and heading from which on the plan leads back [rad]

# Local costmap, to be restored: origin, cells, and the cells of each obstacle layer
MapSnapshot = Tuple[np.ndarray, ...]


class Memory(NamedTuple):
    """State that a local planner keeps from cycle to cycle.

    Attributes:
        flags: Flags of the search, in the order of the planner's STATE.
        is_turning: Whether it turns the robot to the goal's heading.
    """

    flags: List[float]
    is_turning: bool = False


@dataclass(frozen=True)
class Asked:
    """Inputs of the local planner in a control cycle.

    Attributes:
        at: Time of its command [s].
        pose: Pose (x, y, yaw) [m, m, rad] of the robot in the odometry frame.
        twist: Measured v [m/s], w [rad/s] of the robot.
        plan: Plan (n, 3) that is followed, in the odometry frame.
        map: Local costmap.
        memory: Memory of the planner before the cycle.
        is_new: Whether the plan is new, which may clear the flags.
        settings: Parameters in force.
    """

    at: float
    pose: Pose
    twist: Twist
    plan: np.ndarray
    map: MapSnapshot
    memory: Memory
    is_new: bool
    settings: Settings


class LocalMap(NamedTuple):
    """Local costmap of a cycle in the odometry frame.

    Attributes:
        cells: (rows, columns) costs uint8.
        origin: (2,) lower left corner x, y [m].
        resolution: Edge of a cell [m].
        footprint: (n, 2) vertices of the padded footprint in the robot's frame [m].
    """

    cells: np.ndarray
    origin: np.ndarray
    resolution: float
    footprint: np.ndarray

    @property
    def lethal_points(self) -> np.ndarray:
        """Centres (n, 2) [m] of the lethal cells."""
        rows, columns = np.nonzero(self.cells == LETHAL)
        centres = np.column_stack([columns, rows]) + 0.5
        points: np.ndarray = self.origin + centres * self.resolution
        return points

    def first_illegal(self, poses: List[Pose]) -> Optional[Pose]:
        """Return the first pose at which the footprint meets an obstacle or what is unknown."""
        origin_x, origin_y = self.origin.tolist()
        for x, y, yaw in poses:
            cost = footprints.footprint_cost(
                self.cells,
                origin_x,
                origin_y,
                self.resolution,
                self.footprint,
                (float(x), float(y), float(yaw)),
            )
            if cost < 0:
                return x, y, yaw
        return None


class ComparedSamples(NamedTuple):
    """Velocities that the planner compares in a cycle.

    Attributes:
        velocities: (n, 2) v [m/s], w [rad/s].
        costs: (n,) costs; negative for illegal samples.
        parts: Parts (n,) of the costs by term.
    """

    velocities: np.ndarray
    costs: np.ndarray
    parts: CostParts


class MetObstacle(NamedTuple):
    """Cell of the local costmap that a robot meets.

    Attributes:
        place: x, y [m] in the odometry frame.
        ahead: Distance ahead of the robot [m].
        left: Distance to its left [m].
        is_in_scan: Whether the latest scan shows it. Else it is in the map until a beam clears it.
    """

    place: Tuple[float, float]
    ahead: float
    left: float
    is_in_scan: bool


@dataclass(frozen=True)
class CycleMoment:
    """Inputs of the planner in a cycle, and its answer.

    Attributes:
        asked: What it was given.
        planner: Name of the planner.
        lookahead: Distance of the point of the plan that shows where it leads [m].
        command: Command v [m/s], w [rad/s].
        samples: What it compared.
        trajectory_points: (k, 3) points x, y [m] of legal trajectories, with their costs.
        map: Local costmap.
        scan_points: (n, 2) points of the latest scan in the odometry frame [m].
    """

    asked: Asked
    planner: str
    lookahead: float
    command: Twist
    samples: ComparedSamples
    trajectory_points: np.ndarray
    map: LocalMap
    scan_points: np.ndarray

    @property
    def values(self) -> Mapping[str, Any]:
        """Parameters {name: value} of the planner in force."""
        return self.asked.settings[self.planner]

    @property
    def drives_on(self) -> np.ndarray:
        """Return whether each sample (n,) is fast enough to drive on."""
        speeds = self.samples.velocities[:, 0]
        drives_on: np.ndarray = speeds >= min(
            SLOW * self.values["max_vel_x"], FASTEST * speeds.max()
        )
        return drives_on

    @property
    def winner(self) -> int:
        """Row of the command among the samples, of which it is one, or was rounded a little."""
        differences = np.abs(self.samples.velocities - self.command).sum(axis=1)
        return int(differences.argmin())

    @property
    def best(self) -> Optional[int]:
        """Row of the cheapest legal sample that drives on, or None."""
        legal_rows = np.flatnonzero(self.drives_on & (self.samples.costs >= 0))
        if not len(legal_rows):
            return None
        cheapest_index = self.samples.costs[legal_rows].argmin()
        return int(legal_rows[cheapest_index])

    @property
    def illegal_rows(self) -> np.ndarray:
        """Rows of the illegal samples that are fast enough to drive on."""
        return np.flatnonzero(self.drives_on & (self.samples.costs < 0))

    @property
    def straightest_illegal(self) -> int:
        """Row of the illegal sample that turns least among those that drive on; -1 without one."""
        rows = self.illegal_rows
        if not len(rows):
            return -1
        turn_rates = np.abs(self.samples.velocities[rows, 1])
        return int(rows[turn_rates.argmin()])

    @property
    def fastest_speed(self) -> float:
        """Speed of the fastest sample [m/s]."""
        return float(self.samples.velocities[:, 0].max())

    @property
    def leads_back(self) -> bool:
        """True if the plan begins by more than a right angle off the robot's heading."""
        x, y, yaw = self.asked.pose
        points = self.asked.plan[:, :2]
        from_robot = distances(points, np.array([x, y]))
        # The first point at some distance shows the way: those beside the robot lie anywhere.
        first_point = int(from_robot.argmin())
        rows_beyond = np.flatnonzero(from_robot[first_point:] >= self.lookahead)
        if not len(rows_beyond):
            return False
        dx, dy = points[first_point + rows_beyond[0]] - (x, y)
        angle = float(normalize_angle_modulo(np.arctan2(dy, dx) - yaw))
        return abs(angle) > BACK

    @property
    def obstacle(self) -> Optional[MetObstacle]:
        """Lethal cell that the footprint meets first with the straightest illegal one, or None."""
        if self.straightest_illegal < 0:
            return None
        v, w = self.samples.velocities[self.straightest_illegal].tolist()
        drive_times = np.arange(0.0, self.values["sim_time"], STEP_S)
        poses = [arc(self.asked.pose, v, w, drive_time) for drive_time in drive_times]
        lethal_points = self.map.lethal_points
        if not len(lethal_points):
            return None
        pose = self.map.first_illegal(poses)
        if pose is None:
            return None
        # The lethal point nearest to the box around the footprint
        outline = self.map.footprint
        x, y = transform_point(inverse(pose), *lethal_points.T)
        from_footprint = np.column_stack([x, y])
        nearest_in_box = np.clip(from_footprint, outline.min(axis=0), outline.max(axis=0))
        nearest = int(distances(from_footprint, nearest_in_box).argmin())
        place_x, place_y = lethal_points[nearest].round(3).tolist()
        ahead, left = transform_point(inverse(self.asked.pose), place_x, place_y)
        scan_distances = distances(self.scan_points, np.array([place_x, place_y]))
        is_in_scan = bool(scan_distances.min(initial=np.inf) < NEAR_M)
        return MetObstacle((place_x, place_y), ahead, left, is_in_scan)


def arc(pose: Pose, v: float, w: float, seconds: float) -> Pose:
    """Return the pose after some time of driving with a constant command: v [m/s], w [rad/s].

    The chord of a circular arc points into half of the turn.
    """
    turn = w * seconds
    half_turn = 0.5 * turn
    chord = v * seconds
    if half_turn != 0.0:
        chord *= math.sin(half_turn) / half_turn
    return compose(pose, (chord * math.cos(half_turn), chord * math.sin(half_turn), turn))
