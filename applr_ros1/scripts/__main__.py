#!/usr/bin/env python3
"""What `rosrun applr_ros1 NAME.py` runs: CMakeLists.txt installs this file under each name of NODES and COMMANDS.

Without an installation `python -m applr_ros1.scripts NAME` does the same.
"""

import sys
from pathlib import Path

from applr_ros1.common.errors import run_script

NODES = {  # take nothing but NAME:=VALUE
    "applr": "applr_ros1.nodes.applr.main",
    "collision_monitor": "applr_ros1.nodes.monitor.guard",
    "move_base": "applr_ros1.nodes.move_base.node",
    "movers": "applr_ros1.nodes.movers.node",
    "send_goal": "applr_ros1.nodes.tools.send_goal",
    "sim_bridge": "sim_bridge.ros_bridge",
    "viewer": "applr_ros1.nodes.viewer.node",
}
COMMANDS = {
    "appld": "training.appld",
    "bags_to_dataset": "training.bags_to_dataset",
    "barn": "applr_ros1.nodes.tools.barn",
    "check_robot": "training.check_robot",
    "demo": "applr_ros1.nodes.tools.demo",
    "demonstrate": "training.demonstrate",
    "evaluate": "training.evaluate",
    "measure_braking": "applr_ros1.nodes.tools.measure_braking",
    "new_robot": "training.new_robot",
    "play": "applr_ros1.nodes.tools.play",
    "record": "applr_ros1.nodes.tools.record",
    "robot_model": "applr_ros1.robots.urdf",
    "rviz": "applr_ros1.nodes.tools.rviz",
    "static_search": "training.static_search",
    "train": "training.train",
    "try_robot": "training.try_robot",
    "tune_robot": "training.tune_robot",
}

if __name__ == "__main__":
    if Path(sys.argv[0]).name == "__main__.py":
        sys.argv.pop(0)
    name = Path(sys.argv[0]).stem
    run_script(NODES.get(name) or COMMANDS[name], node=name in NODES)
