"""Every method of the package keeps the contract, and the check finds each way of breaking it."""

import numpy as np
import pytest

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy import methods
from applr_ros1.policy.parameter_space import SPACE


@pytest.mark.parametrize("spec", [*methods.METHODS, "frozen:max_vel_x:applr", "frozen:vx_samples:random"])
def test_methods_of_the_package(spec):
    methods.check_method(methods.make(spec))


class Good:
    def theta(self, context):
        return SPACE.from_dict({"max_vel_x": 0.3 if context.ranges.min() < 0.4 else 1.0})


class Short(Good):
    def theta(self, context):
        return np.zeros(7)


class Nan(Good):
    def theta(self, context):
        return np.full(len(SPACE), np.nan)


class Raises(Good):
    def theta(self, context):
        raise IndexError("list index out of range\nwith a second line")


class Unseeded(Good):
    def theta(self, context):
        return SPACE.to_theta(np.random.default_rng().uniform(-1, 1, len(SPACE)))


class Remembers(Good):
    decisions = 0

    def theta(self, context):
        self.decisions += 1
        return SPACE.from_dict({"vx_samples": 4 + min(16, self.decisions)})


class NotStatic(Good):
    static = True

    def theta(self, context):
        return super().theta(context) if context else SPACE.theta0


class Meddles(Good):
    def theta(self, context):
        context.theta[:] = 0.5
        return SPACE.theta0


class Outside(methods.Method):
    def theta(self, context):
        return SPACE.high + 1.0


class Endless(Good):
    period = float("nan")


class Mute(Good):
    def describe(self):
        return {"parameters": SPACE.theta0}


def test_a_class_of_ones_own_that_is_good():
    methods.check_method(Good())


@pytest.mark.parametrize(
    ("broken", "line"),
    [
        (Short, "shape"),
        (Nan, "not finite"),
        (Raises, "IndexError: list index out of range"),
        (Unseeded, "same seed"),
        (Remembers, "same seed"),
        (NotStatic, "static"),
        (Meddles, "changed the context"),
        (Outside, "outside the ranges"),
        (Endless, "period"),
        (Mute, "describe"),
        (object, "no theta"),
    ],
)
def test_what_breaks_the_contract_is_named_in_one_line(broken, line):
    with pytest.raises(ApplrError, match=line) as error:
        methods.check_method(broken())
    assert "\n" not in str(error.value)
