"""Evaluation trials: which there are, what seed each has, and the one runner that drives them.

evaluate.py, the periodic evaluation of a training and static_search.py plan Trials and have them driven by TrialRunner
in a pool of workers. A trial depends on its task only, not on who drives it or what was driven before.
"""

from __future__ import annotations

import dataclasses
import io
import json
import zlib
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

import sim_bridge
import worlds as worlds_package
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.variant import OURS
from applr_ros1.policy import methods
from applr_ros1.policy.methods.included import GeneralPolicy
from applr_ros1.policy.observation import layout_of
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL, Robot, load, on_ground
from training.actors.tasks import POLICY, Answer, Trial, TrialResult
from training.actors.worker import PolicyWeights
from training.env.episode import TIME_LIMIT, Episode, counting_cells
from training.env.outcome import Trace
from training.env.reward import Reward
from worlds import World, WorldError, barn_grid

KEY = ("world", "method", "trial", "seed")
COLUMNS = KEY + ("success", "collided", "timeout", "time_s", "decisions", "path_length_m")
MEASURES = KEY + ("reason", "route_m", "min_clearance_m", "mean_jerk", "mean_turn", "switching")


class Protocol(NamedTuple):
    """Rules of a trial. end_on_collision: a collision ends it."""

    end_on_collision: bool
    sentence: str


PROTOCOLS = {
    "paper": Protocol(
        False,
        "The paper's course: from 1 m before the reference path to y = 10 (5.925 m), goal 5 m beyond its "
        "end; a contact does not end the trial; 100 s.",
    ),
    "barn-challenge": Protocol(
        True,
        "The BARN Challenge's course: start (-2.25, 3), goal 10 m ahead, reached within 1 m; among moving obstacles "
        "start (11, 0), goal 20 m ahead; a collision ends the trial; 100 s.",
    ),
}


def seed_of(base: int, world: str, trial: int) -> int:
    """The trial's seed: the same for every method, and whatever other worlds are driven."""
    return int(np.random.SeedSequence([base, zlib.crc32(world.encode()), trial]).generate_state(1)[0] >> 1)


def plan(
    worlds: Sequence[Tuple[str, str]],
    chosen: Sequence[Tuple[str, str]],
    trials: int,
    seed: int,
    traces: int = 1,
    planner: str = OURS,
) -> List[Trial]:
    """All trials in the order of trials.csv.

    First every world's first trial with each method, then every second one, so that a run that is stopped has driven
    all worlds, and more trials of the same evaluation only append.

    Args:
        worlds: [(name, specification), ...].
        chosen: the methods, [(name, specification), ...].
        trials: of each method in each world.
        seed: of all of them.
        traces: of so many trials of each method in each world the driven path is kept.
        planner: kind of planner (applr_ros1/planner/variant.py).
    """
    return [
        Trial(world, method, trial, seed_of(seed, world, trial), world_spec, method_spec, planner, trial < traces)
        for trial in range(trials)
        for world, world_spec in worlds
        for method, method_spec in chosen
    ]


def under(protocol: str, world: World) -> World:
    """The world with the protocol's course. WorldError where it does not fit.

    A world of moving obstacles has the BARN Challenge's course for it under both.
    """
    if protocol == "paper" or (world.movers and not len(world.cylinders)):
        return world
    if not barn_grid.fill_of(world.cylinders)[[0, -1]].all():
        raise WorldError(
            f"{world.name} is no BARN world: --protocol {protocol} needs one; give generated:N or a BARN file"
        )
    return dataclasses.replace(world, course=barn_grid.challenge_course(world.course.path))


def at_scale(protocol: str, spec: str, robot: Robot = JACKAL) -> World:
    """The world that a robot drives under a protocol: with its course, at the robot's scale. Raises WorldError."""
    return worlds_package.scaled(under(protocol, worlds_package.load(spec)), robot.world_scale)


def described(robot: Robot) -> Dict[str, Any]:
    """What evaluation.json says of the robot: name, length and width [m], scale of the worlds, parameter space."""
    space = json.loads(space_of(robot).to_json())
    return {"name": robot.name, "body": list(robot.body.size[:2]), "world_scale": robot.world_scale, "space": space}


TRIAL_RUNNER = "training.evaluation.trials:TrialRunner"  # as workers are told


