"""Dimensionless encoding of observations and actions, with the same meaning for every robot.

Lengths are in padded widths (width of the padded footprint), speeds in shares of the base's maximum
speed, and the planner's distance biases in cost per padded width. The same training options
therefore suit any robot, and training/tune can transfer a parameter set from one robot to
another. The paper's encoding is in encoding.py.

A policy chooses only the parameters of OUTPUTS that the robot's parameter space has, within their
ranges. The other parameters have the values stored with the policy (`base`), or their default
values.
"""

from __future__ import annotations

import math
from typing import Any, Dict, List, Mapping, Optional, Tuple, Type

import numpy as np

from applr_ros1.common.angles import inverse, transform_motions
from applr_ros1.common.arrays import Array, Array32
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.parameters.trees import Tree
from applr_ros1.policy.decision import Context, Metadata, period_of
from applr_ros1.policy.encoding import PAPER, Encoding, PaperEncoding
from applr_ros1.policy.layout import TURN_RAD, Layout
from applr_ros1.policy.observation import goal_angle, half_view_of, local_goal, without_gaps
from applr_ros1.robots import Robot
from applr_ros1.robots.check import WIDTH as JACKAL_WIDTH
from applr_ros1.robots.learned import DWA, NAMES, OUTPUTS

DIMENSIONLESS = "dimensionless"
VERSION = "dimensionless-2"  # version of this encoding in policy files
JACKAL_SPEED = 2.0  # maximum speed of the Jackal's base [m/s]
# Number of sectors in a full turn, 1.5 degrees each; sectors outside the field of view count as
# free
SECTORS = 240
CAP = 8.0  # range cap [padded widths]
# Lookahead distances of two points of the plan [padded widths]
NEAR_POINT = 2.0
FAR_POINT = 5.0
# Distance caps of the goal and of moving obstacles [padded widths]
GOAL_CAP = 30.0
MOVER_CAP = 15.0
MOVING = 13  # number of entries for motion and route
DESCRIBED = 14  # number of entries for the robot's description
MOVERS = 3  # number of nearest moving obstacles in an observation, with four entries each
NO_MOVER = (1.0, 0.0, 0.0, 0.0)  # placeholder for a missing moving obstacle: far ahead and static
# Index of the first entry of moving obstacles
BEFORE_MOVERS = 2 * SECTORS + MOVING + len(OUTPUTS) + DESCRIBED
SIZE = BEFORE_MOVERS + 4 * MOVERS  # number of entries of an observation
# Indices, counted after the scans, of entries that change sign in the mirror image: sines of the
# three directions, turn rate and its change, direction of the near point, and lateral positions and
# velocities of moving obstacles
_FIRST_MOVER = BEFORE_MOVERS - 2 * SECTORS
_MOVER_ENTRIES = range(_FIRST_MOVER, _FIRST_MOVER + 4 * MOVERS)  # x, y, vx, vy of each
MIRROR_SIGN = (0, 2, 4, 7, 9, 11, *_MOVER_ENTRIES[1::2])


class OutputScale:
    """Scale of the policy's outputs for one robot: actions in [-1, 1] to values of OUTPUTS.

    Args:
        units: Unit of each kind of parameter (Parameter.kind) in which the ranges of OUTPUTS are
            given; 1 for others.

    Attributes:
        low: (m,) values at an action of -1.
        high: (m,) values at an action of 1.
    """

    def __init__(self, units: Mapping[str, float]):
        ranges = []
        is_log = []
        for output in OUTPUTS.values():
            unit = units.get(output.declared.kind, 1.0)
            lowest, highest = output.output_range or (output.low, output.high)
            ranges.append((unit * lowest, unit * highest))
            is_log.append(output.log)
        self.low, self.high = np.array(ranges).T
        self._is_log = np.array(is_log)
        # Linear outputs get values whose logarithms exist; they are not used.
        self._first = np.where(self._is_log, self.low, 1.0)
        self._octaves = np.log2(np.where(self._is_log, self.high, 2.0) / self._first)

    def encode(self, values: Array) -> Array:
        """Return the action (m,) for values (m,), clipped to [-1, 1]."""
        linear_share = (values - self.low) / (self.high - self.low)
        # A logarithmic parameter may be set to 0, for which the action is -1.
        logarithmic_share = np.log2(np.maximum(values, 1e-9) / self._first) / self._octaves
        action = 2.0 * np.where(self._is_log, logarithmic_share, linear_share) - 1.0
        return np.clip(action, -1.0, 1.0)

    def decode(self, action: Array) -> Array:
        """Return the values (m,) for an action (m,), which is clipped to [-1, 1]."""
        range_share = 0.5 * (np.clip(action, -1.0, 1.0) + 1.0)
        linear_values = self.low + range_share * (self.high - self.low)
        logarithmic_values = self._first * 2.0 ** (self._octaves * range_share)
        return np.where(self._is_log, logarithmic_values, linear_values)


