"""Common base of the two local planners that sample velocities, trajectory/ and dwa/.

Contains the base class with parameters and memory between cycles, the choice of a cycle, clouds of costs for display,
and angle functions equal to those of C++ to the last bit. A heap orders the samples by the lower bound of their cost,
and samples with equal bounds by their number.
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
    Optional,
    Sequence,
    Tuple,
)

import numpy as np

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.grid import INSCRIBED

Triple = Tuple[
    float, float, float
]  # pose (x, y, yaw) [m, rad] or velocity (vx, vy, w) [m/s, rad/s]
RollOut = Callable[[np.ndarray], None]  # writes the poses of a trajectory to an array (count, 3)
LARGEST_TURN = (
    0.5  # largest turn per step in closed forms [rad]; the chord formula fails near a full turn
)


class Record:
    """Type of one record of PARAMETERS or STATE in a kernel, with the fields as attributes."""

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> float: ...
        def __setattr__(self, name: str, value: float) -> None: ...


@kernel
def through_quaternion(yaw: float) -> float:
    """Return an angle after conversion to a quaternion and back: in (-pi, pi], last bits may differ."""
    z = math.sin(yaw / 2)
    w = math.cos(yaw / 2)
    return math.atan2(2 * (w * z), w * w - z * z)


@kernel
def take_start(start: Data, pose: Triple, velocity: Triple) -> None:
    """Store pose and velocity in `start` (6,) as C++ does: angles pass through a quaternion, all become float32."""
    start[0] = np.float32(pose[0])
    start[1] = np.float32(pose[1])
    start[2] = np.float32(through_quaternion(pose[2]))
    start[3] = np.float32(velocity[0])
    start[4] = np.float32(velocity[1])
    start[5] = np.float32(through_quaternion(velocity[2]))


@kernel
def angle_difference(a: float, b: float) -> float:
    """Return the angle from a to b, in (-pi, pi]."""
    r: float = np.fmod(b - a + math.pi, 2.0 * math.pi)
    return r + math.pi if r <= 0.0 else r - math.pi


@kernel
def small_turn(a: float) -> Tuple[float, float]:
    """Return (cos a, sin a) from their series, accurate to about 1e-15 for |a| <= .25."""
    t = a * a
    return (
        1 - t / 2 * (1 - t / 12 * (1 - t / 30 * (1 - t / 56))),
        a * (1 - t / 6 * (1 - t / 20 * (1 - t / 42 * (1 - t / 72)))),
    )


@kernel
def sift_down(heap: Data, keys: Data, count: int, i: int) -> None:
    """Restore the heap of sample numbers (lowest key, then lowest number on top) after the key of heap[i] grew."""
    sample = heap[i]
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and _before(keys, heap[child + 1], heap[child]):
            child += 1
        if not _before(keys, heap[child], sample):
            break
        heap[i] = heap[child]
        i = child
    heap[i] = sample


@kernel
def _before(keys: Data, a: int, b: int) -> bool:
    return keys[a] < keys[b] or (keys[a] == keys[b] and a < b)


def record(reals: str, integers: str, after: str = "") -> np.dtype:
    """Return the dtype of a record of float64, int64 and again float64 fields. Names are separated by blanks."""
    fields = [(name, np.float64) for name in reals.split()] + [
        (name, np.int64) for name in integers.split()
    ]
    return np.dtype(fields + [(name, np.float64) for name in after.split()])


def floats(values: Iterable[float]) -> Triple:
    """Return three numbers as floats, the only number type for which the kernels are compiled."""
    a, b, c = (float(value) for value in values)
    return a, b, c


class Choice:
    """Trajectory and command that the planner chooses in one cycle.

    Attributes:
        cost: cost of the trajectory, negative if there is no valid command.
        vx, vy, w: velocity of the trajectory [m/s, rad/s].
        drive: command (vx, vy, w), zero if there is none. Its w went through a quaternion.
        count: number of points of the trajectory.
        sample: number in the order of sampling, -1 if there is none or samples are not numbered.
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
        self.cost, self.drive, self.count, self.sample = cost, drive, count, sample
        self.vx, self.vy, self.w = velocity
        self._roll_out = roll_out
        self._points: Optional[np.ndarray] = None

    @property
    def points(self) -> np.ndarray:
        """Poses (count, 3) x, y [m], yaw [rad] of the trajectory, computed on first use: training never needs them."""
        if self._points is None:
            self._points = np.empty((self.count, 3))
            if self.count:
                self._roll_out(self._points)
        return self._points


