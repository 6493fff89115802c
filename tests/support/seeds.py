"""One test for many seeds."""


def seeds(count):
    """A test of a seed becomes one that runs with each seed below `count`; where it fails it names the seed."""

    def decorate(test):
        def run():
            for seed in range(count):
                try:
                    test(seed)
                except Exception as failure:
                    raise AssertionError("seed %d" % seed) from failure

        run.__name__, run.__doc__, run.__module__ = test.__name__, test.__doc__, test.__module__
        return run

    return decorate
