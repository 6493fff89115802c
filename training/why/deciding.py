"""Decisions of a recorded drive that the robot's policy made.

A policy decides anew at every place. What it sets cannot be changed from outside, and no drive with
constant values shows how the robot would drive with another value of a file.
"""

from __future__ import annotations

from typing import List, Optional, Sequence

import numpy as np

from applr_ros1.common.errors import ApplrError
from applr_ros1.drives.drive import Decision
from applr_ros1.planner.parameters.settings import Change
from applr_ros1.policy import methods
from applr_ros1.policy.decision import Context, Method
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import Robot
from applr_ros1.why.recording import Recording
from training.attempts.trials import POLICY

# Largest difference between equal decisions, of ranges from -1 to 1: messages hold float32 values.
SAME = 1e-3
# Share of the decisions from which on the policy has driven. The rule for stalls makes some, too.
DECIDED = 0.5


def decides(recording: Recording) -> bool:
    """Return whether the robot's policy made most of the decisions of a drive."""
    decisions = recording.drive.decisions
    if not decisions:
        return False
    try:
        policy = methods.make(POLICY, recording.robot)
    except ApplrError:  # The robot has none.
        return False
    same_count = 0
    for decision in decisions:
        difference = _difference(decision, policy)
        same_count += difference is not None and difference <= SAME
    return same_count > DECIDED * len(decisions)


def _difference(decision: Decision, policy: Method) -> Optional[float]:
    """Return how far a decision is from the policy's, None if that is unknown."""
    space = policy.space
    if decision.seen is None or not set(space.names) <= decision.before.keys() & decision.after:
        return None
    theta_before = np.array([decision.before[name] for name in space.names])
    theta_after = np.array([decision.after[name] for name in space.names])
    try:
        context = Context.of(theta_before, decision.seen, space, policy.layout)
        theta = space.clip(policy.theta(context))
    except ApplrError:  # such as a blind scan
        return None
    return float(np.abs(space.to_action(theta) - space.to_action(theta_after)).max())


def undecided(changes: Sequence[Change], robot: Robot) -> List[Change]:
    """Return the changes of values that no policy of a robot sets."""
    decided_values = set()
    for targets in space_of(robot).targets.values():
        for target in targets:
            decided_values.add((target.server, target.name))
    return [change for change in changes if (change.server, change.name) not in decided_values]
