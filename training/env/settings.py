"""Settings of trials and training episodes, and the protocols, the rules that they are driven under.

The environment (env.py) and evaluation/runner.py share them.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Dict, Literal, NamedTuple, Optional, Union

from pydantic import Field, InstanceOf

from applr_ros1.policy.dimensionless import FORMS
from applr_ros1.policy.form import Form
from applr_ros1.robots import JACKAL, Robot, load, on_ground
from training.common.options import Options
from training.env.episode import TIME_LIMIT, counting_cells
from training.env.reward import Reward
from worlds import World, barn


class Protocol(NamedTuple):
    """Rules of a trial. end_on_collision: a collision ends it."""

    end_on_collision: bool
    sentence: str


PAPER, CHALLENGE, DRAWN = "paper", "barn-challenge", "drawn"
PROTOCOLS = {
    PAPER: Protocol(
        False,
        "The paper's course: from 1 m before the reference path to y = 10 (5.925 m), goal 5 m beyond its "
        "end; a contact does not end the trial; 100 s.",
    ),
    CHALLENGE: Protocol(
        True,
        "The BARN Challenge's course: start (-2.25, 3), goal 10 m ahead, reached within 1 m; among moving obstacles "
        "start (11, 0), goal 20 m ahead; other worlds keep their course; a collision ends the trial; 100 s.",
    ),
}


def under(protocol: str, world: World) -> World:
    """The world with the protocol's course.

    A world of moving obstacles has the BARN Challenge's course for it under both, one that is none of BARN's its own.
    """
    if protocol == PAPER or not barn.fill_of(world.cylinders)[[0, -1]].all():
        return world
    return dataclasses.replace(world, course=barn.challenge_course(world.course.path))


class TrialSettings(Options):
    """Robot, simulator, rules and score of trials; as JSON it identifies them for workers."""

    # fmt: off
    simulator: str = Field("kinematic", description="kinematic or pybullet.")
    robot: Union[str, InstanceOf[Robot]] = Field(
        JACKAL.name, description="Who drives, or its name or folder; worlds are at its scale.")
    ground: str = Field("", description="What it drives on (plain or gazebo), instead of the robot's own.")
    protocol: str = Field(PAPER, description="Whose course is driven, one of PROTOCOLS.")
    observation: Literal["paper", "dimensionless"] = Field("paper", description=
        "Form of what a learnt policy sees and does, and of the reward: the paper's, or the same numbers for every "
        "robot (applr_ros1/policy/dimensionless.py).")
    base: Dict[str, float] = Field({}, description=
        "Parameters that an action of the dimensionless form does not choose; else the defaults.")
    period: Optional[float] = Field(None, description="Decision period [s]; None: each method's own, for trials.")
    reward: Reward = Field(Reward(), description="Its coefficients.")
    monitor: bool = Field(False, description="Whether the collision monitor stands between the planner and the base.")
    movers: bool = Field(False, description="Whether the costmaps get where moving obstacles will be.")
    randomisation: Dict[str, Any] = Field({}, description=
        "What differs from the nominal robot, drawn at each reset: fields of sim_bridge.Randomisation such as latency.")
    planner_frequency: Optional[float] = Field(None, description=
        "Global plans per second instead of the robot's; fewer make the simulation faster.")
    loaded: bool = Field(False, description=
        "Whether move_base starts with the set of a static method, as with a parameter file, instead of getting it by "
        "reconfigure; the monitor makes no motions of escape then, which a C++ move_base lacks.")
    time_limit: float = Field(TIME_LIMIT, description="Time after which a trial ends and counts as failed [s].")
    # fmt: on

    def load_robot(self) -> Robot:
        """Return the robot, on the ground stated."""
        robot = load(self.robot) if isinstance(self.robot, str) else self.robot
        return on_ground(robot, self.ground) if self.ground else robot

    def form(self, robot: Robot) -> Form:
        """The form for a robot."""
        return FORMS[self.observation](robot, self.period, self.base)

    def planner_parameters(self, robot: Robot, tree: Optional[Dict[str, Any]] = None) -> Dict[str, Any]:
        """The planner's parameter tree, or that of the robot's files; its distance biases count per cell."""
        parameters = counting_cells(robot.parameters() if tree is None else tree)
        parameters["applr"] = {**parameters.get("applr", {}), "movers": self.movers}
        if self.planner_frequency is not None:
            parameters["planner_frequency"] = float(self.planner_frequency)
        return parameters
