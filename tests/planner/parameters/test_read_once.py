"""Tests which reconfigurable parameters are read only at start-up: the same in the tables and
MoveBase.

A value from a file and the same value from a later reconfigure must make MoveBase do the same,
unless the parameter is read only at start-up. What it does is observed in three stages: it drives
among posts, stops and turns at a goal, and recovers.
"""

import copy
from functools import lru_cache

import numpy as np
import pytest

from applr_ros1 import robots
from applr_ros1.common.scan import observe
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.declarations import shapes_at_start
from applr_ros1.planner.parameters.parameter import GOAL, OUTLINE, PERIOD, RECOVERY
from applr_ros1.planner.parameters.trees import branch
from tests.support.robots import ToyRobot, ring, run
from tests.support.scenes import see

PLANNERS = {"jackal": "TrajectoryPlannerROS", "turtlebot3_waffle_pi": "DWAPlannerROS"}
# Other values: those that differ enough to be seen, and texts
CHANGED = {
    "footprint": "[[0.35, 0.3], [0.35, -0.3], [-0.35, -0.3], [-0.35, 0.3]]",
    "footprint_padding": 0.2,
    "y_vels": "-0.2,0.2",
}
# Parameters that name plugins, which MoveBase cannot change.
PLUGINS = ("base_global_planner", "base_local_planner")
# Without a sideways velocity, nobody sees how fast it may change.
UNSEEN = {("TrajectoryPlannerROS", "acc_lim_y")}
DRIVING, AT_GOAL, RECOVERING = "driving", "at the goal", "recovering"
GOAL_POSE = (0.5, 0.0, 0.0)
# Poses and twists of two arrivals, in the order in which a robot stops and turns at its goal. It
# begins to turn at a small speed, or at a small turn rate.
ARRIVALS = (
    (
        ((0.5, 0.02, 1.5), (0.9, 0.3)),
        ((0.5, 0.02, 1.5), (0.09, 0.0)),
        ((0.5, 0.02, 1.4), (0.0, 0.0)),
        ((0.5, 0.02, 1.2), (0.0, 0.6)),
        ((0.5, 0.02, 0.2), (0.0, 0.3)),
        ((0.5, 0.02, 0.2), (0.0, 0.0)),
    ),
    (
        ((0.5, 0.02, 3.0), (0.0, 0.09)),
        ((0.5, 0.02, 3.0), (0.0, 3.0)),
        ((0.5, 0.02, 0.14), (0.0, 0.0)),
    ),
)
# Yaws of two rotations: at the end of one, the acceleration limits the turn, and of the other, its
# smallest speed
ROTATIONS = (0.0, 2.0, 3.3, 6.1, 6.26), (0.0, 2.0, 3.3, 6.1, 6.2825)


class Seeing(ToyRobot):
    """Robot whose laser remembers what it saw from a pose."""

    @staticmethod
    @lru_cache(maxsize=None)
    def _ranges(pose, circles):
        return ToyRobot(pose, circles).ranges()

    def ranges(self):
        return self._ranges(self.pose, tuple(map(tuple, self.circles.tolist())))


def seen(move_base):
    """Return what a MoveBase has to show: maps, plans and costs."""
    planner = move_base.local_planner
    local_costmap = move_base.local_costmap
    shown = [move_base.global_plan, planner.cropped_plan, planner.local_plan]
    shown += [planner.cost_cloud(local_costmap), planner.planner.in_force]
    for costmap in move_base.costmaps.values():
        shown += [costmap.cells, costmap.footprint, np.array(costmap.origin)]
    return [(part.shape, np.asarray(part).tobytes()) for part in shown]


def stages(move_base):
    """Return what a MoveBase does in each stage, as {stage: list of values}."""
    driving = [move_base.frequency, move_base.goal_tolerance]
    for costmap in move_base.costmaps.values():
        driving += [layer.parameters for layer in costmap.layers]
    # A post beside the way, and a ring that the recoveries clear or keep
    posts = [(0.55, -0.52, 0.05), *ring(0.0, 0.0, 1.35, posts=24, size=0.05)]
    robot = Seeing(circles=posts)
    run(move_base, robot, 0.1)
    move_base.set_goal(GOAL_POSE, robot.time)
    cycles = []
    for _ in range(2):
        run(move_base, robot, 0.15, cycles=cycles)
        driving += seen(move_base)
    driving += [(cycle.command, cycle.result, cycle.updated) for _, cycle in cycles]
    # Every legal sample of the last cycle, with its cost
    driving.append(move_base.local_planner.trajectory_cloud(move_base.local_costmap).tobytes())

    at_goal = []
    planner = move_base.local_planner
    plan = move_base.global_plan
    for arrival in ARRIVALS:
        planner.set_plan(plan)
        for pose, twist in arrival:
            at_goal.append(planner.compute_velocity(pose, twist, move_base.local_costmap))

    recovering = []
    for behaviour in move_base.recoveries:
        recovering.append(behaviour.name)
        for yaws in ROTATIONS:
            behaviour.start(robot.time, (0.0, 0.0, 0.0))
            for yaw in yaws:
                maps = move_base.local_costmap, move_base.global_costmap
                recovering.append(behaviour.step(robot.time, (0.0, 0.0, yaw), *maps))
        for costmap in move_base.costmaps.values():
            # What was cleared is seen before the next scan marks it again.
            costmap.update_costs(robot.pose)
            recovering.append(costmap.cells.tobytes())
            see(costmap, robot.pose, observe(robot.scan()))
    return {DRIVING: driving, AT_GOAL: at_goal, RECOVERING: recovering}


