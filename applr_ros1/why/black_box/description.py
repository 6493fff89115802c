"""Description of the robot that a bag of the black box holds, so that its answer needs no folder.

It is a text in JSON: what robot.yaml says with the parameters of move_base in it, and the names of
topics.
"""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from typing import Mapping, NamedTuple, Optional, Sequence, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import reading
from applr_ros1.drives.columns import TopicNames, topic_of
from applr_ros1.drives.received import TopicSource
from applr_ros1.planner.costmap import footprint
from applr_ros1.planner.parameters.costmap_parameters import COSTMAP
from applr_ros1.planner.parameters.trees import Tree, branch
from applr_ros1.robots import JACKAL, NAMES, Robot, load
from applr_ros1.robots.folder import content_of, described
from applr_ros1.robots.robot import MoveBaseSetup
from applr_ros1.why.events import RobotStop

TOPIC = "/black_box/parameters"
TYPE = "std_msgs/String"
# Topics without which no stop is found: key in COLUMNS, its messages in words, and the remedy
NEEDED = (
    ("goals", "goals", "give ~move_base"),
    ("odometry", "odometry", "give ~odom_topic"),
)
UNKNOWN = "robot"  # name of a robot of which only the parameters of move_base are known


class DescribedRobot(NamedTuple):
    """Robot of a black box.

    Attributes:
        robot: The robot, with the parameters of its move_base.
        topics: Names of its topics.
        is_known: Whether somebody described it. If not, its body and base are those of the Jackal,
            and only the parameters of move_base are its own.
        unpublished: Topics of its laser and odometry that nobody publishes.
        stop: Stop for which the bag is kept, or None.
    """

    robot: Robot
    topics: TopicNames
    is_known: bool
    unpublished: Tuple[str, ...] = ()
    stop: Optional[RobotStop] = None


def nobody_publishes(topics: Sequence[str]) -> str:
    """Return in words that nobody publishes some topics, or ""."""
    return f"nobody publishes {' and '.join(topics)}" if topics else ""


def unwatched(sources: Mapping[str, TopicSource], names: TopicNames) -> str:
    """Return in words that no stop can be found without a topic, or "".

    Args:
        sources: Topics that are there, with their keys in COLUMNS.
        names: Names of topics.
    """
    keys = {source.key for source in sources.values()}
    for key, words, remedy in NEEDED:
        if key not in keys:
            problem = f"no {words} on {topic_of(key, names)}, so that stops are not found"
            return f"{problem}: {remedy}"
    return ""


def text_of(driven: DescribedRobot) -> str:
    """Return the description as a text, without a stop."""
    content = {
        "name": driven.robot.name,
        "is_known": driven.is_known,
        "unpublished": driven.unpublished,
        "topics": vars(driven.topics),
        "robot": content_of(driven.robot),
    }
    # Whatever is no plain value on the parameter server is nothing that the planner reads.
    return json.dumps(content, default=str)


def with_stop(text: str, stop: RobotStop) -> str:
    """Return a description with a stop."""
    return json.dumps({**json.loads(text), "stop": stop})


def described_by(text: str, bag_name: str) -> DescribedRobot:
    """Return the robot of a description.

    Args:
        text: The description.
        bag_name: Name of its bag, which stands for the folder of a robot that is not included.

    Raises:
        ApplrError: The text is no description.
    """
    with reading(bag_name):
        content = json.loads(text)
    try:
        topics = {name: str(topic) for name, topic in content["topics"].items()}
        known_topics = {name: topics[name] for name in vars(TopicNames()) if name in topics}
        robot = described(content["robot"], str(content["name"]), bag_name)
        robot = driving(robot, robot.parameters())
        # The policy of an included robot is at hand, and can decide again.
        if robot.name in NAMES:
            robot = replace(robot, folder=load(robot.name).folder)
        names = TopicNames(**known_topics)
        silent_topics = tuple(map(str, content.get("unpublished", ())))
        stop: Optional[RobotStop] = None
        # Bags of earlier versions have none.
        if "stop" in content:
            kind, begin, end, place, number = content["stop"]
            stop = RobotStop(kind, begin, end, tuple(place), number)
        return DescribedRobot(robot, names, bool(content["is_known"]), silent_topics, stop)
    except (KeyError, TypeError, AttributeError):
        problem = f"{TOPIC} does not describe a robot"
        raise ApplrError(f"{bag_name}: {problem}: give the robot as --robot") from None


def driving(robot: Robot, tree: Tree) -> Robot:
    """Return a described robot with the parameters with which its move_base runs."""
    controllers = tree.get("controllers")
    if "base_local_planner" not in tree and controllers:
        # move_base_flex names its local planners in a list, of which the first one is usual.
        with suppress(LookupError, TypeError):
            tree = {**tree, "base_local_planner": controllers[0]["type"]}
    return replace(robot, move_base=MoveBaseSetup(tree), uses_map=False, is_running=True)


def unknown_robot(tree: Tree) -> Robot:
    """Return a robot of which only the parameters of move_base are known.

    Its frames and its size follow from them; everything else is the Jackal's, which no replay
    reads.
    """
    costmap = branch(tree, "local_costmap")
    base_frame = str(costmap.get("robot_base_frame", JACKAL.frames.base))
    # Prefixes of frames are taken off the messages, too.
    frames = JACKAL.frames.model_copy(update={"base": base_frame.rpartition("/")[2]})
    return replace(
        driving(JACKAL, tree),
        name=UNKNOWN,
        frames=frames,
        world_scale=_scale(costmap),
    )


def _scale(costmap: Tree) -> float:
    """Return the size of a robot relative to the Jackal, by the footprint of its costmap."""
    values = {parameter.name: parameter.default for parameter in COSTMAP}
    values.update(costmap)
    try:
        _, radius = footprint.radii(footprint.padded(values))
    except (ValueError, TypeError):  # C++ drives on with a footprint that it cannot read.
        return 1.0
    jackal_costmap = JACKAL.all_parameters()["local_costmap"]
    _, jackal_radius = footprint.radii(footprint.padded(jackal_costmap))
    return radius / jackal_radius if radius > 0.0 else 1.0
