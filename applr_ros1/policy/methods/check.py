"""Whether a method keeps the contract that node and evaluation rely on: `check_method(MyMethod())`.

Users call it for their own class, for instance in a test of theirs;
tests/policy/test_method_contract.py calls it for all that come with the package.
"""

from __future__ import annotations

import json
from typing import Any, List

import numpy as np

from applr_ros1.common.errors import ApplrError, one_line, reason
from applr_ros1.policy.decision import Context
from applr_ros1.policy.methods.protocol import Method
from applr_ros1.policy.methods.user_method import UserMethod
from applr_ros1.policy.observation import LAYOUT, Layout, observe
from applr_ros1.policy.parameter_space import SPACE, Space

DECISIONS = 8


def check_method(method: Any) -> None:
    """Put a method to its contract. Returns nothing when it is kept.

    Args:
        method: A Method, or an object of one's own with theta(context).

    Raises:
        ApplrError: One line with the promise that is broken.
    """
    name = type(method).__name__
    used = method if isinstance(method, Method) else UserMethod(method, name)
    _need(np.isfinite(used.period) and 0.05 <= used.period <= 60.0, name, "period is %r s, not .05 to 60" % used.period)
    contexts = scenes(DECISIONS, used.space, used.layout)
    first = _course(used, contexts, 7, name)
    _need(_course(used, contexts, 7, name) == first, name, "the same seed and contexts gave other parameters")
    _course(used, contexts[::-1], 8, name)
    _need(_course(used, contexts, 7, name) == first, name, "what it decides depends on an earlier course")
    if used.static:
        _need(len(set(first)) == 1, name, "it is static, but its parameters change")
        _need(_decide(used, None, name) == first[0], name, "it is static, but theta(None) differs")
    try:
        json.dumps(used.describe())
    except (TypeError, ValueError) as error:
        raise ApplrError("%s: describe() is no JSON (%s)" % (name, reason(error))) from None


def scenes(count: int, space: Space = SPACE, layout: Layout = LAYOUT) -> List[Context]:
    """Contexts as they come up while driving: open and narrow, no returns, +inf, any parameters in force."""
    draw = np.random.default_rng(0)
    found = []
    for k in range(count):
        ranges = draw.uniform(0.1, 0.4 + k, layout.beams).astype(np.float32)
        ranges[draw.random(layout.beams) < k / count] = np.inf
        phi, theta = float(draw.uniform(-np.pi, np.pi)), space.to_theta(draw.uniform(-1.0, 1.0, len(space)))
        pose, goal = (0.5 * k, 0.0, phi), (10.0, 0.0, 0.0)
        plan = np.linspace(pose[:2], goal[:2], 40)
        seen = observe(ranges, phi, theta, space, layout)
        ahead, moving = plan[: 40 * (k > 0)], (0.1 * k, 0.0)
        found.append(Context(seen, ranges, phi, theta, 2.0 * k, pose, moving, goal, ahead, space))
    return found


def _course(method: Method, contexts: List[Context], seed: int, name: str) -> List[bytes]:
    method.reset(seed)
    return [_decide(method, context, name) for context in contexts]


def _decide(method: Method, context: Any, name: str) -> bytes:
    before = _content(context)
    try:
        decided = np.array(method.theta(context), dtype=np.float64)
    except ApplrError:
        raise
    except Exception as error:
        raise ApplrError("%s: theta(context) raised %s" % (name, one_line(error))) from None
    size = len(method.space)
    _need(decided.shape == (size,), name, "theta has shape %s, not (%d,)" % (decided.shape, size))
    _need(bool(np.isfinite(decided).all()), name, "theta is not finite")
    _need(
        np.array_equal(method.space.clip(decided), decided), name, "theta lies outside the ranges, or a count is broken"
    )
    _need(before == _content(context), name, "it changed the context that it was given")
    return decided.tobytes()


def _content(context: Any) -> Any:
    if context is None:
        return None
    return [array.tobytes() for array in (context.observation, context.ranges, context.theta, context.plan)]


def _need(holds: Any, name: str, problem: str) -> None:
    if not holds:
        raise ApplrError("%s: %s" % (name, problem))
