"""Topic names of a recorded drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class TopicNames:
    """Names of the topics of a recorded drive."""

    scan: str = "/front/scan"
    odometry: str = "/odometry/filtered"
    move_base: str = "/move_base"
    collision: str = "/sim_bridge/collision"
    applr: str = "/applr"
    command: str = "/cmd_vel"
    demonstration: str = "/demonstration"  # std_msgs/String with JSON about the demonstrator (demonstrate.py)

    @property
    def decision(self) -> str:
        """Topic of the applr node's decisions."""
        return self.applr + "/decision"

    @property
    def course_end(self) -> str:
        """Topic of the observation at the end of a course."""
        return self.applr + "/course_end"

    @classmethod
    def of(cls, robot: Any) -> TopicNames:
        """Return the topics of a robots.Robot without a namespace."""
        given = robot.topics
        scan, odometry, command = ("/" + name.lstrip("/") for name in (given.scan, given.odometry, given.cmd_vel))
        return cls(scan=scan, odometry=odometry, command=command)
