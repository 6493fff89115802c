"""Tests that METHODS, the built-in methods, are reproducible with a seed and return parameters
within their bounds.
"""

import json

import numpy as np
import pytest

from applr_ros1.policy import methods


def scenes(method, count=8):
    """Return typical contexts: open and narrow, with missing returns, with any current
    parameters.
    """
    draw = np.random.default_rng(0)
    contexts = []
    for k in range(count):
        ranges = draw.uniform(0.1, 0.4 + k, method.layout.beams).astype(np.float32)
        ranges[draw.random(method.layout.beams) < k / count] = np.inf
        phi = draw.uniform(-np.pi, np.pi)
        theta = method.space.to_theta(draw.uniform(-1.0, 1.0, len(method.space)))
        pose = (0.5 * k, 0.0, phi)
        goal = (10.0, 0.0, 0.0)
        plan = np.linspace(pose[:2], goal[:2], 40)[: 40 * (k > 0)]
        movers = draw.normal(0.0, 2.0, (k // 2, 4))
        shown = (0.1 * k, 0.0), goal, plan, movers, method.space, method.layout
        contexts.append(methods.Context(ranges, phi, theta, 2.0 * k, pose, *shown))
    return contexts


@pytest.mark.parametrize("spec", methods.METHODS)
def test_methods_of_the_package(spec):
    method = methods.make(spec)
    contexts = scenes(method)

    def course(seed, seen):
        method.reset(seed)
        return [method.theta(context).tolist() for context in seen]

    first = course(7, contexts)
    course(8, contexts[::-1])
    assert course(7, contexts) == first
    assert np.array_equal(method.space.clip(first), first)
    for context, fresh in zip(contexts, scenes(method)):
        for name in ("observation", "ranges", "theta", "plan", "movers"):
            assert np.array_equal(getattr(context, name), getattr(fresh, name)), name
    if method.static:
        assert first == [method.theta(None).tolist()] * len(contexts)
    assert json.loads(json.dumps(method.describe()))


def test_exploration_draws_around_the_robots_set():
    method = methods.make("explore")
    space = method.space
    centre = methods.make("static").values
    method.reset(1)
    actions = np.array([space.to_action(method.theta(None)) for _ in range(4000)])
    # Parameters far from the ends of their ranges.
    free = ~space.integer & (np.abs(space.to_action(centre)) < 0.1)
    assert free.any()
    away = actions[:, free] - space.to_action(centre)[free]
    assert away.mean(axis=0) == pytest.approx(0.0, abs=0.06)
    # 0.5 before clipping to [-1, 1]
    assert away.std(axis=0) == pytest.approx(0.48, abs=0.03)
