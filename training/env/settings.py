"""Settings of drives for evaluations and trainings, with the protocol: course and rules."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any, Dict, List, Literal, Optional

from pydantic import ConfigDict

from applr_ros1.drives.end_rules import TIME_LIMIT
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy.dimensionless import ENCODINGS
from applr_ros1.policy.encoding import Encoding
from applr_ros1.robots import Robot
from applr_ros1.stack.simulated import SimulatedRobot
from applr_ros1.stack.stack import Stack
from sim_bridge.simulator import Simulator
from training.common.command_line import AnyRobot, SimulatorName
from training.common.options import Options, option
from training.env.reward import Reward
from worlds import World, barn

PAPER, CHALLENGE, DRAWN = "paper", "barn-challenge", "drawn"  # names of the protocols


def under(protocol: str, world: World) -> World:
    """Return the world with the protocol's course.

    Dynamic worlds keep the BARN Challenge's course under both protocols; worlds outside BARN keep
    their own course.
    """
    if protocol == PAPER or not barn.fill_of(world.cylinders)[[0, -1]].all():
        return world
    return dataclasses.replace(world, course=barn.challenge_course(world.course.path))


class DriveSettings(Options):
    """Robot, simulator, planner and rules of drives, as options of evaluations and trainings."""

    model_config = ConfigDict(title="Robot, simulator and rules")

    # fmt: off
    robot: AnyRobot
    simulator: SimulatorName = option("kinematic",
        "Simulator to drive in; evaluations of a training drive in pybullet.")
    protocol: Literal["paper", "barn-challenge", "drawn"] = option(PAPER,
        "Course and rules of a drive. paper: the paper's course; a contact does not end the "
        "drive. barn-challenge: the BARN Challenge's course of 10 m; a contact ends the drive. "
        "drawn (only in training): each episode draws one of the two; evaluations use "
        "barn-challenge.")
    planner: Literal["ours", "cpp-like", "drawn"] = option("ours",
        "Planner fidelity. ours: this package's planner. cpp-like: with the defects of the C++ "
        "move_base that affect success. drawn: each drive draws one of the two; evaluations of a "
        "training use ours.")
    monitor: bool = option(False,
        "Put the collision monitor between the planner and the base, as the launch file does. "
        "Without the monitor, the base receives every command of the planner unchanged.")
    matched: bool = option(True,
        "With the monitor and without a map, drive in the frame of the poses that the monitor has "
        "matched, as the launch file does. Without this, costmaps are in the odometry's frame.")
    movers: bool = option(False,
        "Track moving obstacles in the scans and mark their predicted positions in the costmaps, "
        "as the launch file does (docs/explanation/movers.md).")
    # fmt: on


class TrialSettings(DriveSettings):
    """Settings of trials and training episodes, which workers receive as JSON.

    Attributes:
        observation: Encoding of observations and actions (applr_ros1/policy/encoding.py), whose
            units the reward uses.
        base: Values of parameters that no action of the dimensionless encoding sets. Parameters
            missing here keep their defaults.
        obstacle_range: Range [m] up to which lasers mark obstacles in training episodes and in
            trials of their policy (policy.decision.Method); None for the range in the robot's
            files.
        period: Decision period [s]. In trials, None means the period of each method.
        reward: Coefficients of the reward.
        randomisation: Fields of sim_bridge.Randomisation, drawn at each reset.
        loaded: Whether move_base starts with the parameter set of a static method, as from a
            parameter file, instead of getting the set by reconfigure. Escape motions are then off,
            as a C++ move_base makes none.
        time_limit: Time after which a trial ends and counts as failed [s].
    """

    observation: Literal["paper", "dimensionless"] = "paper"
    base: Dict[str, float] = {}
    obstacle_range: Optional[float] = None
    period: Optional[float] = None
    reward: Reward = Reward()
    randomisation: Dict[str, Any] = {}
    loaded: bool = False
    time_limit: float = TIME_LIMIT

    def encoding(self) -> Encoding:
        """Return a new encoding for the robot."""
        return ENCODINGS[self.observation](self.robot, self.period, self.base)

    def simulated(
        self, simulator: Simulator, starts: Robot, escapes: bool = True
    ) -> SimulatedRobot:
        """Return the robot of a simulator, with the stacks of these settings.

        Args:
            simulator: Simulator of the robot.
            starts: Robot with the parameters with which the planners start.
            escapes: Whether the monitor makes escape motions (Stack).
        """
        made = partial(Stack, self.robot, monitor=self.monitor, escapes=escapes)
        return SimulatedRobot(simulator, *map(made, self.planners(starts)))

    def planners(self, robot: Robot) -> List[MoveBase]:
        """Return a robot's planners for worlds without and, if there is one, with a map.

        Their distance biases are per costmap cell. There is none for a map if robot.yaml has no
        setup with a map, or one with sensors that are not simulated.
        """
        if self.monitor and self.matched:
            robot = robot.in_matched_frame()
        planners = [self._planner(robot)]
        if robot.move_base.with_map is not None:
            knowing_planner = self._planner(robot.on_map())
            # The simulator has the sensors of the setup without a map.
            if knowing_planner.sources == planners[0].sources:
                planners.append(knowing_planner)
        return planners

    def _planner(self, robot: Robot) -> MoveBase:
        """Return the planner with the parameters that a robot uses."""
        parameters = robot.driven_parameters()
        parameters["applr"] = {**parameters.get("applr", {}), "movers": self.movers}
        return MoveBase(parameters, planner=self.planner)