class DimensionlessEncoding(Encoding):
    """Dimensionless encoding of observations and actions for one robot.

    An observation has SIZE numbers in [-1, 1]: the current and the previous scan, the directions of
    two points of the global plan, direction and distance of the goal, speed and turn rate with
    their changes, the distance driven since the last decision, the current parameters, and the
    description of the robot. At the end are position and velocity of the nearest MOVERS moving
    obstacles in the robot's frame, or NO_MOVER if there are fewer.

    Args:
        robot, base: As for an Encoding.
        period: Decision period [s], by which the distance driven since the last decision is
            normalised.

    Attributes:
        width: Padded width of the robot [m].
    """

    name = DIMENSIONLESS
    redraws_stalled = True
    size = SIZE
    actions = len(OUTPUTS)
    scan = 2 * SECTORS
    scans = 2
    mirror_sign = MIRROR_SIGN

    def __init__(
        self, robot: Robot, period: Optional[float], base: Optional[Mapping[str, float]] = None
    ):
        if period is None:
            raise ValueError(
                "the dimensionless observation depends on the decision period: set `period`"
            )
        super().__init__(robot, period, base)
        tree = robot.all_parameters()
        planner_values = tree[robot.local_planner]
        costmap = tree["local_costmap"]
        self.width = float(np.ptp(footprint.padded(costmap)[:, 1]))
        self.layout = _layout(robot, self.width)
        self.scale = self.width / JACKAL_WIDTH
        self.pace = self.scale * JACKAL_SPEED / robot.base.max_speed

        resolution = float(costmap["resolution"])
        # DWAPlannerROS multiplies its distance biases by the resolution; others count per cell.
        per_cell = 1.0
        if robot.local_planner == DWA:
            per_cell = 1.0 / resolution
        self._scale = OutputScale(
            {
                "speed": robot.base.max_speed,
                "turn": robot.base.max_yaw_rate,
                "weight": per_cell * resolution / self.width,
                "length": self.width,
                "1/length": 1.0 / self.width,
            }
        )
        # An output is of use if the robot has the parameter, with a range that overlaps the
        # output's.
        output_names = [NAMES.get(name, name) for name in self.space.names]
        self._places: List[Tuple[int, int]] = []  # (index in theta, index of its output)
        self.chosen: Tuple[str, ...] = ()
        for output_index, output_name in enumerate(OUTPUTS):
            if output_name not in output_names:
                continue
            theta_index = output_names.index(output_name)
            begins_below = self._scale.low[output_index] < self.space.high[theta_index]
            ends_above = self._scale.high[output_index] > self.space.low[theta_index]
            if begins_below and ends_above:
                self._places.append((theta_index, output_index))
                self.chosen += (self.space.names[theta_index],)
        base_values = {**self.space.as_dict(self.space.theta0), **self.base}
        self._base = self.space.clip([base_values[name] for name in self.space.names])
        # Values (m,) of OUTPUTS that are not of use
        defaults = [_default(planner_values, costmap, output_name) for output_name in OUTPUTS]
        self._defaults = np.array(defaults, dtype=np.float64)
        self._description = _description(robot, tree, self.width)
        self.forget_decision()

    def to_metadata(self) -> Metadata:
        """Return version, period and base, which do not depend on the robot."""
        return {"observation": VERSION, "period_s": self.period, "base": self.base}

    @classmethod
    def of(cls, metadata: Metadata, robot: Robot) -> DimensionlessEncoding:
        """Make the encoding from a policy's metadata, for any robot."""
        if metadata["observation"] != VERSION:
            raise ApplrError(f"its observation is {metadata['observation']}: {VERSION} is needed")
        return cls(robot, period_of(metadata), metadata["base"])

    def forget_decision(self) -> None:
        """Forget the previous decision at the start of a course."""
        self._previous: Optional[Tuple[Array, Context]] = None  # scan entries and Context

    def action(self, theta: Any) -> Array:
        """Return the action (12,) in [-1, 1] that encodes parameters (n,) of the robot's space."""
        output_values = self._defaults.copy()
        for theta_index, output_index in self._places:
            output_values[output_index] = theta[theta_index]
        return self._scale.encode(output_values)

    def theta(self, action: Any) -> Array:
        """Return the parameters (n,) for an action (12,).

        They may leave the robot's ranges, and counts are not rounded.
        """
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (len(OUTPUTS),) or not np.isfinite(action).all():
            raise ApplrError(f"action {action!r:.80}: {len(OUTPUTS)} finite numbers are needed")
        output_values = self._scale.decode(action)
        theta = self._base.copy()
        for theta_index, output_index in self._places:
            theta[theta_index] = output_values[output_index]
        return theta

    def observe(self, context: Context) -> Array32:
        """Return the observation (SIZE,) float32, and keep scan and context for the next one."""
        scan = self._scan(context.ranges)
        # At the first decision, nothing has changed.
        previous_scan, previous = self._previous or (scan, context)
        self._previous = scan, context
        entries = [
            self._motion(context, previous),
            self.action(context.theta),
            self._description,
            self._movers(context),
        ]
        other_entries = np.clip(np.concatenate(entries), -1.0, 1.0)
        return np.concatenate([scan, previous_scan, other_entries]).astype(np.float32)

    def _motion(self, context: Context, previous: Context) -> Array:
        """Return the entries (MOVING,) for route and motion since the `previous` decision."""
        base = self.robot.base
        x, y, yaw = context.pose

        # Route: the goal, and a farther point of the plan than the local goal
        goal_x, goal_y, _ = context.goal
        goal_dx = goal_x - x
        goal_dy = goal_y - y
        goal_distance = math.hypot(goal_dx, goal_dy) / (GOAL_CAP * self.width)
        goal_bearing = math.atan2(goal_dy, goal_dx) - yaw
        far_bearing = goal_bearing
        if len(context.plan):
            far_point = local_goal(context.plan, context.pose, FAR_POINT * self.width)
            far_bearing = goal_angle(far_point)

        # Motion, in shares of what the base can do
        v = context.twist[0] / base.max_speed
        w = context.twist[1] / base.max_yaw_rate
        previous_v = previous.twist[0] / base.max_speed
        previous_w = previous.twist[1] / base.max_yaw_rate
        previous_x, previous_y, _ = previous.pose
        distance = math.hypot(x - previous_x, y - previous_y)
        driven_share = distance / (base.max_speed * self.period)
        return np.array(
            [
                math.sin(context.phi),
                math.cos(context.phi),
                math.sin(far_bearing),
                math.cos(far_bearing),
                math.sin(goal_bearing),
                math.cos(goal_bearing),
                2.0 * min(goal_distance, 1.0) - 1.0,
                w,
                v,
                0.5 * (w - previous_w),
                0.5 * (v - previous_v),
                context.phi / math.pi,
                2.0 * driven_share - 1.0,
            ]
        )

    def _movers(self, context: Context) -> Array:
        """Return the scaled x, y, vx, vy (4 MOVERS,) of the nearest moving obstacles.

        They are in the robot's frame.
        """
        if not len(context.movers):
            return np.tile(NO_MOVER, MOVERS)
        movers = np.asarray(context.movers, dtype=np.float64).reshape(-1, 4)
        movers = transform_motions(inverse(context.pose), movers)
        order = np.argsort(np.hypot(movers[:, 0], movers[:, 1]), kind="stable")
        nearest_movers = movers[order][:MOVERS]
        nearest_movers[:, :2] /= MOVER_CAP * self.width
        nearest_movers[:, 2:] /= self.robot.base.max_speed
        missing_movers = np.tile(NO_MOVER, MOVERS - len(nearest_movers))
        return np.concatenate([nearest_movers.ravel(), missing_movers])

    def _scan(self, ranges: Array32) -> Array:
        """Return ranges (beams,) [m] as entries (SECTORS,) in [-1, 1].

        Short ranges have a higher resolution.
        """
        range_cap = self.layout.range_cap
        shares = np.clip(without_gaps(ranges, self.layout), 0.0, range_cap) / range_cap
        observed = 2.0 * np.sqrt(shares) - 1.0
        # What lies outside the field of view counts as free.
        unobserved = SECTORS - self.layout.beams
        right_count = unobserved // 2
        return np.concatenate([np.ones(right_count), observed, np.ones(unobserved - right_count)])