class TrialRunner:
    """Runner of Trial tasks (training/actors/worker.py): one after the other, with one simulator.

    There is a planner of each kind that the tasks name.

    Args:
        simulator: name of the simulator.
        protocol: one of PROTOCOLS.
        reward: fields of the Reward that total_reward is counted in.
        period: decision period [s]; None: each method's own.
        monitor: whether the collision monitor stands between the planner and the base.
        planner_frequency: global plans per second, instead of the robot's; fewer make the simulation faster.
        robot: name or folder of the robot that drives; worlds are at its scale.
        time_limit: time after which a trial ends and counts as failed [s].
        observation: what a policy that is being learnt sees: "paper" or "dimensionless".
        ground: what it drives on (robots.GROUNDS), instead of the robot's own.
    """

    def __init__(
        self,
        simulator: str,
        protocol: str = "paper",
        reward: Optional[Dict[str, Any]] = None,
        period: Optional[float] = None,
        monitor: bool = False,
        planner_frequency: Optional[int] = None,
        robot: str = JACKAL.name,
        time_limit: float = TIME_LIMIT,
        observation: str = "paper",
        ground: str = "",
    ):
        self.robot = on_ground(load(robot), ground) if ground else load(robot)
        self.observation = observation
        self.space = space_of(self.robot)
        self.protocol, self.reward, self.monitor = protocol, Reward(**(reward or {})), monitor
        self.simulator, self.period = sim_bridge.make(simulator, robot=self.robot), period
        self.time_limit = time_limit
        self._params = counting_cells(self.robot.parameters())
        if planner_frequency is not None:
            self._params["planner_frequency"] = float(planner_frequency)
        self._episodes: Dict[str, Episode] = {}
        self._worlds: Dict[str, World] = {}
        self._methods: Dict[str, methods.Method] = {}

    def run(self, task: Trial, policy: Optional[PolicyWeights] = None) -> Answer:
        """Drives the trial; policy: what a trial of the method POLICY drives."""
        world, method = self._world(task.world_spec), self._method(task, policy)
        method.reset(task.seed)
        episode = self.episode(task.planner)
        episode.set_period(self.period or method.period)
        episode.layout = method.layout
        outcome = episode.reset(world, task.seed)
        if method.commands:
            episode.take_over()
        changes: List[float] = []
        total = 0.0
        while not outcome.over:
            context, before = episode.context(), self.space.to_action(outcome.theta)
            outcome = (
                episode.drive(*method.command(context)) if method.commands else episode.decide(method.theta(context))
            )
            changes.append(float(np.abs(self.space.to_action(outcome.theta) - before).mean()))
            total += self.reward(outcome, changes[-1], episode.limit, episode.period)[0]
        result = TrialResult(
            success=bool(outcome.success),
            collided=bool(outcome.collided),
            timeout=bool(outcome.timeout),
            time_s=float(outcome.time_s),
            path_length_m=float(outcome.path_length_m),
            reason=outcome.reason,
            route_m=float(world.course.route_m),
            min_clearance_m=float(outcome.min_clearance_m),
            mean_jerk=float(outcome.mean_jerk),
            mean_turn=float(outcome.mean_turn),
            switching=float(np.mean(changes)),
            decisions=int(outcome.decisions),
            total_reward=float(total),
        )
        return Answer(task, result=result, data=pack_trace(episode.trace) if task.trace else b"")

    def episode(self, planner: str) -> Episode:
        """The loop that drives this kind of planner, made when first asked for."""
        if planner not in self._episodes:
            self._episodes[planner] = Episode(
                self.simulator,
                MoveBase(self._params, planner=planner),
                self.robot,
                end_on_collision=PROTOCOLS[self.protocol].end_on_collision,
                record=True,
                monitor=self.monitor,
            )
            self._episodes[planner].time_limit = self.time_limit
        return self._episodes[planner]

    def _world(self, spec: str) -> World:
        if spec not in self._worlds:
            if len(self._worlds) >= 400:
                self._worlds.clear()
            self._worlds[spec] = at_scale(self.protocol, spec, self.robot)
        return self._worlds[spec]

    def _method(self, task: Trial, policy: Optional[PolicyWeights]) -> methods.Method:
        if task.theta is not None:
            return methods.for_robot(methods.FixedParameters(np.array(task.theta), space=self.space), self.robot)
        if task.method_spec == POLICY:
            if policy is None:
                raise ValueError("a trial of the policy came without a policy")
            learnt = _Learnt(policy, self.robot)
            return (
                methods.ObservationPolicy(learnt) if self.observation == "paper" else GeneralPolicy(learnt, self.robot)
            )
        if task.method_spec not in self._methods:
            self._methods[task.method_spec] = methods.make(task.method_spec, self.robot)
        return self._methods[task.method_spec]


class _Learnt:
    """The policy that is being learnt, as what ObservationPolicy asks."""

    def __init__(self, policy: PolicyWeights, robot: Robot):
        self.policy = policy
        self.space, self.layout = space_of(robot), layout_of(robot)

    def theta(self, observation: np.ndarray) -> np.ndarray:
        return self.space.to_theta(self.policy(observation))

    def action(self, observation: np.ndarray) -> np.ndarray:
        return self.policy(observation)


def pack_trace(trace: Trace) -> bytes:
    """A trial's trace as npz: time, pose, twist (a row per 50 ms), theta and decided [s] (a row per decision)."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        time=np.array(trace.time, np.float32),
        pose=np.array(trace.pose, np.float32),
        twist=np.array(trace.twist, np.float32),
        theta=np.array(trace.theta, np.float32),
        decided=np.array(trace.decided, np.float32),
    )
    return buffer.getvalue()


def world_list(text: str, protocol: str, robot: Robot = JACKAL) -> List[Tuple[str, str, World]]:
    """[(name, specification, World), ...] of a comma-separated list, checked, for a robot. Raises WorldError."""
    found: List[Tuple[str, str, World]] = []
    for part in text.split(","):
        for spec in worlds_package.specs(part.strip()):
            world = at_scale(protocol, spec, robot)
            if any(world.name == name for name, _, _ in found):
                raise WorldError(f"two worlds are called {world.name!r}: evaluate one at a time, or rename a file")
            found.append((world.name, spec, world))
    return found
