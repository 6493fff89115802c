"""Robots for tests: the Jackal's parameters, an ideal robot with a laser, and the weights of a
policy.
"""

import copy
import math

import numpy as np

from applr_ros1.common.scan import LaserScan
from applr_ros1.planner.costmap import footprint as footprints
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.state_machine import NO_PLAN, Cycle
from applr_ros1.robots import JACKAL
from applr_ros1.stack.stack import Step
from sim_bridge.lidar import Lidar

JACKAL_PARAMETERS = JACKAL.parameters()
JACKAL_FOOTPRINT = footprints.pad(
    footprints.parse("[[-0.21,-0.165],[-0.21,0.165],[0.21,0.165],[0.21,-0.165]]"), 0.1
)
# Values that TrajectoryPlannerROS of the Jackal has, under the names of DWAPlannerROS.
DWA_PARAMETERS = dict(
    max_vel_trans=0.5,
    max_vel_x=0.5,
    min_vel_x=-0.1,
    max_vel_y=0.0,
    min_vel_y=0.0,
    max_vel_theta=1.57,
    min_vel_theta=0.3,
    acc_lim_x=10.0,
    acc_lim_theta=20.0,
    xy_goal_tolerance=0.25,
    yaw_goal_tolerance=0.157,
    sim_time=1.5,
    path_distance_bias=20.0,
    goal_distance_bias=24.0,
    occdist_scale=0.05,
    forward_point_distance=0.2,
    vx_samples=6,
    vth_samples=20,
)


def dwa_parameters(**changes):
    """Return the Jackal's parameters with DWAPlannerROS as local planner."""
    parameters = copy.deepcopy(JACKAL_PARAMETERS)
    parameters.update(
        changes,
        base_local_planner="dwa_local_planner/DWAPlannerROS",
        DWAPlannerROS=dict(DWA_PARAMETERS),
    )
    return parameters


LASER = JACKAL.laser
BEAMS = LASER.beams
ANGLE_MIN = LASER.first_angle
ANGLE_MAX = LASER.last_angle
INCREMENT = LASER.increment
RANGE_MIN = LASER.range_min
RANGE_MAX = LASER.range_max
LASER_X = 0.12  # distance of the laser ahead of the robot's centre [m]
# Two posts on the left, then two on the right, (x, y, radius) [m].
SLALOM = [(1.5, 0.3, 0.15), (1.5, 0.9, 0.15), (2.6, -0.6, 0.15), (2.6, -1.2, 0.15)]


class ToyRobot:
    """Robot with pose (x, y, yaw) and twist (v, w) among circles (n, 3) of x, y, radius [m]."""

    def __init__(self, pose=(0.0, 0.0, 0.0), circles=()):
        self.pose = pose
        self.twist = (0.0, 0.0)
        self.time = 0.0
        self.circles = np.array(circles, dtype=np.float64).reshape(-1, 3)

    def sensor_pose(self):
        """Return the laser's pose (x, y, yaw) [m, rad]."""
        x, y, yaw = self.pose
        return x + LASER_X * math.cos(yaw), y + LASER_X * math.sin(yaw), yaw

    def ranges(self):
        """Return the ranges (720,) float32, inf for beams that hit nothing."""
        return Lidar(LASER, self.circles, np.zeros((0, 5))).scan(*self.sensor_pose())

    def scan(self):
        return scan_by(LASER, self.time, self.ranges(), self.sensor_pose())

    def drive(self, command, duration):
        """Drive for `duration` [s]. Without a command, the robot stands still."""
        v, w = command or (0.0, 0.0)
        x, y, yaw = self.pose
        # Steps so short that their straight lines follow the arc.
        step = duration / 10
        for _ in range(10):
            x += v * math.cos(yaw) * step
            y += v * math.sin(yaw) * step
            yaw += w * step
        self.pose = (x, y, math.remainder(yaw, 2 * math.pi))
        self.twist = (v, w)
        self.time += duration


def scan_by(laser, stamp, ranges, sensor_pose):
    """Return the scan of a robot's laser at a pose."""
    return LaserScan(stamp, *laser.fan, ranges, sensor_pose)


def ring(x, y, radius, posts=40, size=0.1):
    """Return posts (n, 3) of x, y, radius [m] on a circle around a point."""
    circles = []
    for angle in np.linspace(0, 2 * math.pi, posts, endpoint=False):
        circles.append((x + radius * math.cos(angle), y + radius * math.sin(angle), size))
    return circles


def run(move_base, robot, seconds, period=0.05, scans=True, until_result=True, cycles=None):
    """Step planner and robot for `seconds`, and return the result or None. Append (time, Cycle) to
    `cycles`.
    """
    for _ in range(int(round(seconds / period))):
        cycle = move_base.step(robot.time, robot.pose, robot.twist, robot.scan() if scans else None)
        if cycles is not None:
            cycles.append((robot.time, cycle))
        robot.drive(cycle.command, period)
        if cycle.result and until_result:
            return cycle.result
    return None


