"""Ctrl-C while `python -m` still imports: one line instead of a traceback. Called by the packages' __init__."""

import sys


def is_starting() -> bool:
    """Whether this process was started as `python -m MODULE` and the module is still looked for."""
    return sys.argv[:1] == ["-m"]  # what runpy leaves there until then


def make_quiet() -> None:
    """Print "stopped" for a Ctrl-C that nobody catches.

    Imports take seconds. A command catches Ctrl-C itself once it runs (errors.run_main), and programs that import a
    package for themselves keep their own ways.
    """
    others = sys.excepthook

    def hook(kind, value, trace):
        if issubclass(kind, KeyboardInterrupt):
            print("stopped", file=sys.stderr)
        else:
            others(kind, value, trace)

    sys.excepthook = hook
