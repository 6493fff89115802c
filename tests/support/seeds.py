"""How many cases a random comparison has: all with `./applr test --all`, else a part that is the same in each run."""

import math

from hypothesis import settings

FIRST_SHARE = 0.25
share = 1.0  # set by tests/conftest.py


def part(count):
    """Return how many of `count` cases this run has, at least one."""
    return math.ceil(share * count)


def examples(count):
    """A hypothesis test gets `count` examples with --all, drawn anew in each run; else a part, the same in each run."""
    return settings(max_examples=part(count), deadline=None, derandomize=share < 1.0)


def seeds(count):
    """A test of a seed becomes one that runs with each seed below `count`; where it fails it names the seed."""

    def decorate(test):
        def run():
            for seed in range(part(count)):
                try:
                    test(seed)
                except Exception as failure:
                    raise AssertionError("seed %d" % seed) from failure

        run.__name__, run.__doc__, run.__module__ = test.__name__, test.__doc__, test.__module__
        return run

    return decorate
