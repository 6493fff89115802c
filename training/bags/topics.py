"""Names of the topics of a recorded drive."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, replace
from typing import Any, Dict, Sequence, Tuple

TYPES = {"scan": ("LaserScan",), "odometry": ("Odometry",), "command": ("Twist", "TwistStamped")}  # under any name


@dataclass(frozen=True)
class TopicNames:
    """Names of the topics of a drive. parameter_updates are found below move_base, whatever the layers are called."""

    scan: str = "/front/scan"  # first: its namespace is the robot's where there are several
    odometry: str = "/odometry/filtered"
    move_base: str = "/move_base"
    collision: str = "/sim_bridge/collision"
    applr: str = "/applr"
    command: str = "/cmd_vel"
    demonstration: str = "/demonstration"  # String: JSON of who demonstrated (demonstrate.py)
    tf: str = "/tf"
    tf_static: str = "/tf_static"

    def needs(self, topic: str) -> bool:
        """Return whether messages of a topic are read."""
        below = [self.move_base + name for name in ("/status", "/result", "/current_goal", "/goal", "_simple/goal")]
        named = [value for name, value in vars(self).items() if name not in ("move_base", "applr")]
        return topic in (*named, *below, self.decision, self.course_end) or bool(self.updates.fullmatch(topic))

    def found(self, connections: Sequence[Any]) -> TopicNames:
        """Return these names, and for what is not recorded there the same below a namespace, or what is of its type.

        Of several it is that in the scan's namespace, or else that with the most messages, whatever its name.
        """
        kinds = {one.topic: one.msgtype.rpartition("/")[2] for one in connections}
        counts: Dict[str, int] = Counter()
        for one in connections:
            counts[one.topic] += one.msgcount
        chosen, space = {}, ""
        for name, wanted in vars(self).items():
            below = re.compile(f"(.*){re.escape(wanted)}(?:/.*)?")
            spaces = {found[1]: count for topic, count in counts.items() if (found := below.fullmatch(topic))}
            typed = {topic: counts[topic] for topic, kind in kinds.items() if kind in TYPES.get(name, ())}
            if "" in spaces:
                continue
            best = max(spaces, key=lambda one: (one == space, spaces[one]), default="")
            if best and (best == space or name == "scan" or not typed):
                chosen[name], space = best + wanted, best if name == "scan" else space
            else:
                chosen[name] = max(typed, key=lambda topic: typed[topic], default=space + wanted)
        return replace(self, **chosen)

    @property
    def main(self) -> Tuple[str, ...]:
        """Topics without which little can be said of a drive."""
        return self.scan, self.odometry, self.command, self.move_base, self.tf

    @property
    def decision(self) -> str:
        """Topic of the applr node's decisions."""
        return self.applr + "/decision"

    @property
    def course_end(self) -> str:
        """Topic of what the applr node sees where a course ends."""
        return self.applr + "/course_end"

    @property
    def updates(self) -> re.Pattern[str]:
        """Pattern of the topics on which move_base and its layers publish new parameters."""
        return re.compile(re.escape(self.move_base) + r"(?:/[^/]+){0,2}/parameter_updates")

    @classmethod
    def of(cls, robot: Any) -> TopicNames:
        """Return those of a robots.Robot without a namespace."""
        given = robot.topics
        scan, odometry, command = ("/" + name.lstrip("/") for name in (given.scan, given.odometry, given.cmd_vel))
        return cls(scan=scan, odometry=odometry, command=command)
