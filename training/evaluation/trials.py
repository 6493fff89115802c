"""One evaluation trial: which there are, what seed each has, and driving one. evaluate.py plans them, trial_worker.py
drives them. A trial depends on its task only, not on who drives it or what was driven before.
"""

from __future__ import annotations

import base64
import dataclasses
import io
import zlib
from typing import Any, Dict, List, NamedTuple, Optional, Sequence, Tuple

import numpy as np

import sim_bridge
import worlds as worlds_package
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.variant import DEFAULT_WEIGHTS, OURS
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import SPACE
from training.mdp.episode import DECISION_LIMIT, Episode
from worlds import World, WorldError, field

KEY = ("world", "method", "trial", "seed")
COLUMNS = KEY + ("success", "collided", "timeout", "time_s", "decisions", "path_length_m")
WEIGHTS_COLUMN = "weights"  # the last one, in both tables, where several kinds of weights are driven
MEASURES = KEY + ("reason", "route_m", "min_clearance_m", "mean_jerk", "mean_turn", "switching")


class Protocol(NamedTuple):
    """limit: decisions of two seconds; end_on_contact: a collision ends the trial."""

    limit: int
    end_on_contact: bool
    sentence: str


PROTOCOLS = {
    "paper": Protocol(
        DECISION_LIMIT,
        False,
        "The paper's course: from 1 m before the reference path to y = 10 (5.925 m), goal 5 m beyond its "
        "end; a contact does not end the trial; 100 s.",
    ),
    "barn-challenge": Protocol(
        DECISION_LIMIT,
        True,
        "The BARN Challenge's course: start (-2.25, 3), goal 10 m ahead, reached within 1 m; among moving obstacles "
        "start (11, 0), goal 20 m ahead; a collision ends the trial; 100 s.",
    ),
}


class Task(NamedTuple):
    """A trial to drive. world and method are the names in trials.csv; *_spec say how to get them; weights and planner
    are MoveBase's (planner/variant.py).
    """

    world: str
    method: str
    trial: int
    seed: int
    world_spec: str
    method_spec: str
    trace: bool
    weights: str = DEFAULT_WEIGHTS
    planner: str = OURS

    @property
    def key(self) -> Tuple[str, str, str, str]:
        return self.world, self.method, str(self.trial), str(self.seed)


def seed_of(base: int, world: str, trial: int) -> int:
    """The trial's seed: the same for every method, and whatever other worlds are driven."""
    return int(np.random.SeedSequence([base, zlib.crc32(world.encode()), trial]).generate_state(1)[0] >> 1)


def plan(
    worlds: List[Tuple[str, str]],
    chosen: List[Tuple[str, str]],
    trials: int,
    seed: int,
    traces: int = 1,
    weights: Sequence[str] = (DEFAULT_WEIGHTS,),
    planner: str = OURS,
) -> List[Task]:
    """All tasks in the order of trials.csv: first every world's first trial with each method, then every second one, so
    that a run that is stopped has seen all worlds, and more trials of the same evaluation only append.

    worlds, chosen  [(name, specification), ...]
    traces          of so many trials a world and method the driven path is kept
    weights         kinds of distance weights; each drives every method with the same seeds
    """
    return [
        Task(world, method, trial, seed_of(seed, world, trial), world_spec, method_spec, trial < traces, kind, planner)
        for trial in range(trials)
        for world, world_spec in worlds
        for kind in weights
        for method, method_spec in chosen
    ]


def under(protocol: str, world: World) -> World:
    """The world with the protocol's course. WorldError where it does not fit.

    A world of moving obstacles has the BARN Challenge's course for it under both.
    """
    if protocol == "paper" or (world.movers and not len(world.cylinders)):
        return world
    if not field.fill_of(world.cylinders)[[0, -1]].all():
        raise WorldError(
            "%s is no BARN world: --protocol %s needs one; give generated:N or a BARN file" % (world.name, protocol)
        )
    return dataclasses.replace(world, course=field.challenge_course(world.course.path))


class Driver:
    """Drives tasks one after the other, with one simulator, and one planner of each kind that the tasks name."""

    def __init__(self, simulator: str, protocol: str):
        self.protocol = protocol
        self.simulator = sim_bridge.make(simulator)
        self._episodes: Dict[Tuple[str, str], Episode] = {}
        self._worlds: Dict[str, World] = {}
        self._methods: Dict[str, methods.Method] = {}

    def run(self, task: Task) -> Dict[str, Any]:
        """{"row": values of COLUMNS, "measures": of MEASURES, "trace": npz in base64 or None}: all of it JSON."""
        world, method = self._world(task.world_spec), self._method(task.method_spec)
        method.reset(task.seed)
        episode = self.episode(task.weights, task.planner)
        episode.set_period(method.period)
        outcome = episode.reset(world, task.seed)
        changes: List[float] = []
        while not outcome.over:
            context = methods.Context(episode.observation(), outcome.ranges, outcome.phi, outcome.theta, outcome.time_s)
            before = SPACE.to_action(outcome.theta)
            outcome = episode.decide(method.theta(context))
            changes.append(float(np.abs(SPACE.to_action(outcome.theta) - before).mean()))
        row = [
            bool(outcome.success),
            bool(outcome.collided),
            bool(outcome.timeout),
            _round(outcome.time_s),
            int(outcome.decisions),
            _round(outcome.path_length_m),
        ]
        measures = [
            outcome.reason,
            _round(world.course.route_m),
            _round(outcome.min_clearance_m),
            _round(outcome.mean_jerk),
            _round(outcome.mean_turn),
            _round(np.mean(changes)),
        ]
        key = list(task.key)
        return {
            "row": key + [str(v) for v in row],
            "measures": key + [str(v) for v in measures],
            "trace": pack_trace(episode.trace) if task.trace else None,
        }

    def episode(self, weights: str, planner: str) -> Episode:
        """The loop that drives this kind of planner, made when first asked for."""
        key = weights, planner
        if key not in self._episodes:
            rules = PROTOCOLS[self.protocol]
            move_base = MoveBase(weights=weights, planner=planner)
            self._episodes[key] = Episode(
                self.simulator, move_base, limit=rules.limit, end_on_contact=rules.end_on_contact, record=True
            )
        return self._episodes[key]

    def _world(self, spec: str) -> World:
        if spec not in self._worlds:
            if len(self._worlds) >= 400:
                self._worlds.clear()
            self._worlds[spec] = under(self.protocol, worlds_package.load(spec))
        return self._worlds[spec]

    def _method(self, spec: str) -> methods.Method:
        if spec not in self._methods:
            self._methods[spec] = methods.make(spec)
        return self._methods[spec]


def _round(value: float) -> float:
    return round(float(value), 4)


def pack_trace(trace) -> str:
    """A trial's trace as npz in base64: time, pose, twist (a row per 50 ms), theta (a row per decision)."""
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        time=np.float32(trace.time),
        pose=np.float32(trace.pose),
        twist=np.float32(trace.twist),
        theta=np.float32(trace.theta),
    )
    return base64.b64encode(buffer.getvalue()).decode()


def world_list(text: str, protocol: str) -> List[Tuple[str, str, Optional[World]]]:
    """[(name, specification, World), ...] of a comma-separated list, checked. Raises WorldError."""
    found = []
    for part in text.split(","):
        for spec in worlds_package.specs(part.strip()):
            world = under(protocol, worlds_package.load(spec))
            if any(world.name == name for name, _, _ in found):
                raise WorldError("two worlds are called %r: evaluate one at a time, or rename a file" % world.name)
            found.append((world.name, spec, world))
    return found
