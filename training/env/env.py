"""The paper's meta-environment for Gymnasium: id "applr_ros1/Navigation-v0". Actors train in it; any RL library can.

State: scan capped at 2 m, phi, theta_{t-1}; (729,) for the Jackal. Action: the planner's parameters, (8,) for the
Jackal. One step is one decision period (2 s of simulated time in the paper: 40 cycles of the very MoveBase that the ROS
node runs). Course, limit and ends are those of episode.py.
"""

from __future__ import annotations

import dataclasses
from typing import Any, Dict, Optional

import gymnasium
import numpy as np

import sim_bridge
import worlds as worlds_package
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.move_base import MoveBase
from training.common.options import checked
from training.env import privileged
from training.env.episode import Episode
from training.env.outcome import Outcome
from training.env.reward import failed
from training.env.settings import CHALLENGE, DRAWN, PAPER, TrialSettings, under
from training.replay.trajectory import TransitionLayout


class ApplrEnv(gymnasium.Env):
    """The learning problem as a Gymnasium environment; a step is one decision period.

    Args:
        worlds: what to drive: a list of World, or a specification ("generated:train", a file, a folder; several with
            commas between them).
        limit: decisions until the episode is truncated; None: as many as fit into 100 s.
        end_on_collision: a collision ends the episode, terminated, as a failure.
        end_on_stall: so does a stall (policy/actor.py).
        critics_know_more: the observation ends with numbers for the critics alone (privileged.py).
        settings: fields of TrialSettings (settings.py): robot, simulator, planner, randomisation, observation, ...;
            period must be given, and is the paper's 2 s where gymnasium.make gets none.

    Raises:
        ApplrError: of one line, for what cannot be.
    """

    def __init__(
        self,
        worlds="generated:train",
        *,
        limit: Optional[int] = None,
        end_on_collision: bool = False,
        end_on_stall: bool = False,
        critics_know_more: bool = False,
        **settings: Any,
    ):
        self.settings = checked(TrialSettings, settings, "environment")
        if self.settings.period is None:
            raise ApplrError("period: give the decision period in seconds")
        self.worlds = load_worlds(worlds)
        robot = self.settings.robot
        self.episode = Episode(
            sim_bridge.make(self.settings.simulator, robot=robot, **self.settings.randomisation),
            MoveBase(self.settings.planner_parameters(robot), planner=self.settings.planner),
            robot,
            limit=limit,
            period=self.settings.period,
            end_on_collision=end_on_collision,
            end_on_stall=end_on_stall,
            monitor=self.settings.monitor,
        )
        self.encoding = encoding = self.settings.encoding()
        self.space, self.episode.layout = encoding.space, encoding.layout
        self.layout = TransitionLayout.of(encoding)
        if critics_know_more:
            rest = self.layout.rest
            odd = encoding.mirror_sign + tuple(rest + place for place in privileged.ODD)
            more = privileged.SIZE
            self.layout = dataclasses.replace(self.layout, rest=rest + more, odd=odd, hidden=more)
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (self.layout.size,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (encoding.actions,), np.float32)

    def reset(self, *, seed: Optional[int] = None, options: Optional[Dict[str, Any]] = None):
        """Begin a course in the world of the index options["world"], else in one that is drawn."""
        super().reset(seed=seed)
        index = (options or {}).get("world")
        world = self.worlds[int(self.np_random.integers(len(self.worlds))) if index is None else index]
        draw = int(self.np_random.integers(2**31))
        protocol: str = self.settings.protocol
        if protocol == DRAWN:
            protocol = str(self.np_random.choice([PAPER, CHALLENGE]))
        world = worlds_package.scaled(under(protocol, world), self.episode.robot.world_scale)
        outcome = self.episode.reset(world, draw)
        self.encoding.reset()
        return self._observation(), self._info(outcome)

    def step(self, action):
        """One decision. terminated: at the goal, or failed for good; truncated: the time limit (bootstrap there)."""
        if self.episode.outcome is None:
            raise gymnasium.error.ResetNeeded("call reset() before step()")
        outcome = self.episode.decide(self.encoding.theta(action))
        reward, terms = self.settings.reward.judge(self.encoding, self.episode)
        terminated = outcome.success or failed(outcome)
        truncated = outcome.over and not terminated
        info = self._info(outcome)
        info["reward"] = terms
        return self._observation(), float(reward), terminated, truncated, info

    def _observation(self) -> np.ndarray:
        seen = self.encoding.observe(self.episode.context())
        if not self.layout.hidden:
            return seen
        return np.append(seen, privileged.privileged(self.episode, self.encoding.scale))

    def close(self):
        """Close the simulator."""
        self.episode.simulator.close()

    def _info(self, outcome: Outcome) -> Dict[str, Any]:
        return {"world": self.episode.world.name, **vars(outcome)}


def load_worlds(spec):
    """The worlds of a specification, several with commas between them; a list of World stays as it is."""
    return worlds_package.Worlds(spec) if isinstance(spec, str) else list(spec)