class Scripted:
    """Local planner stub with scripted commands: call n returns answer(n), a pair (ok, (v, w))."""

    goal_reached = False
    cropped_plan = NO_PLAN
    local_plan = NO_PLAN

    def __init__(self, answer):
        self.answer = answer
        self.calls = 0
        self.escapes_ended = 0

    def set_plan(self, plan):
        pass

    def end_escape(self):
        self.escapes_ended += 1

    def compute_velocity(self, pose, twist, costmap, local_origin=None):
        self.calls += 1
        return self.answer(self.calls)


class FakeMoveBase:
    """Planner stub that gives each command (v, w) for a second, and the last one forever.

    It is silent while a command is None. After `end` cycles it gives its `result`, and the robot
    stands. Each tenth cycle plans, and without `finds_plan` keeps the plan that it had.
    """

    goal = None
    map_topics = ()  # It has no static layer.
    global_frame = "odom"

    def __init__(self, *commands, end=None, result=None, variant="ours", finds_plan=True):
        self.commands = commands
        self.end = end
        self.result = result
        self.goals = []
        self.requests = []
        self.steps = []
        self.scans = []
        self.held = []
        self.parameters = {"applr": {"movers": False}}
        self.goal_tolerance = 0.25
        self.variant = variant
        self.finds_plan = finds_plan
        diagonal = 0.1 * np.arange(40)
        self.global_plan = np.column_stack([diagonal, diagonal, np.zeros(40)])

    def reset(self, time, seed=None):
        self.steps.clear()

    def set_goal(self, goal, time):
        self.goals.append((goal, time))
        self.goal = goal

    def make_plan(self, start, goal, tolerance=0.0):
        return self.global_plan

    def put_in_force(self, settings):
        in_force = {}
        for server, values in settings.items():
            self.requests.append((server, values))
            in_force[server] = dict(values)
            if "vx_samples" in values:
                in_force[server]["vx_samples"] = 7  # The server changes this value.
        return in_force

    def report_held(self, held):
        self.held.append(held)

    def step(self, time, pose, twist, scan, local_origin):
        self.steps.append((time, pose, twist))
        self.scans.append(scan)
        cycle_count = len(self.steps)
        command = None
        if self.goals:
            second = (cycle_count - 2) // 20
            command = self.commands[min(second, len(self.commands) - 1)]
            if self.end is not None and cycle_count > self.end:
                _, w = command
                command = (0.0, w)
        result = None
        if self.end is not None and cycle_count == self.end + 1:
            result = self.result
        planned = cycle_count % 10 == 1
        return Cycle(
            command=command, result=result, planned=planned, new_plan=planned and self.finds_plan
        )


class Script:
    """Driver that gives one command (v, w), or None, and notes what it gets."""

    goal_tolerance = 0.0

    def __init__(self, command=(0.2, 0.0)):
        self.command = command
        self.resets = []
        self.goals = []
        self.steps = []

    def reset(self, now, seed):
        self.resets.append((now, seed))

    def set_goal(self, goal, now):
        self.goals.append((goal, now))

    def step(self, now, pose, twist, scan=None, local_origin=None):
        self.steps.append((now, pose, scan, local_origin))
        return Step(Cycle(), verdict=None, command=self.command)


# -- MoveBase with small maps ----------------------------------------------------------------------
def quick(**changes):
    """Return the Jackal's parameters with small maps and short patience."""
    parameters = copy.deepcopy(JACKAL_PARAMETERS)
    for costmap, map_size in (("global_costmap", 20), ("local_costmap", 6)):
        origin = -map_size / 2.0
        parameters[costmap].update(
            width=map_size, height=map_size, origin_x=origin, origin_y=origin
        )
    parameters.update(planner_patience=1.0, controller_patience=1.0)
    parameters.update(changes)
    return parameters


def start(goal, robot=None, tree=None, before=0.1):
    """Return (MoveBase, robot) after `before` seconds of scans and the sending of the goal."""
    robot = robot or ToyRobot()
    move_base = MoveBase(tree or quick())
    run(move_base, robot, before)
    move_base.set_goal(goal, robot.time)
    return move_base, robot


def make_weights(seed=0, hidden=(32, 32), inputs=729, outputs=8):
    """Return random weights of a policy's network."""
    rng = np.random.default_rng(seed)
    widths = (inputs, *hidden, outputs)
    weights = {}
    for layer, (fan_in, fan_out) in enumerate(zip(widths, widths[1:])):
        # Scaled so that the layers neither blow up nor die.
        layer_weights = rng.normal(size=(fan_out, fan_in)) / np.sqrt(fan_in)
        weights[f"{layer}.weight"] = layer_weights.astype(np.float32)
        weights[f"{layer}.bias"] = rng.normal(size=fan_out).astype(np.float32)
    return weights
