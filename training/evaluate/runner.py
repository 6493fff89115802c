"""Runner of trials.

A result depends only on trial and settings, not on the worker or on earlier trials. Evaluations,
searches and the rounds of a training call run() in a pool of workers.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from functools import lru_cache, partial
from typing import Dict, Iterable, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

import sim_bridge
import worlds as worlds_package
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import sha256
from applr_ros1.drives.drive import Drive
from applr_ros1.drives.end_rules import Rules
from applr_ros1.drives.simulate import CourseDrive
from applr_ros1.policy import methods
from applr_ros1.policy.actor import Policy
from applr_ros1.policy.decision import Method
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.policy.pilot import Pilot
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import radius
from applr_ros1.stack.simulated import SimulatedRobot
from training.attempts.loaded import loadable_space, move_base_parameters
from training.env.settings import CHALLENGE, TrialSettings, under
from training.evaluate.trial import POLICY, Result, Trial
from training.workers.collect import policy_layers
from worlds import World


def run(settings: TrialSettings, trial: Trial, weights: bytes = b"") -> Tuple[Result, bytes]:
    """Drive a trial.

    Args:
        settings: Settings of the trial.
        trial: Trial to drive.
        weights: Weights of the policy, for a trial of the method POLICY.

    Returns:
        The result, and the packed trace if the trial asks for one, else b"".
    """
    runner = _runner(settings.model_dump_json())
    result = runner.run(trial, weights)
    trace = b""
    if trial.trace:
        trace = runner.drive.pack()
    return result, trace


class TrialWorld(NamedTuple):
    """World of trials, at the scale of the robot, with its name and the specification to load it.

    Names are those of the tables, and unique in an evaluation.
    """

    name: str
    specification: str
    world: World


def world_list(text: str, protocol: str, robot: Robot) -> List[TrialWorld]:
    """Return the worlds of a comma-separated list, scaled to a robot.

    Raises:
        ApplrError: A world cannot be loaded, or two have the same name.
    """
    listed: Dict[str, TrialWorld] = {}
    for specification in worlds_package.listed_specs(text, radius(robot)):
        world = at_scale(protocol, specification, robot)
        if world.name in listed:
            problem = f"two worlds have the name {world.name!r}"
            raise ApplrError(f"{problem}: evaluate one at a time, or rename a file")
        listed[world.name] = TrialWorld(world.name, specification, world)
    return list(listed.values())


def check_unseen(learned: Iterable[str], judged: Iterable[str]) -> None:
    """Raise ApplrError if a world of the option --worlds also judges what is learned there.

    Args:
        learned: Names of the worlds of the option.
        judged: Names of the worlds of choice and verdict.
    """
    common = set(learned).intersection(judged)
    if common:
        problem = f"--worlds contains {min(common)}, in which the result is judged"
        raise ApplrError(f"{problem}: leave out {len(common)} such worlds")


def at_scale(protocol: str, specification: str, robot: Robot) -> World:
    """Return a world with the protocol's course, scaled to the robot.

    Raises:
        ApplrError: The world cannot be loaded.
    """
    world = worlds_package.load(specification, radius(robot))
    return worlds_package.scaled(under(protocol, world), robot.world_scale)


def content(robot: Robot) -> str:
    """Return the SHA-256 of a robot's description and parameter files.

    Its drives depend on them, but not on where the files are.
    """
    trees = json.dumps(robot.move_base, sort_keys=True, default=str)
    description = repr(dataclasses.replace(robot, folder=""))
    return sha256((description + trees).encode())


def content_of_worlds(worlds: Sequence[TrialWorld]) -> str:
    """Return the SHA-256 of the contents of worlds, independent of where their files are.

    These are names, obstacles, moving obstacles and courses, but not how far a course is driven:
    finish line and goal tolerance follow from the protocol, which is a setting of its own.
    """
    digest = hashlib.sha256()
    for name, _, world in worlds:
        course = world.course
        for part in (world.cylinders, world.boxes, course.path):
            digest.update(part.tobytes())
        values = (name, course.start, course.goal, course.planner_ends, world.movers)
        digest.update(repr(values).encode())
    return digest.hexdigest()


@lru_cache(maxsize=16)
def _runner(settings: str) -> TrialRunner:
    """Return this process's runner for settings as JSON: making a simulator takes seconds."""
    return TrialRunner(TrialSettings.model_validate_json(settings))


