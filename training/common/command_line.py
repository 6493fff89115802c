"""Command lines of this package: mistakes as errors of one line, and the options that several commands have."""

from __future__ import annotations

import argparse
import signal
from contextlib import contextmanager
from typing import Annotated, Any, Iterator, List, Literal, NoReturn, Optional, Sequence, Type

from pydantic import BeforeValidator, Field, InstanceOf

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError
from applr_ros1.robots import NAMES, Robot, load
from training.common.options import O, add_options, checked
from worlds.loading import FORMS

# Options of several commands. A command gives a default where none is here, and a help text where it means more.
# fmt: off
WorldNames = Annotated[str, Field(description=f"Worlds to drive in: {FORMS}; several are separated by commas.")]
Loaded = BeforeValidator(lambda name: load(name, report=True))
AnyRobot = Annotated[InstanceOf[Robot], Loaded, Field("jackal", description=
    f"Robot that drives, at whose scale the worlds are: {', '.join(NAMES)}, or a folder with robot.yaml "
    "(docs/tutorials/your_robot.md).")]
SimulatorName = Annotated[Literal["pybullet", "kinematic"], Field(description="Simulator to drive in.")]
Planner = Annotated[Literal["ours", "cpp-like", "drawn"], Field("ours", description=
    "Planner to drive with: ours, cpp-like with the defects of the C++ move_base that success depends on, or drawn for "
    "one of them in each world and trial.")]
Monitor = Annotated[bool, Field(False, description=
    "Put the collision monitor between the planner and the base, as the launch file does. Without it the base gets "
    "every command of the planner as it is.")]
Movers = Annotated[bool, Field(False, description=
    "Track what moves in the scans and mark where it will be in the costmaps, as the launch file does "
    "(docs/explanation/movers.md).")]
ProtocolName = Annotated[Literal["paper", "barn-challenge"], Field("paper", description=
    "Rules of a trial: paper, the paper's course, on which a contact does not end the trial; or barn-challenge, the "
    "BARN Challenge's course of 10 m, on which it does.")]
Workers = Annotated[int, Field(2, ge=0, le=4096, description=
    "Number of trials that are driven at the same time; 0 drives them in this process.")]
RayAddress = Annotated[str, Field("", description=
    "Address HOST:PORT of a Ray cluster to drive on, auto for one that runs on this machine, or local for one that is "
    "started here.")]
Seed = Annotated[int, Field(0, ge=0, le=2**31 - 1, description=
    "Seed from which all random numbers of the command follow.")]
# fmt: on


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that raises ApplrError instead of ending the program, and takes no abbreviations."""

    def __init__(self, prog: str, description: str, epilog: str = ""):
        form = argparse.RawDescriptionHelpFormatter
        super().__init__(prog, None, description, epilog, formatter_class=form, allow_abbrev=False)

    def error(self, message: str) -> NoReturn:
        """Raises ApplrError with argparse's message."""
        raise ApplrError(f"{message}; --help lists all options")


def words(arguments: Optional[Sequence[str]] = None) -> List[str]:
    """Return a command line (None: this process's) without ROS's remapping arguments.

    Raises ApplrError for an empty value, which a shell makes of a variable that is not set.
    """
    found = without_remappings(arguments)
    for before, word in zip(["", *found], found):
        if not word or (word.startswith("--") and word.endswith("=")):
            place = (word or before).rstrip("=") if (word or before).startswith("--") else "an argument"
            raise ApplrError(f"{place} is empty: give a value, or leave it out")
    return found


def parsed(
    model: Type[O], program: str, about: Optional[str], arguments: Optional[Sequence[str]] = None, epilog: str = ""
) -> O:
    """The options of a command line, checked; ROS's remapping arguments are ignored. Raises ApplrError.

    Args:
        model: what the options are.
        program: the command's name.
        about: what its help text says before the options.
        arguments: without the program's name; None: those of this process.
        epilog: what its help text says after the options.
    """
    parser = Parser(program, about or "", epilog)
    add_options(parser, model)
    return checked(model, vars(parser.parse_args(words(arguments))))


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
