"""Command lines of this package: mistakes as errors of one line, numbers within bounds, options of several commands."""

from __future__ import annotations

import argparse
import signal
from contextlib import contextmanager
from typing import Any, Callable, Iterator, NoReturn

import sim_bridge
from applr_ros1.common.errors import ApplrError
from applr_ros1.planner.variant import DRAWN, OURS, PLANNERS
from applr_ros1.robots import GROUNDS, JACKAL, NAMES, Robot, load
from worlds.loading import FORMS


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that raises ApplrError instead of ending the program, and takes no abbreviations."""

    def __init__(self, prog: str, description: str, epilog: str = ""):
        super().__init__(
            prog=prog,
            description=description,
            epilog=epilog,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )

    def error(self, message: str) -> NoReturn:
        """Raises ApplrError with argparse's message."""
        raise ApplrError("%s; --help lists all options" % message)


def end_at_sigterm() -> None:
    """From now on SIGTERM ends this process as Ctrl-C does: a KeyboardInterrupt, at which it stops what it started."""

    def interrupt(*_: Any) -> NoReturn:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, interrupt)


@contextmanager
def continuable() -> Iterator[None]:
    """Around work which the same command continues: says so where Ctrl-C or SIGTERM stops it."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; the same command continues") from None


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
    """A type for add_argument: a simulator's name, or the my_file.py:Class or module:Class of a person's own."""
    if not sim_bridge.is_name(text):
        raise argparse.ArgumentTypeError("%r is no simulator: give %s" % (text, ", ".join(sim_bridge.NAMES)))
    return text


def add_worlds(parser: argparse.ArgumentParser, default: str, purpose: str = "drive in") -> None:
    """Declares --worlds; purpose: what the command does with them, behind "Worlds to"."""
    parser.add_argument(
        "--worlds",
        default=default,
        help="Worlds to %s: %s; several are separated by commas. Default: %%(default)s." % (purpose, FORMS),
    )


def add_trials(parser: argparse.ArgumentParser, default: int, each: str, most: int = 100_000) -> None:
    """Declares --trials; each: of what and where, behind "Number of trials", and most: its upper bound."""
    parser.add_argument(
        "--trials", type=whole(1, most), default=default, help="Number of trials %s. Default: %%(default)s." % each
    )


def add_contact_seconds(parser: argparse.ArgumentParser, default: float) -> None:
    """Declares --contact-seconds."""
    parser.add_argument(
        "--contact-seconds",
        type=number(0.0, 1e6),
        default=default,
        help="Time [s] that a trial with a contact is charged in addition. Default: %(default)s.",
    )


def add_workers(parser: argparse.ArgumentParser, default: int, how: str = "") -> None:
    """Declares --workers; how: by what the trials are driven at the same time, with a comma before it."""
    parser.add_argument(
        "--workers",
        type=whole(0, 4096),
        default=default,
        help="Number of trials that are driven at the same time%s; 0 drives them in this process. "
        "Default: %%(default)s." % how,
    )


def robot(text: str) -> Robot:
    """A type for add_argument: the robot of a name or folder."""
    try:
        return load(text)
    except ApplrError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def add_robot(parser: argparse.ArgumentParser) -> None:
    """Declares --robot, whose value is a robots.Robot."""
    parser.add_argument(
        "--robot",
        type=robot,
        default=JACKAL,
        metavar="NAME",
        help="Robot that drives, at whose scale the worlds are: %s, or a folder with robot.yaml "
        "(docs/tutorials/your_robot.md). Default: jackal." % ", ".join(NAMES),
    )


def add_simulator(parser: argparse.ArgumentParser, default: str) -> None:
    """Declares --simulator."""
    parser.add_argument(
        "--simulator",
        type=simulator,
        default=default,
        help="Simulator to drive in: pybullet, kinematic, or my_file.py:Class or module:Class of your own. Default: "
        "%(default)s.",
    )


def add_planner(parser: argparse.ArgumentParser) -> None:
    """Declares --planner."""
    parser.add_argument(
        "--planner",
        choices=PLANNERS + (DRAWN,),
        default=OURS,
        help="Planner to drive with: ours, cpp-like with the defects of the C++ move_base that success depends on, or "
        "drawn for one of them in each world and trial. Default: %(default)s.",
    )


def add_monitor(parser: argparse.ArgumentParser) -> None:
    """Declares --monitor."""
    parser.add_argument(
        "--monitor",
        action="store_true",
        help="Put the collision monitor between the planner and the base, as the launch file does. Without it the base "
        "gets every command of the planner as it is.",
    )


def add_ground(parser: argparse.ArgumentParser) -> None:
    """Declares --ground."""
    parser.add_argument(
        "--ground",
        choices=GROUNDS,
        default="",
        help="Simulated ground to drive on: plain, where tyres grip alike in all directions, or gazebo, with the "
        "friction of Gazebo's Jackal. Default: the robot's own.",
    )


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Declares --seed."""
    parser.add_argument(
        "--seed",
        type=whole(0, 2**31 - 1),
        default=0,
        help="Seed from which all random numbers of the command follow. Default: %(default)s.",
    )