def other(parameter, value):
    """Return another valid value of the parameter."""
    if parameter.name in CHANGED:
        return CHANGED[parameter.name]
    if parameter.type == "bool":
        return not value
    moved = value + 1
    if parameter.type != "int":
        moved = 0.8 * value or 0.1
    return moved if parameter.min <= moved <= parameter.max else value - 1


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANNERS)
def test_parameters_read_once_are_the_same_in_tables_and_move_base(name):
    robot = robots.load(name)
    planner = PLANNERS[name]
    readers = {}
    declared = {}
    plain = robot.parameters()
    # The value of move_base itself then applies, as in most files.
    plain[planner].pop("controller_frequency", None)
    plain["global_costmap"].update(width=4, height=4, origin_x=-2.0, origin_y=-2.0)
    plain["rotate_recovery"] = {"sim_granularity": 0.3}  # faster
    # robot_radius counts only without a footprint.
    without_footprint = copy.deepcopy(plain)
    without_footprint["local_costmap"].pop("footprint")
    for server, (_, parameters) in MoveBase(plain).servers.items():
        for parameter in parameters:
            name = parameter.name
            if name == "restore_defaults" or name in PLUGINS:
                continue

            # Another value: once by a request, once from the files
            tree = without_footprint if name == "robot_radius" else plain
            reconfigured = MoveBase(tree)
            value = other(parameter, reconfigured.configuration(server)[name])
            loaded = MoveBase(with_value(tree, server, name, value))
            reconfigured.reconfigure(server, {name: value})
            assert reconfigured.configuration(server) == loaded.configuration(server), name

            # Who does something else has kept the value of the start.
            of_files = stages(loaded)
            of_request = stages(reconfigured)
            different = {stage for stage in of_files if of_files[stage] != of_request[stage]}
            if different:
                readers[server, name] = readers_of(different, server)
            if is_declared_once(parameter, server, planner):
                declared[server, name] = set(parameter.once)
    for unseen in UNSEEN & set(declared):
        assert readers.setdefault(unseen, declared[unseen]) == declared[unseen]
    assert readers == declared != {}


def with_value(tree, server, name, value):
    """Return parameters with another value of a server, where C++ reads it."""
    changed = copy.deepcopy(tree)
    section = server if server in tree else server.rpartition("/")[0]
    branch(changed, section, create=True)[name] = value
    # C++ reads the parameter of a layer from the layer's own section.
    if "/" in server:
        branch(changed, server, create=True)[name] = value
        branch(changed, server.rpartition("/")[0]).pop(name, None)
    return changed


def readers_of(different, server):
    """Return who has kept the value of the start, as the stages show that differ."""
    if DRIVING in different:
        # With other commands or maps, what follows differs, too.
        return {OUTLINE if server == "local_costmap" else PERIOD}
    by_stage = {AT_GOAL: GOAL, RECOVERING: RECOVERY}
    return {by_stage[stage] for stage in different}


def is_declared_once(parameter, server, planner):
    """Return whether the tables say that a parameter is read only at start-up."""
    if server == "global_costmap" or not parameter.once:
        return False
    return server != "local_costmap" or planner in parameter.once


def test_only_the_outline_of_trajectoryplannerros_keeps_its_start_up_value():
    assert shapes_at_start("TrajectoryPlannerROS", "local_costmap", "footprint_padding")
    assert not shapes_at_start("DWAPlannerROS", "local_costmap", "footprint_padding")
    assert not shapes_at_start("TrajectoryPlannerROS", "global_costmap", "footprint_padding")
    assert not shapes_at_start("TrajectoryPlannerROS", "TrajectoryPlannerROS", "max_vel_theta")
