"""Dimensionless encoding of observations and actions, whose numbers have the same meaning for every robot.

Lengths are in padded widths (width of the padded footprint), speeds in shares of the base's maximum speed, and the
planner's distance biases in cost per padded width. The same training options therefore suit any robot, and
training/tune can transfer a parameter set from one robot to another. The paper's encoding is in encoding.py.

A policy chooses only the parameters of OUTPUTS that the robot's parameter space has, within their ranges. The other
parameters have the values stored with the policy (`base`), or their default values.
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
VERSION = "dimensionless-2"  # version of this encoding in policy files
JACKAL_SPEED = 2.0  # maximum speed of the Jackal's base [m/s]
SECTORS = 240  # number of sectors in a full turn, 1.5 degrees each; sectors outside the field of view count as free
# Range cap, lookahead distances on the plan, distance caps of the goal and of moving obstacles [padded widths].
CAP, NEAR_POINT, FAR_POINT, GOAL_CAP, MOVER_CAP = 8.0, 2.0, 5.0, 30.0, 15.0
MOVING, DESCRIBED = 13, 14  # numbers of entries for motion and route, and for the robot's description
MOVERS = 3  # number of nearest moving obstacles in an observation, with four entries each
NO_MOVER = (1.0, 0.0, 0.0, 0.0)  # placeholder for a missing moving obstacle: far ahead and static
BEFORE_MOVERS = 2 * SECTORS + MOVING + len(OUTPUTS) + DESCRIBED  # index of the first entry of moving obstacles
SIZE = BEFORE_MOVERS + 4 * MOVERS  # number of entries of an observation
# Indices, counted after the scans, of the lateral positions and velocities of moving obstacles.
SIDEWAYS = tuple(BEFORE_MOVERS - 2 * SECTORS + 4 * i + k for i in range(MOVERS) for k in (1, 3))


class DimensionlessEncoding(Encoding):
    """Dimensionless encoding of observations and actions for one robot.

    An observation has SIZE numbers in [-1, 1]: the current and the previous scan, the directions of two points of the
    global plan, direction and distance of the goal, speed and turn rate with their changes, the distance driven since
    the last decision, the current parameters, and the description of the robot. At the end are position and velocity of
    the nearest MOVERS moving obstacles in the robot's frame, or NO_MOVER if there are fewer.

    Args:
        robot, base: As for an Encoding.
        period: Decision period [s], by which the distance driven since the last decision is normalised.

    Attributes:
        width: Padded width of the robot [m].
    """

    name, redraws_stalled = DIMENSIONLESS, True
    size, actions, scan, scans, mirror_sign = SIZE, len(OUTPUTS), 2 * SECTORS, 2, (0, 2, 4, 7, 9, 11, *SIDEWAYS)

    def __init__(self, robot: Robot, period: Optional[float], base: Optional[Mapping[str, float]] = None):
        if period is None:
            raise ValueError("the dimensionless observation depends on the decision period: set `period`")
        super().__init__(robot, period, base)
        tree = robot.all_parameters()
        self.width = float(np.ptp(footprint.padded(tree["local_costmap"])[:, 1]))
        self.layout, self.scale = _layout(robot, self.width), self.width / JACKAL_WIDTH
        self.pace = self.scale * JACKAL_SPEED / robot.base.max_speed
        planner = str(tree["base_local_planner"]).rpartition("/")[2]
        resolution = float(tree["local_costmap"]["resolution"])
        by_planner = 1.0 / resolution if planner == DWA else 1.0  # DWAPlannerROS multiplies biases by the resolution.
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
        """Return version, period and base, which do not depend on the robot."""
        return {"observation": VERSION, "period_s": self.period, "base": self.base}

    @classmethod
    def of(cls, metadata: Mapping[str, Any], robot: Robot) -> DimensionlessEncoding:
        """Make the encoding from a policy's metadata, for any robot."""
        if metadata["observation"] != VERSION:
            raise ApplrError(f"its observation is {metadata['observation']}: {VERSION} is needed")
        return cls(robot, period_of(metadata), metadata["base"])

    def reset(self) -> None:
        """Forget the previous decision at the start of a course."""
        self._before: Optional[Tuple[np.ndarray, Context]] = None

    def action(self, theta: Any) -> np.ndarray:
        """Return the action (12,) in [-1, 1] that encodes parameters (n,) of the robot's space."""
        values = self._fixed.copy()
        for i, place in self._place:
            values[place] = theta[i]
        low, high = self._low, self._high
        linear = (values - low) / (high - low)
        by_log = np.log2(np.maximum(values, 1e-9) / self._first) / self._octaves
        return np.clip(2.0 * np.where(self._logarithmic, by_log, linear) - 1.0, -1.0, 1.0)

    def theta(self, action: Any) -> np.ndarray:
        """Return the parameters (n,) of the robot's space for an action (12,), as Encoding.theta does."""
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
        """Return the observation (SIZE,) float32 of a decision, and keep scan and context for the next one."""
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
        """Return the scaled x, y, vx, vy of the nearest moving obstacles in the robot's frame, (4 MOVERS,)."""
        if not len(context.movers):
            return np.tile(NO_MOVER, MOVERS)
        x, y, vx, vy = np.asarray(context.movers, dtype=np.float64).reshape(-1, 4).T
        back = inverse(context.pose)
        x, y = transform_point(back, x, y)
        vx, vy = transform_point((0.0, 0.0, back[2]), vx, vy)
        nearest = np.column_stack([x, y, vx, vy])[np.argsort(np.hypot(x, y), kind="stable")][:MOVERS]
        nearest /= [MOVER_CAP * self.width] * 2 + [self.robot.base.max_speed] * 2
        return np.concatenate([nearest.ravel(), np.tile(NO_MOVER, MOVERS - len(nearest))])

    def _scan(self, ranges: np.ndarray) -> np.ndarray:
        """Return ranges (beams,) [m] as entries (SECTORS,) in [-1, 1], with a higher resolution for short ranges."""
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
        raise ApplrError(f"robot {robot.name}: its laser covers {first:.3f} to {last:.3f} rad, not ahead")
    outer = 0.5 * (beams - 1) * step
    return Layout(beams, -outer, outer, CAP * width, NEAR_POINT * width)


def _start(tree: Dict[str, Any], planner: str, name: str) -> float:
    """Return the default value of a parameter from the robot's files, or 0.0 if they have none."""
    values = branch(tree, planner)
    for known in (known for known, of in NAMES.items() if of == name):
        if known in values:
            return float(values[known])
    layers = [part for part in branch(tree, "local_costmap").values() if isinstance(part, dict) and name in part]
    return float(layers[0][name]) if layers else 0.0


def _description(robot: Robot, tree: Dict[str, Any], planner: str, width: float, resolution: float) -> np.ndarray:
    """Return the entries (DESCRIBED,) that describe the robot, each about -1 to 1; wide-ranging ones as log2."""
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


ENCODINGS: Dict[str, Type[Encoding]] = {PAPER: PaperEncoding, DIMENSIONLESS: DimensionlessEncoding}
