"""Topics under which a bag has a drive, or a robot drives, where no option names them."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Collection, List, Mapping, NamedTuple, Set, Tuple

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.columns import COLUMNS, TopicNames, topic_of

# Global planners of ROS's navigation, whose plans show where move_base is.
GLOBAL_PLANNERS = ("NavfnROS", "GlobalPlanner")
NODES = ("applr", "monitor")  # fields of TopicNames that are names of nodes


class Connections(NamedTuple):
    """Topics that a node publishes, and those that it subscribes to."""

    published: Set[str]
    subscribed: Set[str]


def names_in(types: Mapping[str, str], wanted: TopicNames, given: Collection[str]) -> TopicNames:
    """Return the names of a drive's topics in a bag.

    move_base is found by its plans. Other topics are looked for in the namespace around move_base,
    then without a namespace.

    Args:
        types: {topic: type} of the bag.
        wanted: Names by the robot's files and by options.
        given: Fields of `wanted` that were given as options; they are not replaced.

    Raises:
        ApplrError: The bag has plans of several move_base.
    """
    move_base = wanted.move_base
    if "move_base" not in given:
        move_bases = _names_of_move_base(types)
        if len(move_bases) > 1:
            raise ApplrError(f"plans of {' and of '.join(move_bases)}: give --move-base")
        if move_bases:
            move_base = move_bases[0]

    # /robot1/move_base drives a robot whose scans are on /robot1/scan, if there is such a topic.
    robot_namespace = move_base.rpartition("/")[0]
    topics = {"move_base": move_base}
    for topic_field in fields(wanted):
        if topic_field.name == "move_base" or topic_field.name in given:
            continue
        topic = robot_namespace + getattr(wanted, topic_field.name)
        # A node has no topic of its own name, but topics below it.
        is_node = topic_field.name in NODES
        if topic in types or (is_node and any(name.startswith(f"{topic}/") for name in types)):
            topics[topic_field.name] = topic
    return replace(wanted, **topics)


def _names_of_move_base(types: Mapping[str, str]) -> List[str]:
    """Return the names of the move_base nodes whose plans were followed, else of the planning ones.

    A name is resolved, such as /robot1/move_base.
    """
    followed = set()
    planned = set()
    for topic, message_type in types.items():
        # A plan's topic is MOVE_BASE/PLANNER/NAME.
        if not COLUMNS["plans"].accepts(message_type) or topic.count("/") < 3:
            continue
        node_name, planner, plan_name = topic.rsplit("/", 2)
        if plan_name == "global_plan":
            followed.add(node_name)
        elif plan_name == "plan" and planner in GLOBAL_PLANNERS:
            planned.add(node_name)
    # A move_base whose local planner publishes no plan still shows the plans of its global one.
    return sorted(followed or planned)


def missing(column: str, names: TopicNames, types: Mapping[str, str]) -> str:
    """Return what is said of a column without messages.

    It names the column's topic and option, and the bag's topics of its type.
    """
    topic = topic_of(column, names)
    option = COLUMNS[column].topic.strip("{}")
    remedy = f"correct topics in robot.yaml, or give --{option}"
    messages = COLUMNS[column].type
    others = topics_of(column, types)
    if topic in types and topic not in others:
        return f"{topic} has messages of {types[topic]}, not {messages}: {remedy}"
    if not others:
        return f"no messages on {topic}, and the bag has no {messages}: record it"
    return f"no messages on {topic}: {remedy}; the bag has {messages} on {', '.join(others)}"


def missing_plans(planner: str, names: TopicNames, types: Mapping[str, str]) -> str:
    """Return what is said of a bag without plans of move_base."""
    followed = topic_of("plans", names, planner)
    route = topic_of("routes", names, GLOBAL_PLANNERS[0])
    others = topics_of("plans", types)
    message = f"no messages on {followed}, nor on {route}: record one of them"
    if others:
        message += f", or give --move-base; the bag has Paths on {', '.join(others)}"
    return message


def topics_of(column: str, types: Mapping[str, str]) -> List[str]:
    """Return the bag's topics whose type a column takes."""
    topics = []
    for topic, message_type in types.items():
        if COLUMNS[column].accepts(message_type):
            topics.append(topic)
    return sorted(topics)


def names_beside(
    move_base: Connections, types: Mapping[str, str], names: TopicNames, given: Collection[str]
) -> TopicNames:
    """Return the topics of a running robot: the ones that its move_base reads and writes.

    Args:
        move_base: Topics of the node move_base.
        types: {topic: type} of the running system, with the topics that nobody publishes: a laser
            that is silent is no reason to take another one.
        names: Names so far.
        given: Fields of `names` that were given; they are not replaced.
    """
    found_names = {}
    for field_name, column in (("scan", "scans"), ("odometry", "odometry")):
        read_topics = move_base.subscribed & set(topics_of(column, types))
        # A move_base with several lasers has one of the usual name, or the first one counts.
        if read_topics and getattr(names, field_name) not in read_topics:
            found_names[field_name] = min(read_topics)
    written_topics = move_base.published & set(topics_of("planned", types))
    # If its commands pass a monitor, those at the base are the robot's own topic.
    if written_topics and topic_of("planned", names) not in written_topics:
        found_names["command"] = min(written_topics)
    for field_name in given:
        found_names.pop(field_name, None)
    return replace(names, **found_names)


def unpublished(
    move_base: Connections, names: TopicNames, published: Collection[str]
) -> Tuple[str, ...]:
    """Return the topics of laser and odometry that move_base reads and nobody publishes.

    Args:
        move_base: Topics of the node move_base.
        names: Names of the topics.
        published: Topics that somebody publishes.
    """
    silent_topics = move_base.subscribed.difference(published)
    return tuple(topic for topic in (names.scan, names.odometry) if topic in silent_topics)
