"""Contexts of decisions, for tests of the stall rule and the Pilot."""

import numpy as np

from applr_ros1.policy.decision import Context
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import JACKAL

# Directions of a plan
BACK = -1.0
AHEAD = 1.0


def scene(time, x=0.0, v=0.0, robot=JACKAL, way=BACK):
    """Return the context of a robot at x [m] with a plan of 3 m back or ahead."""
    space = space_of(robot)
    pose = (x, 0.0, 0.0)
    plan_x = x + way * np.linspace(0.0, 3.0, 60)
    plan = np.column_stack([plan_x, np.zeros(60)])
    return Context(
        ranges=np.ones(720, np.float32),
        phi=0.0,
        theta=space.theta0,
        time=time,
        pose=pose,
        twist=(v, 0.0),
        plan=plan,
        space=space,
    )
