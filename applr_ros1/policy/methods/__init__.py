"""Methods: what decides over the planner's parameters, the same objects in the nodes and in evaluation.

A person's own is a subclass of Method, in any module:

    from applr_ros1.policy.methods import Method
    from applr_ros1.policy.parameter_space import SPACE

    class Cautious(Method):                      # evaluate.py --methods my_module:Cautious; method:=my_module:Cautious
        def reset(self, seed): ...               # optional: a course begins; draw randomness from this seed only
        def theta(self, context):                # at every decision; see Context
            slow = context.ranges.min() < 0.4
            return SPACE.from_dict({"max_vel_x": 0.3 if slow else 1.0})     # names left out keep theta_0

A class may also stand in a file: `my_methods.py:Cautious`. `module:Class:text` gives the text to the constructor.
Parameters that come back are clipped to the space's bounds; NaN is refused.
"""

from applr_ros1.policy.actor import Policy
from applr_ros1.policy.decision import PERIOD, Context, Method
from applr_ros1.policy.methods.included import FixedParameters, RandomParameters
from applr_ros1.policy.methods.registry import (
    FORMS,
    METHODS,
    POLICY,
    SET,
    absolute,
    auto,
    for_robot,
    make,
    parse,
    shipped,
)

__all__ = [
    "FORMS",
    "METHODS",
    "PERIOD",
    "POLICY",
    "SET",
    "Context",
    "FixedParameters",
    "Method",
    "Policy",
    "RandomParameters",
    "absolute",
    "auto",
    "for_robot",
    "make",
    "parse",
    "shipped",
]
