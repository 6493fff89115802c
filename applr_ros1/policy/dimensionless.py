"""The dimensionless encoding of the learning problem: numbers that mean the same on every robot.

Lengths are in padded widths of the robot, speeds in shares of what its base allows, and the planner's distance biases
in cost per padded width, so that one recipe suits any robot, and one robot's set is brought to another by
training/tuning.
The paper's own encoding is in encoding.py.

Only the parameters of OUTPUTS are chosen, as far as the robot's parameter space has them and within its ranges; the
others keep the values with which the policy was trained, or their default values.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Mapping, Optional, Tuple, Type

import numpy as np

from applr_ros1.common.angles import inverse, transform_point
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.trees import branch
from applr_ros1.planner.costmap import footprint
from applr_ros1.policy.decision import Context, period_of
from applr_ros1.policy.encoding import PAPER, Encoding, PaperEncoding
from applr_ros1.policy.layout import TURN_RAD, Layout
from applr_ros1.policy.observation import goal_angle, local_goal, without_gaps
from applr_ros1.robots import Robot
from applr_ros1.robots.check import WIDTH as JACKAL_WIDTH
from applr_ros1.robots.learned import DWA, NAMES, OUTPUTS

DIMENSIONLESS = "dimensionless"
VERSION = "dimensionless-2"  # of this encoding, in the files of policies
JACKAL_SPEED = 2.0  # what its base allows [m/s]
SECTORS = 240  # of a full turn, of 1.5 degrees; those that a laser does not see count as free
CAP, NEAR_POINT, FAR_POINT, GOAL_CAP, MOVER_CAP = 8.0, 2.0, 5.0, 30.0, 15.0  # [padded widths]
MOVING, DESCRIBED = 13, 14  # numbers of an observation that change, beside scans and parameters, and that do not
MOVERS = 3  # the nearest moving obstacles are seen, four numbers each
NO_MOVER = (1.0, 0.0, 0.0, 0.0)  # far ahead, standing
BEFORE_MOVERS = 2 * SECTORS + MOVING + len(OUTPUTS) + DESCRIBED
SIZE = BEFORE_MOVERS + 4 * MOVERS  # of an observation
SIDEWAYS = tuple(BEFORE_MOVERS - 2 * SECTORS + 4 * i + k for i in range(MOVERS) for k in (1, 3))  # of movers


class DimensionlessEncoding(Encoding):
    """Observations and actions of one robot in the dimensionless encoding.

    An observation has SIZE numbers in [-1, 1]: the scan now and at the decision before; direction of two points of the
    global plan and of the goal, distance of the goal; speed, turn rate and their changes since the last decision, the
    way driven since then; the parameters in force; what describes the robot; and place and velocity of the nearest
    MOVERS moving obstacles in the robot's frame, far ahead and standing where there are fewer.

    Args:
        robot, base: As of an Encoding.
        period: Decision period [s], to which the way driven since the last decision is related.

    Attributes:
        width: The robot's padded width [m].
    """

    name, redraws_stalled = DIMENSIONLESS, True
    size, actions, scan, scans, mirror_sign = SIZE, len(OUTPUTS), 2 * SECTORS, 2, (0, 2, 4, 7, 9, 11, *SIDEWAYS)

    def __init__(self, robot: Robot, period: Optional[float], base: Optional[Mapping[str, float]] = None):
        if period is None:
            raise ValueError("the dimensionless observation depends on the decision period: state it")
        super().__init__(robot, period, base)
        tree = robot.all_parameters()
        self.width = float(np.ptp(footprint.padded(tree["local_costmap"])[:, 1]))
        self.layout, self.scale = _layout(robot, self.width), self.width / JACKAL_WIDTH
        self.pace = self.scale * JACKAL_SPEED / robot.base.max_speed
        planner = str(tree["base_local_planner"]).rpartition("/")[2]
        resolution = float(tree["local_costmap"]["resolution"])
        by_planner = 1.0 / resolution if planner == DWA else 1.0  # DWAPlannerROS multiplies its biases with it
        units = {
            "speed": robot.base.max_speed,
            "turn": robot.base.max_yaw_rate,
            "weight": by_planner * resolution / self.width,
            "length": self.width,
            "1/length": 1.0 / self.width,
        }
        rows = list(OUTPUTS.values())
        unit = np.array([units.get(row.declared.kind, 1.0) for row in rows])
        self._low, self._high = unit * np.array([row.output or (row.low, row.high) for row in rows]).T
        self._logarithmic = np.array([row.log for row in rows])
        self._first = np.where(self._logarithmic, self._low, 1.0)
        self._octaves = np.log2(np.where(self._logarithmic, self._high, 2.0) / self._first)
        names = [NAMES.get(name, name) for name in self.space.names]
        known = [(names.index(name), i) for i, name in enumerate(OUTPUTS) if name in names]
        least, most = self.space.low, self.space.high
        self._place = [(i, at) for i, at in known if self._low[at] < most[i] and least[i] < self._high[at]]
        self.chosen = tuple(self.space.names[i] for i, _ in self._place)
        self._base = self.space.clip([self.base.get(*pair) for pair in zip(self.space.names, self.space.theta0)])
        self._fixed = np.array([_start(tree, planner, name) for name in OUTPUTS], dtype=np.float64)
        self._described = _description(robot, tree, planner, self.width, resolution)
        self.reset()

    def to_metadata(self) -> Dict[str, Any]:
        """Return version, period and base, the same for every robot."""
        return {"observation": VERSION, "period_s": self.period, "base": self.base}

    @classmethod
    def of(cls, stated: Mapping[str, Any], robot: Robot) -> DimensionlessEncoding:
        """Make the encoding of a file, for any robot."""
        if stated["observation"] != VERSION:
            raise ApplrError(f"its observation is {stated['observation']}, {VERSION} is needed")
        return cls(robot, period_of(stated), stated["base"])

    def reset(self) -> None:
        """Begin a course: there is no decision before."""
        self._before: Optional[Tuple[np.ndarray, Context]] = None

    def action(self, theta: Any) -> np.ndarray:
        """Return the action (12,) in [-1, 1] that stands for parameters (n,) of the robot's space."""
        values = self._fixed.copy()
        for i, place in self._place:
            values[place] = theta[i]
        low, high = self._low, self._high
        linear = (values - low) / (high - low)
        by_log = np.log2(np.maximum(values, 1e-9) / self._first) / self._octaves
        return np.clip(2.0 * np.where(self._logarithmic, by_log, linear) - 1.0, -1.0, 1.0)

    def theta(self, action: Any) -> np.ndarray:
        """Return the parameters (n,) of the robot's space for an action (12,), within the robot's ranges.

        Raises ApplrError for NaN, infinity and another length.
        """
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (len(OUTPUTS),) or not np.isfinite(action).all():
            raise ApplrError(f"action {action!r:.80}: {len(OUTPUTS)} finite numbers are needed")
        share, low, high = 0.5 * (np.clip(action, -1.0, 1.0) + 1.0), self._low, self._high
        values = np.where(self._logarithmic, self._first * 2.0 ** (self._octaves * share), low + share * (high - low))
        theta = self._base.copy()
        for i, place in self._place:
            theta[i] = values[place]
        return self.space.clip(theta)

    def observe(self, context: Context) -> np.ndarray:
        """Return the observation (SIZE,) float32 of a decision; the next one holds what changed since.

        Raises ObservationError as observation.observe does.
        """
        scan = self._scan(context.ranges)
        earlier, then = self._before or (scan, context)
        self._before = scan, context
        base, pose = self.robot.base, context.pose
        v, w = context.twist[0] / base.max_speed, context.twist[1] / base.max_yaw_rate
        was_v, was_w = then.twist[0] / base.max_speed, then.twist[1] / base.max_yaw_rate
        away = math.hypot(context.goal[0] - pose[0], context.goal[1] - pose[1]) / (GOAL_CAP * self.width)
        bearing = math.atan2(context.goal[1] - pose[1], context.goal[0] - pose[0]) - pose[2]
        far = bearing
        if len(context.plan):
            far = goal_angle(local_goal(context.plan, pose, FAR_POINT * self.width))
        driven = math.hypot(pose[0] - then.pose[0], pose[1] - then.pose[1]) / (base.max_speed * self.period)
        moving = [
            *(math.sin(context.phi), math.cos(context.phi)),
            *(math.sin(far), math.cos(far)),
            *(math.sin(bearing), math.cos(bearing), 2.0 * min(away, 1.0) - 1.0),
            *(w, v, 0.5 * (w - was_w), 0.5 * (v - was_v)),
            *(context.phi / math.pi, 2.0 * driven - 1.0),
        ]
        rest = np.concatenate([moving, self.action(context.theta), self._described, self._movers(context)])
        return np.concatenate([scan, earlier, np.clip(rest, -1.0, 1.0)]).astype(np.float32)

    def _movers(self, context: Context) -> np.ndarray:
        """x, y, vx, vy of the nearest movers in the robot's frame, (4 MOVERS,), in [-1, 1] up to MOVER_CAP."""
        if not len(context.movers):
            return np.tile(NO_MOVER, MOVERS)
        x, y, vx, vy = np.asarray(context.movers, dtype=np.float64).reshape(-1, 4).T
        back = inverse(context.pose)
        x, y = transform_point(back, x, y)
        vx, vy = transform_point((0.0, 0.0, back[2]), vx, vy)
        found = np.column_stack([x, y, vx, vy])[np.argsort(np.hypot(x, y), kind="stable")][:MOVERS]
        found /= [MOVER_CAP * self.width] * 2 + [self.robot.base.max_speed] * 2
        return np.concatenate([found.ravel(), np.tile(NO_MOVER, MOVERS - len(found))])

    def _scan(self, ranges: np.ndarray) -> np.ndarray:
        """Ranges (beams,) [m] in all sectors of a turn (SECTORS,), in [-1, 1], finer where they are short."""
        cap = self.layout.range_cap
        seen = 2.0 * np.sqrt(np.clip(without_gaps(ranges, self.layout), 0.0, cap) / cap) - 1.0
        unseen = (SECTORS - self.layout.beams) // 2
        return np.concatenate([np.ones(unseen), seen, np.ones(SECTORS - self.layout.beams - unseen)])


