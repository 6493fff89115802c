"""Command-line parsing with one-line errors, and the options that several commands share."""

from __future__ import annotations

import argparse
import logging
import signal
from contextlib import contextmanager
from typing import (
    Annotated,
    Any,
    Callable,
    Dict,
    Iterator,
    Literal,
    NoReturn,
    Optional,
    Sequence,
    Type,
)

from pydantic import BeforeValidator, Field, InstanceOf, PlainSerializer
from typing_extensions import override

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import OURS
from applr_ros1.robots import NAMES, Robot, load
from training.common.options import O, add_options, checked


def robot_name(robot: Robot) -> str:
    """Return the argument with which `load` finds a robot: its name, or its folder."""
    # A user's folder may have the name of an included robot.
    if robot.name in NAMES and robot.folder == load(robot.name).folder:
        return robot.name
    return robot.folder


def _loaded(value: Any) -> Robot:
    """Return a robot, or load the robot with a name or a folder."""
    if isinstance(value, Robot):
        return value
    return load(value)


# A command may add a default, and its own help text if the option has a special meaning there.
# fmt: off
AnyRobot = Annotated[
    InstanceOf[Robot], PlainSerializer(robot_name), BeforeValidator(_loaded), Field("jackal",
    description=f"Robot to drive, to whose size the worlds are scaled: {', '.join(NAMES)}, or a "
    "folder with robot.yaml (docs/tutorials/your_robot.md).")]
SimulatorName = Annotated[Literal["pybullet", "kinematic"], Field(
    description="Simulator to drive in.")]
Workers = Annotated[int, Field(2, ge=0, le=4096,
    description="Number of trials driven in parallel; 0 drives them in this process.")]
RayAddress = Annotated[str, Field("",
    description="Address HOST:PORT of a Ray cluster to drive on, auto for a cluster that runs on "
    "this machine, or local to start a cluster here.")]
Seed = Annotated[int, Field(0, ge=0, le=2**31 - 1,
    description="Seed of all random numbers of the command.")]
# fmt: on


class Parser(argparse.ArgumentParser):
    """An ArgumentParser that raises ApplrError instead of ending the program."""

    @override
    def error(self, message: str) -> NoReturn:
        """Raise ApplrError with argparse's message."""
        raise ApplrError(f"{message}; --help lists all options")


def given(
    model: Type[O], program: str, about: Optional[str], arguments: Optional[Sequence[str]] = None
) -> Dict[str, Any]:
    """Return the options given on a command line, unchecked and without ROS's remapping arguments.

    Args:
        model: Class of the options.
        program: Name of the command.
        about: Help text before the options.
        arguments: Arguments without the program's name; None for sys.argv.

    Raises:
        ApplrError: An option is unknown or lacks its value.
    """
    formatter = argparse.RawDescriptionHelpFormatter
    parser = Parser(program, description=about, formatter_class=formatter, allow_abbrev=False)
    add_options(parser, model)
    verbose_help = "Report what is loaded, tried and left out, with times, on stderr."
    parser.add_argument("--verbose", action="store_true", help=verbose_help)
    values = vars(parser.parse_args(without_remappings(arguments)))
    if values.pop("verbose"):
        log_to_stderr()
    return values


def log_to_stderr() -> None:
    """Print the log of this repository's packages on stderr, with the time since the start."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(relativeCreated)6.0f ms  %(name)s: %(message)s"))
    for package in OURS:
        logger = logging.getLogger(package)
        logger.addHandler(handler)
        logger.setLevel(logging.INFO)


def run_command(
    model: Type[O], run: Callable[[O], Optional[int]], program: str, *command_line: Any
) -> int:
    """Run a command with its checked options; return its exit status (run_main).

    All arguments but `run` are those of `given`.
    """
    return run_main(lambda: run(checked(model, given(model, program, *command_line))), program)


@contextmanager
def continuable() -> Iterator[None]:
    """Let SIGTERM stop the block as Ctrl-C does, and report that the same command continues it."""
    # `timeout` and cluster queues end programs with SIGTERM.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; the same command continues") from None