class SamplingPlanner:
    """Base class of planners that choose one of many sampled velocities per cycle. Subclasses define the search.

    Attributes:
        PARAMETERS, STATE: dtypes of the records that the kernels take.
        SAMPLES: names of the parameters that are numbers of samples. Values below 1 become 1.
    """

    PARAMETERS: np.dtype
    STATE: np.dtype
    SAMPLES: Tuple[str, ...]
    DERIVED: Tuple[str, ...] = (
        "sim_period",
    )  # computed fields of PARAMETERS, not parameters of the server

    def __init__(self, params: Mapping[str, Any]):
        self._resolution: Any = None
        self._shape: Any = None  # (ny, nx)
        self._grids: Any = None
        self._lines: Any = None
        self._scratch: Any = None
        self._state = np.zeros(1, self.STATE)
        self._values: Dict[str, Any] = {}
        self.reconfigure(params)

    def reconfigure(self, params: Mapping[str, Any]) -> None:
        """Apply checked values {name: value} of some or all parameters of the server, between two cycles."""
        names = [name for name in self.PARAMETERS.names or () if name not in self.DERIVED]
        self._values = dict(
            self._values, **{name: params[name] for name in names if name in params}
        )
        self._values.update({name: max(int(self._values[name]), 1) for name in self.SAMPLES})
        self._scratch = self._allocate_scratch(*(self._values[name] for name in self.SAMPLES))
        self._take_parameters()

    def _take_parameters(self) -> None:
        made = np.zeros(1, self.PARAMETERS)  # Choices of earlier cycles keep the old record.
        for name, value in self._values.items():
            made[name] = value
        self._derive(made, self._resolution)
        self._params = made

    def _derive(self, made: np.ndarray, resolution: Optional[float]) -> None:
        """Compute the derived fields from the others and the map resolution [m], None before the first map."""
        raise NotImplementedError

    def _allocate_scratch(self, *samples: int) -> Any:
        raise NotImplementedError

    def _fits(self, costmap: Any) -> bool:
        """Return whether the map's size and resolution are unchanged. If not, store them for new grids and tables."""
        resolution = float(costmap.resolution)
        if costmap.cells.shape == self._shape and resolution == self._resolution:
            return True
        self._shape, self._resolution = costmap.cells.shape, resolution
        self._take_parameters()
        return False

    @property
    def state(self) -> List[float]:
        """Memory between cycles in the order of STATE. It can be assigned."""
        return list(self._state[0].item())

    @state.setter
    def state(self, values: Sequence[float]) -> None:
        self._state[0] = tuple(values)

    @property
    def start(self) -> np.ndarray:
        """Pose and velocity (6,) used in the last cycle: wrapped and rounded to float32."""
        return np.array(self._scratch.start)

    def reset(self) -> None:
        """Clear the memory between cycles, as in a new object (for training episodes)."""
        self._state[:] = np.zeros(1, self.STATE)


def cost_cloud(
    costmap: Any,
    path: np.ndarray,
    goal: np.ndarray,
    inside: np.ndarray,
    weights: Tuple[float, float, float],
) -> np.ndarray:
    """Return (k, 7) float32 x, y, z, path, goal, obstacle and total cost of the cells free for the robot's centre.

    The cloud is for display, with the cells column by column (MapGridVisualizer::publishCostCloud).

    Args:
        costmap: map with cells (ny, nx), origin and resolution.
        path: (ny, nx) int32, distances to the plan [cells].
        goal: (ny, nx) int32, distances to the plan's end [cells].
        inside: (ny, nx) bool, False for cells to leave out in any case.
        weights: weights of path, goal and obstacle cost in the total.
    """
    inside = inside & (path < costmap.cells.size) & (costmap.cells < INSCRIBED)
    column, row = np.nonzero(inside.T)
    cells = costmap.cells.T
    cloud = np.zeros((len(row), 7), np.float32)
    cloud[:, 0] = costmap.origin[0] + (column + 0.5) * costmap.resolution
    cloud[:, 1] = costmap.origin[1] + (row + 0.5) * costmap.resolution
    cloud[:, 3] = path.T[column, row]
    cloud[:, 4] = goal.T[column, row]
    cloud[:, 5] = cells[column, row]
    cloud[:, 6] = (
        weights[0] * path.T[column, row]
        + weights[1] * goal.T[column, row]
        + weights[2] * cells[column, row]
    )
    return cloud


def trajectory_cloud(points: np.ndarray) -> np.ndarray:
    """Return (k, 5) float32 x, y, z, theta, cost from trajectory points (k, 4) x, y, theta, cost, for display."""
    cloud = np.zeros((len(points), 5), np.float32)
    cloud[:, :2], cloud[:, 3:] = points[:, :2], points[:, 2:]
    return cloud
