"""Records a drive in a bag: which topics, under their absolute names, whatever the namespace.

The command record.py (launch argument record:=) becomes rosbag's recorder. `become` is rviz.py's, too.
"""

from __future__ import annotations

import argparse
import os
import posixpath
import sys
from typing import List, Sequence

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import JACKAL, Robot, load

SHARED = ("/tf", "/tf_static", "/diagnostics")  # of all robots on a master; /clock is the bag's own time
STACK = (
    "{scan} {odometry} {cmd_vel} {imu} map "
    "move_base/goal move_base/current_goal move_base/status move_base/result move_base/recovery_status "
    "move_base/cmd_vel move_base/local_costmap/footprint move_base/NavfnROS/plan "
    "move_base/{planner}/global_plan move_base/{planner}/local_plan move_base/{planner}/parameter_updates "
    "applr/heartbeat applr/decision applr/course_end applr/parameters applr/local_goal applr/predicted applr/tracked "
    "applr/movers collision_monitor/action "
    "sim_bridge/ground_truth sim_bridge/collision sim_bridge/obstacles sim_bridge/movers sim_bridge/current_world"
)
PLANNERS = ("TrajectoryPlannerROS", "DWAPlannerROS")


def topics(arguments: Sequence[str] = (), robot: Robot = JACKAL) -> List[str]:
    """Absolute names of the topics of one robot's stack, and of what all robots share.

    Args:
        arguments: Remappings and "__ns:=..." as ROS gives them to a node; the environment's ROS_NAMESPACE counts.
        robot: Whose stack it is: names of its topics, and of the servers that its parameter space sets.
    """
    import rosgraph.names as names

    node = names.get_ros_namespace(argv=list(arguments)).rstrip("/") + "/record"
    mappings = names.load_mappings(list(arguments))
    mappings = {names.resolve_name(old, node): names.resolve_name(new, node) for old, new in mappings.items()}
    servers = {setting.server for parameter in robot.space for setting in parameter.sets} - set(PLANNERS)
    found = [posixpath.join("move_base", server, "parameter_updates") for server in sorted(servers)]
    for name in STACK.split():
        planners = PLANNERS if "{planner}" in name else ("",)
        found += [name.format(planner=planner, **vars(robot.topics)) for planner in planners]
    resolved = (names.resolve_name(name, node) for name in found)
    return [*SHARED, *(mappings.get(name, name) for name in resolved)]


def main() -> None:
    """The command record.py: becomes rosbag's recorder. Returns only with an error."""
    words = sys.argv[1:]
    parser = argparse.ArgumentParser(prog="record.py", description="Record the stack of this namespace in a bag.")
    add = parser.add_argument
    add("bag", help="Bag file (.bag) to write.")
    add("--robot", default=JACKAL.name, help="Robot that is recorded: a name or a folder. Default: %(default)s.")
    options = parser.parse_args(without_remappings(words))
    bag = options.bag if options.bag.endswith(".bag") else options.bag + ".bag"
    if not os.path.isabs(bag) and any(word.startswith("__name:=") for word in words):
        raise ApplrError(f"record is {bag}: roslaunch starts nodes in another folder; give the path from the root")
    for there in (bag, bag + ".active"):  # rosbag would write over it
        if os.path.lexists(there):
            raise ApplrError(f"record is {bag}: {there} is there already; give another name")
    chosen = topics(words, load(options.robot))
    become("rosbag", "record", ["--lz4", "-O", bag, *chosen, *(w for w in words if w.startswith("__"))])


def become(package: str, program: str, arguments: Sequence[str]) -> None:
    """Replace this process by a program of another ROS package, as rosrun finds it; ApplrError without one."""
    import roslib.packages
    import rospkg

    try:
        found = roslib.packages.find_node(package, program)
    except rospkg.ResourceNotFound:
        found = []
    if not found:
        raise ApplrError(f"{package} is not installed: apt-get install {package} (Ubuntu: ros-noetic-{package})")
    os.execv(found[0], [found[0], *arguments])
