"""Number of cases of random comparisons: all with `./applr test --all`, else a part, the same in
each run.
"""

import math

from hypothesis import settings

FIRST_SHARE = 0.25  # share of the cases without --all
share = 1.0  # share of the cases to run, set by tests/conftest.py


def part(count):
    """Return how many of `count` cases to run, at least one."""
    return math.ceil(share * count)


def examples(count):
    """Return settings of a hypothesis test: `count` new examples with --all, else a part, the same
    in each run.
    """
    return settings(max_examples=part(count), deadline=None, derandomize=share < 1.0)


def seeds(count):
    """Return a decorator that runs a test with each seed below `count` and names the seed on
    failure.
    """

    def decorate(test):
        def run():
            for seed in range(part(count)):
                try:
                    test(seed)
                except Exception as failure:
                    raise AssertionError("seed %d" % seed) from failure

        run.__name__ = test.__name__
        run.__doc__ = test.__doc__
        run.__module__ = test.__module__
        return run

    return decorate
