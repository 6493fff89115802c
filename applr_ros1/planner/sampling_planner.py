"""Common base of the two local planners that sample velocities, trajectory/ and dwa/.

Contains the base class with parameters and memory between cycles, the choice of a cycle, clouds of
costs for display, and angle functions equal to those of C++ to the last bit. Their common search is
in search/.
"""

from __future__ import annotations

import math
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    Iterable,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

import numpy as np

from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import INSCRIBED

# Pose (x, y, yaw) [m, rad] or velocity (vx, vy, w) [m/s, rad/s].
Triple = Tuple[float, float, float]
RollOut = Callable[[np.ndarray], None]  # writes the poses of a trajectory to an array (count, 3)


class Velocity(NamedTuple):
    """Velocity of the base in its own axes."""

    vx: float  # [m/s]
    vy: float  # [m/s]
    w: float  # [rad/s]


class Heading(NamedTuple):
    """Direction of a yaw angle, or a change of direction."""

    cos: float
    sin: float


class CostTerm(NamedTuple):
    """Part of the cost of a sample, in the words of `why`."""

    name: str  # name in C++
    title: str  # what is measured
    parameter: str  # parameter that weights it
    objection: str  # what a sample does that costs more, such as "turns the robot faster"
    # What a sample does that is refused, with the values of parameters in braces
    refusal: str = ""


# Parts (m,) of the costs of samples
CostParts = Dict[CostTerm, np.ndarray]
# Both planners have these terms, under names of their own.
PATH_TERM = CostTerm(
    name="path_distance_bias",
    title="distance from the plan",
    parameter="path_distance_bias",
    objection="leads farther away from the plan",
)
GOAL_TERM = CostTerm(
    name="goal_distance_bias",
    title="distance from the local goal",
    parameter="goal_distance_bias",
    objection="ends farther away from the local goal",
)
OBSTACLE_TERM = CostTerm(
    name="occdist_scale",
    title="nearness to obstacles",
    parameter="occdist_scale",
    objection="leads closer to obstacles",
)