def _layout(robot: Robot, width: float) -> Layout:
    """Return the layout of a robot with a padded width [m].

    Its sectors are those of the laser's view that are symmetric about straight ahead.
    """
    sector_angle = TURN_RAD / SECTORS
    half_view = half_view_of(robot, 0.5 * sector_angle)
    beams = 2 * min(SECTORS // 2, int(half_view / sector_angle + 0.5))
    last_centre = 0.5 * (beams - 1) * sector_angle  # direction of the last sector's centre [rad]
    return Layout(
        beams=beams,
        angle_min=-last_centre,
        angle_max=last_centre,
        range_cap=CAP * width,
        lookahead=NEAR_POINT * width,
    )


def _default(planner_values: Tree, costmap: Tree, output: str) -> float:
    """Return the value of a policy output in planner or local costmap, or 0.0 without one."""
    # Planners name the same value differently: any parameter that the output sets will do.
    for parameter_name, output_name in NAMES.items():
        if output_name == output and parameter_name in planner_values:
            return float(planner_values[parameter_name])
    for layer in costmap.values():
        if isinstance(layer, dict) and output in layer:
            return float(layer[output])
    return 0.0


def _description(robot: Robot, tree: Tree, width: float) -> Array:
    """Return the entries (DESCRIBED,) that describe the robot, each about -1 to 1.

    Quantities of a wide range are logarithmic.
    """
    base = robot.base
    laser = robot.laser
    planner_values = tree[robot.local_planner]
    costmap = tree["local_costmap"]
    # The planner's limits apply, unless the base allows less.
    acceleration = min(base.max_acceleration, planner_values["acc_lim_x"])
    yaw_acceleration = min(base.max_yaw_acceleration, planner_values["acc_lim_theta"])
    view_share = min(laser.last_angle - laser.first_angle + laser.increment, TURN_RAD) / TURN_RAD
    return np.array(
        [
            math.log2(width / 0.5),
            robot.body.size[0] / width - 1.2,
            0.5 * math.log2(base.max_speed / 0.8),
            0.5 * math.log2(base.max_speed / width / 2.0),
            base.max_yaw_rate / 2.0 - 1.0,
            0.3 * math.log2(base.max_speed / acceleration),
            0.3 * math.log2(base.max_yaw_rate / yaw_acceleration),
            0.5 * math.log2(tree["controller_frequency"] / 10.0),
            0.4 * math.log2(laser.rate / 15.0),
            2.0 * view_share - 1.0,
            0.5 * math.log2(width / costmap["resolution"] / 8.0),
            0.5 * math.log2(costmap["width"] / width / 10.0),
            1.0 if base.drive == "two_wheel" else -1.0,
            1.0 if robot.local_planner == DWA else -1.0,
        ]
    )


ENCODINGS: Dict[str, Type[Encoding]] = {PAPER: PaperEncoding, DIMENSIONLESS: DimensionlessEncoding}
