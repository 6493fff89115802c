"""Methods: what decides over the planner's parameters, the same objects as launch modes and in evaluation.

A person's own is a class of this shape, in any module:

    from applr_ros1.policy.parameter_space import SPACE

    class Cautious:                              # evaluate.py --methods my_module:Cautious; mode:=my_module:Cautious
        def reset(self, seed): ...               # optional: a course begins; draw randomness from this seed only
        def theta(self, context):                # at every decision; see Context
            slow = context.ranges.min() < 0.4
            return SPACE.from_dict({"max_vel_x": 0.3 if slow else 1.0})     # names left out keep theta_0

`module:Class:text` gives the text to the constructor. What comes back is clipped to the space's bounds; NaN is refused.
`check_method(Cautious())` says whether it keeps the contract.
"""

from applr_ros1.policy.decision import PERIOD, Context
from applr_ros1.policy.methods.check import check_method
from applr_ros1.policy.methods.included import FixedParameters, FrozenParameter, ObservationPolicy, RandomParameters
from applr_ros1.policy.methods.own import OwnMethod
from applr_ros1.policy.methods.protocol import Method, MethodError
from applr_ros1.policy.methods.registry import FORMS, METHODS, MODES, make, make_mode, parse, shipped

__all__ = [
    "FORMS",
    "METHODS",
    "MODES",
    "PERIOD",
    "Context",
    "FixedParameters",
    "FrozenParameter",
    "Method",
    "MethodError",
    "ObservationPolicy",
    "OwnMethod",
    "RandomParameters",
    "check_method",
    "make",
    "make_mode",
    "parse",
    "shipped",
]
