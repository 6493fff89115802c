"""Tests of the built-in METHODS: reproducible with a seed, parameters from what they see."""

import json

import numpy as np
import pytest

from applr_ros1.policy import methods


def scenes(method, count=8):
    """Return contexts from narrow to open, with missing returns and any current parameters."""
    space = method.space
    layout = method.layout
    rng = np.random.default_rng(0)
    goal_x = 10.0
    contexts = []
    for number in range(count):
        ranges = rng.uniform(0.1, 0.4 + number, layout.beams).astype(np.float32)
        has_no_return = rng.random(layout.beams) < number / count
        ranges[has_no_return] = np.inf
        phi = rng.uniform(-np.pi, np.pi)
        theta = space.to_theta(rng.uniform(-1.0, 1.0, len(space)))
        x = 0.5 * number
        plan = np.zeros((0, 2))
        # The first decision comes before the first plan.
        if number > 0:
            plan = np.linspace((x, 0.0), (goal_x, 0.0), 40)
        context = methods.Context(
            ranges=ranges,
            phi=phi,
            theta=theta,
            time=2.0 * number,
            pose=(x, 0.0, phi),
            twist=(0.1 * number, 0.0),
            goal=(goal_x, 0.0, 0.0),
            plan=plan,
            movers=rng.normal(0.0, 2.0, (number // 2, 4)),
            space=space,
            layout=layout,
        )
        contexts.append(context)
    return contexts


@pytest.mark.parametrize("spec", methods.METHODS)
def test_methods_of_the_package(spec):
    method = methods.make(spec)
    contexts = scenes(method)

    def decisions(seed, contexts):
        """Return the parameters of all decisions of a course."""
        method.reset(seed)
        return [method.theta(context).tolist() for context in contexts]

    first_course = decisions(7, contexts)
    # Another course in between must leave no trace.
    decisions(8, contexts[::-1])
    assert decisions(7, contexts) == first_course
    # A method changes nothing in what it sees.
    for context, unused in zip(contexts, scenes(method)):
        for field_name in ("observation", "ranges", "theta", "plan", "movers"):
            field = getattr(context, field_name)
            unused_field = getattr(unused, field_name)
            assert np.array_equal(field, unused_field), field_name
    # A static method decides without looking.
    if method.static:
        assert first_course == [method.theta(None).tolist()] * len(contexts)
    assert json.loads(json.dumps(method.describe()))


def test_exploration_draws_around_the_robots_set():
    method = methods.make("explore")
    space = method.space
    centre = methods.make("static").values
    method.reset(1)
    actions = []
    for _ in range(4000):
        actions.append(space.to_action(method.theta(None)))
    central_action = space.to_action(centre)

    # Parameters far from the ends of their ranges
    is_free = ~space.integer & (np.abs(central_action) < 0.1)
    assert is_free.any()
    changes = (np.array(actions) - central_action)[:, is_free]
    assert changes.mean(axis=0) == pytest.approx(0.0, abs=0.06)
    # 0.5 before clipping to [-1, 1]
    assert changes.std(axis=0) == pytest.approx(0.48, abs=0.03)
