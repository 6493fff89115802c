"""Contexts of decisions and a method, for tests of stall rule, Pilot and Supervisor."""

import numpy as np

from applr_ros1.policy.decision import Context, Method
from applr_ros1.policy.parameter_space import SPACE, THETA_0, space_of
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
        goal=(plan_x[-1], 0.0, 0.0),
        plan=plan,
        space=space,
    )


def driving(time):
    """Return the context of a robot that drives ahead at 1 m/s."""
    return scene(float(time), x=float(time), v=1.0, way=AHEAD)


class Chooses(Method):
    """Method that chooses what a test sets, or raises it."""

    def __init__(self, theta=THETA_0, static=False):
        self.chosen = theta
        self.static = static
        self.seeds = []

    def reset(self, seed):
        self.seeds.append(seed)

    def theta(self, context):
        if isinstance(self.chosen, Exception):
            raise self.chosen
        return self.chosen


def parameters(**values):
    """Return theta_0 with other values, whatever their ranges."""
    return np.array(list({**SPACE.as_dict(THETA_0), **values}.values()))