def _layout(robot: Robot, width: float) -> Layout:
    laser, step = robot.laser, TURN_RAD / SECTORS
    first, last = laser.first_angle + laser.pose[2], laser.last_angle + laser.pose[2]
    half = math.pi if last - first + 1.5 * laser.increment >= TURN_RAD else min(-first, last)
    beams = 2 * min(SECTORS // 2, int(half / step + 0.5))
    if beams < 2:
        raise ApplrError(f"robot {robot.name}: its laser looks from {first:.3f} to {last:.3f} rad, not ahead")
    outer = 0.5 * (beams - 1) * step
    return Layout(beams, -outer, outer, CAP * width, NEAR_POINT * width)


def _start(tree: Dict[str, Any], planner: str, name: str) -> float:
    """The value in the robot's files of a parameter that its space may lack."""
    values = branch(tree, planner)
    for known in (known for known, of in NAMES.items() if of == name):
        if known in values:
            return float(values[known])
    layers = [part for part in branch(tree, "local_costmap").values() if isinstance(part, dict) and name in part]
    return float(layers[0][name]) if layers else 0.0


def _description(robot: Robot, tree: Dict[str, Any], planner: str, width: float, resolution: float) -> np.ndarray:
    """Describe the robot to a policy: (DESCRIBED,), each about -1 to 1; logarithms of base 2 where it spans much."""
    base, laser, values = robot.base, robot.laser, branch(tree, planner)
    sides = branch(tree, "local_costmap")
    acceleration = min(base.max_acceleration, values["acc_lim_x"])
    turning = min(base.max_yaw_acceleration, values["acc_lim_theta"])
    view = min(laser.last_angle - laser.first_angle + laser.increment, TURN_RAD) / TURN_RAD
    return np.array(
        [
            math.log2(width / 0.5),
            robot.body.size[0] / width - 1.2,
            0.5 * math.log2(base.max_speed / 0.8),
            0.5 * math.log2(base.max_speed / width / 2.0),
            base.max_yaw_rate / 2.0 - 1.0,
            0.3 * math.log2(base.max_speed / acceleration),
            0.3 * math.log2(base.max_yaw_rate / turning),
            0.5 * math.log2(tree["controller_frequency"] / 10.0),
            0.4 * math.log2(laser.rate / 15.0),
            2.0 * view - 1.0,
            0.5 * math.log2(width / resolution / 8.0),
            0.5 * math.log2(sides["width"] / width / 10.0),
            1.0 if base.drive == "two_wheel" else -1.0,
            1.0 if planner == DWA else -1.0,
        ]
    )


ENCODINGS: Dict[str, Type[Encoding]] = {PAPER: PaperEncoding, DIMENSIONLESS: DimensionlessEncoding}  # by their names
