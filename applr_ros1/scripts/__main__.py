#!/usr/bin/env python3
"""Entry point of `rosrun applr_ros1 NAME.py`.

CMakeLists.txt installs this file under each name of NODES and COMMANDS. `applr-ros1 NAME`, which
pip installs, and `python -m applr_ros1.scripts NAME` do the same.
"""

import sys
from pathlib import Path

import applr_ros1
from applr_ros1.common.errors import run_script

NODES = {  # modules of the ROS nodes, which accept only NAME:=VALUE
    "applr": "applr_ros1.nodes.applr.main",
    "black_box": "applr_ros1.nodes.black_box.node",
    "collision_monitor": "applr_ros1.nodes.monitor.guard",
    "move_base": "applr_ros1.nodes.move_base.node",
    "movers": "applr_ros1.nodes.movers.node",
    "send_goal": "applr_ros1.nodes.tools.send_goal",
    "sim_bridge": "sim_bridge.ros_bridge",
    "viewer": "applr_ros1.nodes.viewer.node",
}
COMMANDS = {
    "appld": "training.appld.__main__",
    "bags_to_dataset": "training.train.bags_to_dataset",
    "barn": "applr_ros1.nodes.tools.barn",
    "check_robot": "training.robot.check",
    "demo": "applr_ros1.nodes.tools.demo",
    "demonstrate": "training.appld.demonstrate",
    "evaluate": "training.evaluate.__main__",
    "measure_braking": "applr_ros1.nodes.tools.measure_braking",
    "new_robot": "training.robot.__main__",
    "play": "applr_ros1.nodes.tools.play",
    "robot_model": "applr_ros1.robots.rviz_model",
    "train": "training.train.__main__",
    "tune_robot": "training.tune.__main__",
    "why": "training.why.__main__",
}


def main() -> None:
    """Run the program after which this file is named, or else the first argument's program."""
    programs = {**NODES, **COMMANDS}
    if Path(sys.argv[0]).stem not in programs:
        sys.argv.pop(0)
    program_name = "--help"
    if sys.argv:
        program_name = Path(sys.argv[0]).stem
    if program_name in programs:
        run_script(programs[program_name], node=program_name in NODES)  # exits the process
    usage = f"applr-ros1 NAME [ARGUMENT ...]; NAME is one of {', '.join(programs)}"
    answers = {"--help": usage, "--version": f"applr_ros1 {applr_ros1.__version__}"}
    if program_name not in answers:
        sys.exit(f"unknown program {program_name}: {usage}")
    print(answers[program_name])


if __name__ == "__main__":
    main()
