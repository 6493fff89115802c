"""Gymnasium environment "applr_ros1/Navigation-v0", the paper's meta-environment.

Actors use it, and any RL library can. State: scan capped at 2 m, phi, theta_{t-1}; (729,) for the
Jackal. Action: the planner's parameters, (8,) for the Jackal. One step is one decision period: in
the paper 2 s of simulated time, or 40 control cycles of MoveBase, the class that the ROS node runs
as well. applr_ros1/drives/end_rules.py defines time limits and ends of episodes.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any, Dict, Optional, Sequence, Tuple, Union

import gymnasium
import numpy as np
from typing_extensions import override

import sim_bridge
import worlds as worlds_package
from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.end_rules import Rules
from applr_ros1.drives.outcome import Outcome
from applr_ros1.drives.simulate import CourseDrive, cycles_in
from applr_ros1.policy.decision import Context
from applr_ros1.robots.geometry import radius
from training.common.options import checked
from training.env import privileged
from training.env.reward import failed
from training.env.settings import CHALLENGE, DRAWN, PAPER, TrialSettings, under
from training.env.trajectory import TransitionLayout
from worlds import World

Info = Dict[str, Any]


class ApplrEnv(gymnasium.Env):
    """Learning problem as a Gymnasium environment; a step is one decision period.

    Args:
        worlds: Worlds to drive in: a list of World, or a specification ("generated:train", a file,
            a folder; several are separated by commas).
        end_on_collision: Whether a collision terminates the episode as a failure.
        end_on_stall: Whether a stall (policy/stuck.py) terminates the episode as a failure.
        critics_know_more: Whether the observation ends with inputs for the critics alone
            (privileged.py).
        settings: Fields of TrialSettings (settings.py): robot, simulator, planner, randomisation,
            observation, ... period is required; gymnasium.make defaults to the paper's 2 s.

    Raises:
        ApplrError: An argument is invalid.
    """

    def __init__(
        self,
        worlds: Union[str, Sequence[World]] = "generated:train",
        *,
        end_on_collision: bool = False,
        end_on_stall: bool = False,
        critics_know_more: bool = False,
        **settings: Any,
    ):
        self.settings = checked(TrialSettings, settings, "environment")
        if self.settings.period is None:
            raise ApplrError("period is missing: give the decision period in seconds")
        self.period = self.settings.period
        robot = self.settings.robot
        self.worlds: Sequence[World] = list(worlds) if not isinstance(worlds, str) else ()
        if isinstance(worlds, str):
            self.worlds = worlds_package.Worlds(worlds, radius(robot))
        cycles_in(self.period)  # refused now, not at the first reset
        self.simulated = self.settings.simulated(
            sim_bridge.make(self.settings.simulator, robot=robot, **self.settings.randomisation),
            robot.seeing(self.settings.obstacle_range),
        )
        self.rules = Rules(
            end_on_contact=end_on_collision,
            end_on_stall=end_on_stall,
            limit=self.settings.time_limit,
        )
        self.course_drive: Optional[CourseDrive] = None  # drive of the present episode
        encoding = self.settings.encoding()
        self.encoding = encoding
        self.space = encoding.space
        self.layout = TransitionLayout.of(encoding)
        if critics_know_more:
            self.layout = _with_hidden_inputs(self.layout)
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (self.layout.size,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (encoding.actions,), np.float32)

    @override
    def reset(
        self, *, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None
    ) -> Tuple[np.ndarray, Info]:
        """Begin a course in the world of index options["world"], or else in a random world."""
        super().reset(seed=seed)
        world_index = (options or {}).get("world")
        if world_index is None:
            world_index = int(self.np_random.integers(len(self.worlds)))
        world = self.worlds[world_index]
        # The episode draws from a generator of its own, so that its seed says all about it.
        episode_seed = int(self.np_random.integers(2**31))
        protocol: str = self.settings.protocol
        if protocol == DRAWN:
            protocol = str(self.np_random.choice([PAPER, CHALLENGE]))
        world = worlds_package.scaled(under(protocol, world), self.settings.robot.world_scale)
        # The Challenge's rules hold in training, too.
        ends_on_contact = self.rules.end_on_contact or protocol == CHALLENGE
        rules = dataclasses.replace(self.rules, end_on_contact=ends_on_contact)
        course_drive = self.begin(world, episode_seed, rules)
        self.course_drive = course_drive
        self.encoding.forget_decision()
        return self._observation(course_drive), self._info(course_drive.outcome)

    def begin(self, world: World, seed: int, rules: Rules, *, record: bool = False) -> CourseDrive:
        """Return a new drive along the course of a world, with all columns if it is recorded."""
        return CourseDrive(
            self.simulated,
            world,
            seed,
            rules,
            period=self.period,
            theta=self.space.clip(self.space.theta0),
            record=record,
        )

    @override
    def step(self, action: np.ndarray) -> Tuple[np.ndarray, float, bool, bool, Dict[str, Any]]:
        """Drive one decision period.

        Arrival or failure terminates the episode, the time limit truncates it.
        """
        course_drive = self.course_drive
        if course_drive is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        course_drive.decide(self.space.clip(self.encoding.theta(action)))
        course_drive.advance()
        outcome = course_drive.outcome
        reward, reward_terms = self.settings.reward(
            outcome, course_drive.limit, course_drive.period, self.encoding
        )
        terminated = outcome.success or failed(outcome)
        truncated = outcome.over and not terminated
        info = self._info(outcome)
        info["reward"] = reward_terms
        return self._observation(course_drive), float(reward), terminated, truncated, info

    def _observation(self, course_drive: CourseDrive) -> np.ndarray:
        encoding = self.encoding
        context = Context.of(course_drive.theta, course_drive.seen, self.space, encoding.layout)
        policy_inputs = encoding.observe(context)
        if not self.layout.hidden:
            return policy_inputs
        hidden_inputs = privileged.privileged(course_drive, encoding.scale)
        return np.append(policy_inputs, hidden_inputs)

    @override
    def close(self) -> None:
        """Close the simulator."""
        self.simulated.simulator.close()

    def _info(self, outcome: Outcome) -> Dict[str, Any]:
        info = {"world": self.simulated.simulator.world.name, **vars(outcome)}
        # Equal episodes have equal infos, as Gymnasium demands, but NaN does not equal itself.
        if math.isnan(outcome.contact_speed):
            del info["contact_speed"]
        return info


def _with_hidden_inputs(layout: TransitionLayout) -> TransitionLayout:
    """Return a layout whose observations end with the inputs for the critics alone."""
    mirror_sign = layout.odd + tuple(layout.rest + hidden_index for hidden_index in privileged.ODD)
    hidden_count = privileged.SIZE
    return dataclasses.replace(
        layout,
        rest=layout.rest + hidden_count,
        odd=mirror_sign,
        hidden=hidden_count,
    )
