"""Options of a command that reads bags: the robot, and the topics of its recordings."""

from __future__ import annotations

from dataclasses import replace
from typing import Dict

from applr_ros1.drives.columns import TopicNames
from training.common.command_line import AnyRobot
from training.common.options import Options, option


class BagOptions(Options):
    """Robot that recorded the bags, and topics of its recordings."""

    robot: AnyRobot
    scan: str = option("", "Topic of the laser scans in the bags. Default: the robot's.")
    odometry: str = option("", "Topic of the odometry in the bags. Default: the robot's.")
    command: str = option("", "Topic of the velocity commands in the bags. Default: the robot's.")

    def topics(self) -> TopicNames:
        """Return the robot's topics, replaced by those that are given as options."""
        return replace(TopicNames.of(self.robot), **self.given_topics())

    def given_topics(self) -> Dict[str, str]:
        """Return the fields of TopicNames that are given as options."""
        given_topics = {}
        for option_name, option_value in self:
            if option_value and hasattr(TopicNames, option_name):
                given_topics[option_name] = option_value
        return given_topics
