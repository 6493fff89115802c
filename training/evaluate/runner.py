"""Runner of trials. A result depends only on trial and settings, not on the worker or on earlier trials.

Evaluations, searches and the rounds of a training call run() in a pool of workers.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
from functools import cached_property, lru_cache
from typing import List, Sequence, Tuple

import numpy as np

import sim_bridge
import worlds as worlds_package
from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import sha256
from applr_ros1.drives.drive import Drive
from applr_ros1.policy import methods
from applr_ros1.policy.actor import Policy
from applr_ros1.policy.decision import PERIOD, Method
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from applr_ros1.robots.geometry import radius
from training.env.episode import Episode
from training.env.settings import CHALLENGE, TrialSettings, under
from training.evaluate.loaded import loadable_space, move_base_parameters
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
    return result, runner.drive.pack() if trial.trace else b""


def at_scale(protocol: str, spec: str, robot: Robot) -> World:
    """Return a world with the protocol's course, scaled to the robot. Raises ApplrError if it cannot be loaded."""
    return worlds_package.scaled(
        under(protocol, worlds_package.load(spec, radius(robot))), robot.world_scale
    )


def content(robot: Robot) -> str:
    """Return the SHA-256 of a robot's description and parameter files, on which its drives depend."""
    trees = json.dumps(robot.move_base, sort_keys=True, default=str)
    return sha256((repr(dataclasses.replace(robot, folder="")) + trees).encode())


def content_of_worlds(worlds: Sequence[Tuple[str, str, World]]) -> str:
    """Return the SHA-256 of the contents of worlds (world_list), independent of where their files are."""
    digest = hashlib.sha256()
    for name, _, world in worlds:
        for part in (world.cylinders, world.boxes, world.course.path):
            digest.update(part.tobytes())
        digest.update(repr((name, world.course.start, world.course.goal, world.movers)).encode())
        # The suffix distinguishes these worlds from those of evaluations before planner_ends had an effect.
        digest.update(b"the planner's word" * world.course.planner_ends)
    return digest.hexdigest()


@lru_cache(maxsize=16)
def _runner(settings: str) -> TrialRunner:
    return TrialRunner(TrialSettings.model_validate_json(settings))


class TrialRunner:
    """Runner with one simulator and one planner, which drives one trial after the other.

    Attributes:
        drive: Drive of the last trial.
    """

    def __init__(self, settings: TrialSettings):
        self.settings, self.robot, self.period = settings, settings.robot, settings.period
        self.space, self.encoding = space_of(self.robot), settings.encoding()
        self.loadable = loadable_space(self.robot)
        self.simulator = sim_bridge.make(
            settings.simulator, robot=self.robot, **settings.randomisation
        )
        self.drive = Drive()
        self._world = lru_cache(maxsize=400)(
            lambda spec: at_scale(settings.protocol, spec, self.robot)
        )
        self._made = lru_cache(maxsize=None)(lambda spec: methods.make(spec, self.robot))

    def run(self, task: Trial, weights: bytes = b"") -> Result:
        """Drive a trial and return its result. `weights` belong to the policy of the method POLICY."""
        world, method = self._world(task.world_spec), self._method(task, weights)
        if self.period is not None:
            method.period = self.period
        method.reset(task.seed)
        loaded = None
        if self.settings.loaded and method.static:
            loaded = self.loadable.fill(self.loadable.pick(method.theta(None)))
            method = methods.for_robot(
                methods.FixedParameters(loaded, space=self.space), self.robot
            )
        episode = self.starting_with(loaded) if loaded is not None else self.episode
        episode.set_period(method.period)
        episode.layout = method.layout
        outcome = episode.reset(world, task.seed, theta=loaded)
        changes: List[float] = []
        total = 0.0
        while not outcome.over:
            context, before = episode.context(), outcome.theta
            outcome = episode.decide(method.theta(context))
            changes.append(
                float(
                    np.abs(
                        self.space.to_action(outcome.theta) - self.space.to_action(before)
                    ).mean()
                )
            )
            total += self.settings.reward(outcome, episode.limit, episode.period, self.encoding)[0]
        self.drive = episode.drive
        more = {
            "route_m": world.course.route_m,
            "switching": np.mean(changes),
            "total_reward": total,
        }
        values = {**vars(outcome), **more}
        return Result(
            **{name: type(default)(values[name]) for name, default in vars(Result()).items()}
        )

    @cached_property
    def episode(self) -> Episode:
        """Episode loop whose planner starts with the robot's default parameters."""
        return self._episode(self.robot)

    def starting_with(self, theta: Array) -> Episode:
        """Return an episode loop whose planner starts with a parameter set (n,)."""
        pairs = zip(self.space.as_dict(theta).items(), self.space.theta0)
        changed = {name: value for (name, value), start in pairs if value != start}
        return self._episode(
            self.robot.with_parameters(move_base_parameters(self.robot, changed), self.robot.name)
        )

    def _episode(self, starts: Robot) -> Episode:
        return Episode(
            self.simulator,
            self.settings.planners(starts),
            self.robot,
            period=PERIOD,
            end_on_collision=self.settings.protocol == CHALLENGE,
            monitor=self.settings.monitor,
            time_limit=self.settings.time_limit,
            escapes=not self.settings.loaded,  # loading stands for a C++ move_base, which makes none
        )

    def _method(self, task: Trial, weights: bytes) -> Method:
        if task.theta is not None:
            return methods.for_robot(
                methods.FixedParameters(np.array(task.theta), space=self.space), self.robot
            )
        if task.method_spec == POLICY:
            return Policy(self.encoding, policy_layers(weights))
        return self._made(task.method_spec)


def world_list(text: str, protocol: str, robot: Robot) -> List[Tuple[str, str, World]]:
    """Return [(name, specification, World), ...] of a comma-separated list, scaled to a robot. Raises ApplrError."""
    listed: List[Tuple[str, str, World]] = []
    for part in text.split(","):
        for spec in worlds_package.specs(part.strip(), radius(robot)):
            world = at_scale(protocol, spec, robot)
            if any(world.name == name for name, _, _ in listed):
                raise ApplrError(
                    f"two worlds have the name {world.name!r}: evaluate one at a time, or rename a file"
                )
            listed.append((world.name, spec, world))
    return listed