class Record:
    """Type of one record of PARAMETERS, STATE or START in a kernel, with fields as attributes."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> float: ...
        def __setattr__(self, name: str, value: float) -> None: ...


@kernel
def through_quaternion(yaw: float) -> float:
    """Return an angle [rad] after conversion to a quaternion and back.

    It is in (-pi, pi], and its last bits may differ from those of the argument.
    """
    z = math.sin(yaw / 2)
    w = math.cos(yaw / 2)
    return math.atan2(2 * (w * z), w * w - z * z)


@kernel
def single(value: float) -> float:
    """Return `value` rounded to float32, as a double."""
    return np.float64(np.float32(value))


@kernel
def take_start(start: Record, pose: Triple, velocity: Triple) -> None:
    """Store pose and velocity in a START record as C++ does.

    Angles pass through a quaternion, and all numbers become float32.
    """
    start.x = single(pose[0])
    start.y = single(pose[1])
    start.theta = single(through_quaternion(pose[2]))
    start.vx = single(velocity[0])
    start.vy = single(velocity[1])
    start.w = single(through_quaternion(velocity[2]))


@kernel
def heading_of(theta: float) -> Heading:
    """Return the direction of the angle theta [rad]."""
    return Heading(math.cos(theta), math.sin(theta))


@kernel
def turned(heading: Heading, turn: Heading) -> Heading:
    """Return the heading after a change of direction."""
    cos = heading.cos * turn.cos - heading.sin * turn.sin
    return Heading(cos, heading.sin * turn.cos + heading.cos * turn.sin)


@kernel
def angle_difference(a: float, b: float) -> float:
    """Return the angle from a to b, in (-pi, pi]."""
    remainder: float = np.fmod(b - a + math.pi, 2.0 * math.pi)
    if remainder <= 0.0:
        return remainder + math.pi
    return remainder - math.pi


def braked(velocity: Triple, accelerations: Sequence[float], period: float) -> Triple:
    """Return the velocity (vx, vy [m/s], w [rad/s]) after one control period of braking.

    accelerations: limits (3,) [m/s^2, m/s^2, rad/s^2]. period: control period [s].
    """
    slower_velocity = []
    for speed, limit in zip(velocity, accelerations):
        sign = -1.0 if speed < 0 else 1.0
        slower_velocity.append(sign * max(0.0, abs(speed) - limit * period))
    return floats(slower_velocity)


def turn_speed(error: float, wanted: float, w: float, acceleration: float, period: float) -> float:
    """Return the speed [rad/s], without sign, at which a robot turns to its goal's yaw.

    Args:
        error: Angle to the goal's yaw [rad].
        wanted: Speed of the turn without the limits below [rad/s].
        w: Measured turn rate [rad/s], whose sign does not count, as in C++.
        acceleration: Largest yaw acceleration [rad/s^2].
        period: Control period [s].
    """
    # Within the dynamic window, and able to stop at the goal's yaw: v^2 = 2 a s
    largest_change = acceleration * period
    reachable_speed = min(max(wanted, abs(w) - largest_change), abs(w) + largest_change)
    return min(math.sqrt(2 * acceleration * abs(error)), reachable_speed)


def record(reals: str, integers: str, after: str = "") -> np.dtype:
    """Return the dtype of a record of float64, int64 and again float64 fields.

    Names are separated by blanks.
    """
    fields = []
    for field_names, field_type in ((reals, np.float64), (integers, np.int64), (after, np.float64)):
        fields += [(field_name, field_type) for field_name in field_names.split()]
    return np.dtype(fields)


# Pose x, y [m], theta [rad] and velocity vx, vy [m/s], w [rad/s] at which all samples start.
START = record("x y theta vx vy w", "")


def start_record(values: Iterable[float]) -> Any:
    """Return a START record with the pose x, y, theta and the velocity vx, vy, w."""
    return np.array([tuple(values)], START)[0]


def follow_sample(
    roll_out: Callable[..., None],
    p: Record,
    start: Iterable[float],
    sample: Velocity,
    points: np.ndarray,
) -> None:
    """Write the poses of a sample's trajectory to `points`, by a planner's kernel `roll_out`.

    start: values of the sample's START record.
    """
    roll_out(p, start_record(start), sample, points)


def floats(values: Iterable[float]) -> Triple:
    """Return three numbers as floats, the only number type for which the kernels are compiled."""
    first, second, third = (float(value) for value in values)
    return first, second, third


class CycleChoice:
    """Trajectory and command that the planner chooses in one cycle.

    Attributes:
        cost: cost of the trajectory, negative if there is no valid command.
        vx, vy, w: velocity of the trajectory [m/s, rad/s].
        drive: command (vx, vy, w), zero if there is none. Its w went through a quaternion.
        count: number of points of the trajectory.
        sample: number in the order of sampling, -1 if there is none or samples are not numbered.

    Args:
        cost, drive, count, sample: see above.
        velocity: velocity of the trajectory.
        roll_out: function that writes the trajectory's poses to an array.
    """

    __slots__ = ("cost", "vx", "vy", "w", "drive", "count", "sample", "_roll_out", "_points")

    def __init__(
        self,
        cost: float,
        velocity: Triple,
        drive: Triple,
        count: int,
        roll_out: RollOut,
        sample: int = -1,
    ):
        self.cost = cost
        self.drive = drive
        self.count = count
        self.sample = sample
        self.vx, self.vy, self.w = velocity
        self._roll_out = roll_out
        self._points: Optional[np.ndarray] = None

    @property
    def points(self) -> np.ndarray:
        """Poses (count, 3) x, y [m], yaw [rad] of the trajectory.

        They are computed on first use, because training never needs them.
        """
        if self._points is None:
            self._points = np.empty((self.count, 3))
            if self.count:
                self._roll_out(self._points)
        return self._points


class SamplingPlanner:
    """Base class of planners that choose one of many sampled velocities per cycle.

    Subclasses define the search.

    Attributes:
        PARAMETERS, STATE: dtypes of the records that the kernels take.
        SAMPLES: names of the parameters that are numbers of samples. Values below 1 become 1.
        DERIVED: computed fields of PARAMETERS, which are not parameters of the server.
    """

    PARAMETERS: np.dtype
    STATE: np.dtype
    SAMPLES: Tuple[str, ...]
    DERIVED: Tuple[str, ...]

    def __init__(self, params: Mapping[str, Any]):
        self._resolution: Any = None
        self._shape: Any = None  # (ny, nx)
        self._grids: Any = None
        self._lines: Any = None
        self._scratch: Any = None
        self._state = np.zeros(1, self.STATE)
        self._params = np.zeros(1, self.PARAMETERS)
        self.reconfigure(params)

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Apply checked values {name: value} of some or all of the server's parameters.

        Call it between two cycles.
        """
        # A new record, because a failure must leave the old one in force, which choices of earlier
        # cycles keep.
        new_record = self._params.copy()
        for name in self.PARAMETERS.names or ():
            if name in params and name not in self.DERIVED:
                new_record[name] = params[name]
        sample_counts = []
        for name in self.SAMPLES:
            new_record[name] = max(int(new_record[name][0]), 1)
            sample_counts.append(int(new_record[name][0]))
        self._scratch = self._allocate_scratch(*sample_counts)
        self._take(new_record)

    def _take(self, new_record: np.ndarray) -> None:
        """Put parameters in force, with the fields that follow from them and from the map."""
        self._derive(new_record, self._resolution)
        self._params = new_record

    def _derive(self, record: np.ndarray, resolution: Optional[float]) -> None:
        """Compute the derived fields from the others and the map's resolution [m].

        The resolution is None before the first map.
        """
        raise NotImplementedError

    def _allocate_scratch(self, *samples: int) -> Any:
        raise NotImplementedError

    def _take_map_size(self, costmap: Any) -> bool:
        """Store the map's size and resolution, and return whether one of them is new.

        If so, the caller makes new grids and tables.
        """
        resolution = float(costmap.resolution)
        if costmap.cells.shape == self._shape and resolution == self._resolution:
            return False
        self._shape = costmap.cells.shape
        self._resolution = resolution
        # Some derived parameters depend on the resolution.
        self._take(self._params.copy())
        return True

    @property
    def state(self) -> List[float]:
        """Memory between cycles in the order of STATE. It can be assigned."""
        return list(self._state[0].item())

    @state.setter
    def state(self, values: Sequence[float]) -> None:
        self._state[0] = tuple(values)

    @property
    def in_force(self) -> Any:
        """Parameters in force, a record of PARAMETERS with the derived fields."""
        return self._params[0]

    @property
    def start(self) -> np.ndarray:
        """Pose and velocity (6,) used in the last cycle: wrapped and rounded to float32."""
        return np.array(self._scratch.start[0].item())


