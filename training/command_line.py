"""Command lines of this package: mistakes as errors of one line, whole numbers within bounds, simulators."""

from __future__ import annotations

import argparse
from typing import Callable, NoReturn

import sim_bridge
from applr_ros1.common.errors import UsageError


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that raises UsageError instead of ending the program, and takes no abbreviations."""

    def __init__(self, prog: str, description: str, epilog: str = ""):
        super().__init__(
            prog=prog,
            description=description,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    def error(self, message: str) -> NoReturn:
        """Raises UsageError with argparse's message."""
        raise UsageError("%s; --help lists all options" % message)


def whole(low: int, high: int) -> Callable[[str], int]:
    """A type for add_argument: a whole number from low to high."""

    def convert(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError("%r is no whole number" % text) from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError("%d is out of range: give %d to %d" % (value, low, high))
        return value

    return convert


def number(low: float, high: float) -> Callable[[str], float]:
    """A type for add_argument: a finite number from low to high."""

    def convert(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            raise argparse.ArgumentTypeError("%r is no number" % text) from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError("%g is out of range: give %g to %g" % (value, low, high))
        return value

    return convert


def simulator(text: str) -> str:
    """A type for add_argument: a simulator's name, or the module:Class of a person's own."""
    if not sim_bridge.is_name(text):
        raise argparse.ArgumentTypeError("%r is no simulator: give %s" % (text, ", ".join(sim_bridge.NAMES)))
    return text