class TrialRunner:
    """Runner with one simulator and one planner, which drives one trial after the other.

    Attributes:
        drive: Drive of the last trial.
    """

    def __init__(self, settings: TrialSettings):
        self.settings = settings
        self.robot = settings.robot
        self.space = space_of(self.robot)
        self.encoding = settings.encoding()
        self.loadable = loadable_space(self.robot)
        self.simulator = sim_bridge.make(
            settings.simulator, robot=self.robot, **settings.randomisation
        )
        self.rules = Rules(end_on_contact=settings.protocol == CHALLENGE, limit=settings.time_limit)
        self.drive = Drive()
        # Trials of an evaluation alternate between worlds and methods.
        self._world = lru_cache(maxsize=400)(partial(at_scale, settings.protocol, robot=self.robot))
        self._made = lru_cache(maxsize=None)(methods.make)
        self._seeing = lru_cache(maxsize=8)(self._simulated_seeing)

    def run(self, task: Trial, weights: bytes = b"") -> Result:
        """Drive a trial and return its result.

        Args:
            task: Trial to drive.
            weights: Weights of the policy of the method POLICY.
        """
        world = self._world(task.world_spec)
        robot = self.robot
        if world.map is not None:
            robot = self.simulated.robot_in(world)
        method = self._method(task, robot, weights)
        pilot = Pilot(method, robot, self.settings.period)
        pilot.begin(task.seed)
        theta = pilot.defaults().theta
        if self.settings.loaded and method.static:
            # Parameters that act differently when loaded keep their defaults.
            parameter_set = pilot.between_courses().theta
            theta = self.loadable.fill(self.loadable.chosen_of(parameter_set))
            simulated_robot = self.starting_with(theta, method.obstacle_range)
            # A parameter file drives without the applr node, and so without its rule for stalls.
            pilot.method = self._fixed(theta, redraws_stalled=False)
        else:
            simulated_robot = self._seeing(method.obstacle_range)

        course_drive = CourseDrive(
            simulated_robot,
            world,
            task.seed,
            self.rules,
            period=pilot.period,
            theta=theta,
        )
        total_reward = 0.0
        for _ in course_drive.legs(pilot):
            reward, _ = self.settings.reward(
                course_drive.outcome, course_drive.limit, pilot.period, self.encoding
            )
            total_reward += reward
        self.drive = course_drive.drive
        return Result.of(
            course_drive.outcome,
            route_m=world.course.route_m,
            switching=self._switching(self.drive),
            total_reward=total_reward,
        )

    def _switching(self, drive: Drive) -> float:
        """Return the mean change of the parameters per decision, in action units."""
        changes = []
        for decision in drive.decisions:
            action_before = self.space.to_action(np.array(list(decision.before.values())))
            action = self.space.to_action(np.array(list(decision.after.values())))
            changes.append(float(np.abs(action - action_before).mean()))
        return float(np.mean(changes))

    @property
    def simulated(self) -> SimulatedRobot:
        """Robot whose planner starts with the robot's default parameters."""
        return self._seeing(None)

    def _simulated_seeing(self, obstacle_range: Optional[float]) -> SimulatedRobot:
        """Return a robot whose planner starts with the robot's default parameters.

        Args:
            obstacle_range: Range [m] for which the method was made (policy.decision.Method), or
                None.
        """
        return self._simulated(self.robot.seeing(obstacle_range))

    def starting_with(self, theta: Array, obstacle_range: Optional[float] = None) -> SimulatedRobot:
        """Return a robot whose planner starts with a parameter set (n,).

        Args:
            theta: Parameter set.
            obstacle_range: Range [m] for which the set was made, or None.
        """
        changed = {}
        for (name, value), default in zip(self.space.as_dict(theta).items(), self.space.theta0):
            if value != default:
                changed[name] = value
        parameters = move_base_parameters(self.robot, changed)
        seeing_robot = self.robot.seeing(obstacle_range)
        return self._simulated(seeing_robot.with_parameters(parameters, self.robot.name))

    def _simulated(self, starts: Robot) -> SimulatedRobot:
        """Return the robot, whose planner starts with the parameters of `starts`."""
        # Loading stands for a C++ move_base, which has no escape motions.
        return self.settings.simulated(self.simulator, starts, escapes=not self.settings.loaded)

    def _method(self, task: Trial, robot: Robot, weights: bytes) -> Method:
        """Return the method of a trial, which drives with the parameters in use of a robot."""
        if task.theta is not None:
            fixed_set = self._fixed(np.array(task.theta))
            fixed_set.obstacle_range = task.obstacle_range
            return fixed_set
        if task.method_spec == POLICY:
            policy = Policy(self.encoding, policy_layers(weights))
            policy.obstacle_range = self.settings.obstacle_range
            return policy
        return self._made(task.method_spec, robot)

    def _fixed(self, theta: Array, redraws_stalled: bool = True) -> Method:
        """Return the method that sets a parameter set (n,) of the robot."""
        method = methods.FixedParameters(theta, self.space, redraws_stalled=redraws_stalled)
        return methods.for_robot(method, self.robot)
