"""Topics under which a bag has a drive: found in the bag where no option names them."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Collection, List, Mapping

from applr_ros1.common.errors import ApplrError
from training.bags.topics import CHANNELS, TopicNames, topic_of

# Global planners of ROS's navigation, whose plans show where move_base is.
GLOBAL_PLANNERS = ("NavfnROS", "GlobalPlanner")


def names_in(kinds: Mapping[str, str], wanted: TopicNames, given: Collection[str]) -> TopicNames:
    """Return the names of a drive's topics in a bag.

    move_base is found by its plans. Other topics are looked for in the namespace around move_base,
    then without a namespace.

    Args:
        kinds: {topic: type} of the bag.
        wanted: Names by the robot's files and by options.
        given: Fields of `wanted` that were given as options; they are not replaced.

    Raises:
        ApplrError: The bag has plans of several move_base.
    """
    move_base = wanted.move_base
    if "move_base" not in given:
        spaces = _spaces_of_move_base(kinds)
        if len(spaces) > 1:
            raise ApplrError(f"plans of {' and of '.join(spaces)}: give --move-base")
        if spaces:
            move_base = spaces[0]

    # /robot1/move_base drives a robot whose scans are on /robot1/scan, if there is such a topic.
    namespace = move_base.rpartition("/")[0]
    topics = {"move_base": move_base}
    for field in fields(wanted):
        topic = namespace + getattr(wanted, field.name)
        is_open = field.name != "move_base" and field.name not in given
        if is_open and topic in kinds:
            topics[field.name] = topic
    return replace(wanted, **topics)


def _spaces_of_move_base(kinds: Mapping[str, str]) -> List[str]:
    """Return the namespaces of move_base: those of the followed plans, else of the global ones."""
    followed = set()
    planned = set()
    for topic, kind in kinds.items():
        # A plan's topic is MOVE_BASE/PLANNER/NAME.
        if not CHANNELS["plans"].accepts(kind) or topic.count("/") < 3:
            continue
        space, planner, name = topic.rsplit("/", 2)
        if name == "global_plan":
            followed.add(space)
        elif name == "plan" and planner in GLOBAL_PLANNERS:
            planned.add(space)
    return sorted(followed or planned)


def missing(channel: str, names: TopicNames, kinds: Mapping[str, str]) -> str:
    """Return what is said of a channel without messages.

    It names the channel's topic and option, and the bag's topics of its type.
    """
    topic = topic_of(channel, names)
    option = CHANNELS[channel].topic.strip("{}")
    several = CHANNELS[channel].type.rpartition("/")[2]
    # Odometry has no plural.
    if not several.endswith("y"):
        several += "s"
    others = _topics_of(channel, kinds)
    if topic in kinds and topic not in others:
        return f"{topic} has messages of {kinds[topic]}, not {several}: give --{option}"
    if not others:
        return f"no messages on {topic}, and the bag has no {several}: record it"
    return f"no messages on {topic}: give --{option}; the bag has {several} on {', '.join(others)}"


def missing_plans(planner: str, names: TopicNames, kinds: Mapping[str, str]) -> str:
    """Return what is said of a bag without plans of move_base."""
    followed = topic_of("plans", names, planner)
    route = topic_of("routes", names, GLOBAL_PLANNERS[0])
    others = _topics_of("plans", kinds)
    text = f"no messages on {followed}, nor on {route}: record one of them"
    if others:
        text += f", or give --move-base; the bag has Paths on {', '.join(others)}"
    return text


def _topics_of(channel: str, kinds: Mapping[str, str]) -> List[str]:
    """Return the bag's topics whose type a channel takes."""
    return sorted(topic for topic, kind in kinds.items() if CHANNELS[channel].accepts(kind))
