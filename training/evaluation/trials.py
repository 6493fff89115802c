"""Evaluation trials: which there are, what seed each has, and the one runner that drives them.

evaluate.py, the periodic evaluation of a training and static_search.py plan Trials and have them driven by TrialRunner
in a pool of workers. A trial depends on its task only, not on who drives it or what was driven before.
"""

from __future__ import annotations

import dataclasses
import io
import json
import zlib
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

import sim_bridge
import worlds as worlds_package
from applr_ros1.common.files import sha256
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.variant import OURS
from applr_ros1.policy import methods
from applr_ros1.policy.dimensionless import FORMS
from applr_ros1.policy.form import PAPER
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL, Robot, load, on_ground
from training.actors.tasks import POLICY, Answer, Trial, TrialResult
from training.actors.worker import PolicyWeights
from training.env.episode import TIME_LIMIT, Episode, counting_cells
from training.env.outcome import Trace
from training.env.protocols import PROTOCOLS, under
from training.env.reward import Reward
from worlds import World, WorldError

KEY = ("world", "method", "trial", "seed")
COLUMNS = KEY + ("success", "collided", "timeout", "time_s", "decisions", "path_length_m")
MEASURES = KEY + ("reason", "route_m", "min_clearance_m", "mean_jerk", "mean_turn", "switching")


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
    robots: Sequence[str] = ("",),
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
        robots: who drives, as Trial.robot; world after world the next of them.
    """
    return [
        Trial(
            *(world, method, trial, seed_of(seed, world, trial), world_spec, method_spec, planner, trial < traces),
            robot=robots[i % len(robots)],
        )
        for trial in range(trials)
        for i, (world, world_spec) in enumerate(worlds)
        for method, method_spec in chosen
    ]


def at_scale(protocol: str, spec: str, robot: Robot = JACKAL) -> World:
    """The world that a robot drives under a protocol: with its course, at the robot's scale. Raises WorldError."""
    return worlds_package.scaled(under(protocol, worlds_package.load(spec)), robot.world_scale)


def described(robot: Robot) -> Dict[str, Any]:
    """What evaluation.json says of the robot: name, length and width [m], scale of the worlds, space, content."""
    space = json.loads(space_of(robot).to_json())
    return {
        "name": robot.name,
        "body": list(robot.body.size[:2]),
        "world_scale": robot.world_scale,
        "space": space,
        "sha256": content(robot),
    }


def content(robot: Robot) -> str:
    """SHA-256 of what a robot's description and parameter files say: another one drives otherwise."""
    trees = json.dumps(vars(robot.move_base), sort_keys=True, default=str)
    return sha256((repr(dataclasses.replace(robot, folder="")) + trees).encode())


TRIAL_RUNNER = "training.evaluation.trials:TrialRunner"  # as workers are told
ROBOTS_TRIALS = "training.evaluation.trials:RobotsTrials"


class TrialRunner:
    """Runner of Trial tasks (training/actors/worker.py): one after the other, with one simulator.

    There is a planner of each kind that the tasks name.

    Args:
        simulator: name of the simulator.
        protocol: one of PROTOCOLS.
        reward: fields of the Reward that total_reward is counted in.
        period: decision period [s]; None: each method's own, which a policy that is being learnt does not have.
        monitor: whether the collision monitor stands between the planner and the base.
        planner_frequency: global plans per second, instead of the robot's; fewer make the simulation faster.
        robot: name or folder of the robot that drives; worlds are at its scale.
        time_limit: time after which a trial ends and counts as failed [s].
        observation: what a policy that is being learnt sees, and in which form total_reward is counted: "paper" or
            "dimensionless".
        ground: what it drives on (robots.GROUNDS), instead of the robot's own.
        base: of a policy that is being learnt in the dimensionless form (applr_ros1/policy/dimensionless.py).
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
        observation: str = PAPER,
        ground: str = "",
        base: Optional[Dict[str, float]] = None,
    ):
        self.robot = on_ground(load(robot), ground) if ground else load(robot)
        self.space = space_of(self.robot)
        self.protocol, self.monitor = protocol, monitor
        self.reward, self.form = Reward(**(reward or {})), FORMS[observation](self.robot, period, base)
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
        if self.period is not None:
            method.period = self.period
        method.reset(task.seed)
        episode = self.episode(task.planner, method.period)
        episode.layout = method.layout
        outcome = episode.reset(world, task.seed)
        changes: List[float] = []
        total = 0.0
        while not outcome.over:
            context, before = episode.context(), outcome.theta
            outcome = episode.decide(method.theta(context))
            changes.append(float(np.abs(self.space.to_action(outcome.theta) - self.space.to_action(before)).mean()))
            total += self.reward.judge(self.form, before, episode)[0]
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

    def episode(self, planner: str, period: float) -> Episode:
        """The loop that drives this kind of planner, made when first asked for; period: that of the decisions [s]."""
        if planner not in self._episodes:
            self._episodes[planner] = Episode(
                self.simulator,
                MoveBase(self._params, planner=planner),
                self.robot,
                period=period,
                end_on_collision=PROTOCOLS[self.protocol].end_on_collision,
                record=True,
                monitor=self.monitor,
            )
            self._episodes[planner].time_limit = self.time_limit
        self._episodes[planner].set_period(period)
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
            if self.period is None:
                raise ValueError("the policy that is being learnt has no decision period of its own: state it")
            return methods.Policy(self.form, policy.layers)
        if task.method_spec not in self._methods:
            self._methods[task.method_spec] = methods.make(task.method_spec, self.robot)
        return self._methods[task.method_spec]


class RobotsTrials:
    """Runner of Trial tasks that name their robots: a TrialRunner for each of them, made with the same options."""

    def __init__(self, **options: Any):
        self._options = options
        self._runners: Dict[str, TrialRunner] = {}

    def run(self, task: Trial, policy: Optional[PolicyWeights] = None) -> Answer:
        """Drives the trial with its robot."""
        if task.robot not in self._runners:
            self._runners[task.robot] = TrialRunner(**dict(self._options, robot=task.robot))
        return self._runners[task.robot].run(task, policy)


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