def cost_cloud(
    costmap: Any,
    path: np.ndarray,
    goal: np.ndarray,
    inside: np.ndarray,
    weights: Tuple[float, float, float],
) -> np.ndarray:
    """Return the costs of the cells that are free for the robot's centre, for display.

    Args:
        costmap: map with cells (rows, columns), origin and resolution.
        path: (rows, columns) int32, distances to the plan [cells].
        goal: (rows, columns) int32, distances to the plan's end [cells].
        inside: (rows, columns) bool, False for cells to leave out in any case.
        weights: weights of path, goal and obstacle cost in the total.

    Returns:
        (k, 7) float32: x, y, z [m], path, goal, obstacle and total cost of a cell, column by column
        (MapGridVisualizer::publishCostCloud).
    """
    shown_cells = inside & (path < costmap.cells.size) & (costmap.cells < INSCRIBED)
    columns, rows = np.nonzero(shown_cells.T)
    path_costs = path[rows, columns]
    goal_costs = goal[rows, columns]
    obstacle_costs = costmap.cells[rows, columns]
    path_weight, goal_weight, obstacle_weight = weights
    cloud = np.zeros((len(rows), 7), np.float32)
    cloud[:, 0] = costmap.origin[0] + (columns + 0.5) * costmap.resolution
    cloud[:, 1] = costmap.origin[1] + (rows + 0.5) * costmap.resolution
    cloud[:, 3] = path_costs
    cloud[:, 4] = goal_costs
    cloud[:, 5] = obstacle_costs
    cloud[:, 6] = (
        path_weight * path_costs + goal_weight * goal_costs + obstacle_weight * obstacle_costs
    )
    return cloud


def trajectory_cloud(points: np.ndarray) -> np.ndarray:
    """Return (k, 5) float32 x, y, z, theta, cost from points (k, 4) x, y, theta, cost.

    Units are m and rad. The cloud of trajectories is for display.
    """
    cloud = np.zeros((len(points), 5), np.float32)
    cloud[:, :2] = points[:, :2]
    cloud[:, 3:] = points[:, 2:]
    return cloud
