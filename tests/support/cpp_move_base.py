"""Stand-in for a C++ move_base: the node of this package with the defects of the C++ planner.

Started as `session().node("tests.support.cpp_move_base")`.
"""

from functools import partial

from applr_ros1.nodes.move_base import node
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.variant import CPP_LIKE


def main():
    """Run the node."""
    node.MoveBase = partial(MoveBase, planner=CPP_LIKE)
    return node.main()
