"""Evaluation: drives every method in every world, and makes tables, figures and statistics of the trials.

Started as `rosrun applr_ros1 evaluate.py` or `python -m training.evaluate`. An evaluation that was stopped continues
with the same command, and its rows are the same as without the stop. docs/howto/evaluation.md describes the results.
"""

from __future__ import annotations

import argparse
import sys
from typing import Optional, Sequence, Tuple

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import run_main
from applr_ros1.policy import methods
from training.common.command_line import (
    Parser,
    add_ground,
    add_monitor,
    add_planner,
    add_robot,
    add_seed,
    add_simulator,
    add_trials,
    add_workers,
    add_worlds,
    continuable,
    end_at_sigterm,
    whole,
)
from training.evaluation.run import EvaluationOptions, evaluate
from training.evaluation.trials import PROTOCOLS
from training.report import write


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0 when all trials are done and reported; 1 and one line on stderr otherwise; 130 after Ctrl-C."""
    end_at_sigterm()
    return run_main(lambda: run(*parse(arguments)), "evaluate.py")


def run(options: EvaluationOptions, report: bool = True) -> None:
    """Evaluates and writes the report; says how to go on where it is stopped."""
    with continuable():
        evaluate(options)
        if report:
            print("report: %s" % write(options.out))


def parse(arguments: Optional[Sequence[str]] = None) -> Tuple[EvaluationOptions, bool]:
    """Checked options, and whether a report is asked for; ROS remapping arguments are ignored. Raises ApplrError."""
    defaults = EvaluationOptions()
    p = Parser(
        "evaluate.py",
        description=__doc__,
        epilog="methods:\n%s\n\nprotocols:\n%s\n\na method of your own:\n%s"
        % (
            "\n".join("  %-16s %s" % (n, m[1]) for n, m in methods.METHODS.items()),
            "\n".join("  %-16s %s" % (n, v.sentence) for n, v in PROTOCOLS.items()),
            (methods.__doc__ or "").split("\n\n", 1)[1],
        ),
    )
    add_worlds(p, defaults.worlds)
    add_robot(p)
    p.add_argument(
        "--methods",
        default=defaults.methods,
        help="Methods to compare, separated by commas: %s. Default: dwa,applr." % methods.FORMS,
    )
    add_trials(p, defaults.trials, "of each method in each world")
    add_simulator(p, defaults.simulator)
    p.add_argument(
        "--protocol",
        choices=tuple(PROTOCOLS),
        default=defaults.protocol,
        help="Rules of a trial, described below. Default: %(default)s.",
    )
    add_planner(p)
    add_monitor(p)
    add_ground(p)
    add_workers(p, defaults.workers, ", in processes or Ray actors")
    p.add_argument(
        "--ray-address",
        default=defaults.ray_address,
        help="Address HOST:PORT of a Ray cluster to drive on, or auto for one that runs on this machine.",
    )
    p.add_argument(
        "--out",
        default=defaults.out,
        help=(
            "Folder for trials.csv, tables and figures. An evaluation that it holds already is continued. "
            "Default: %(default)s."
        ),
    )
    add_seed(p)
    p.add_argument(
        "--traces",
        type=whole(0, 1000),
        default=defaults.traces,
        help="Number of trials of each method in each world whose driven path is stored. Default: %(default)s.",
    )
    p.add_argument("--runner", default=defaults.runner, help=argparse.SUPPRESS)  # tests give a toy
    p.add_argument(
        "--no-report", dest="report", action="store_false", help="Write the trials alone, without tables and figures."
    )
    options = vars(p.parse_args(without_remappings(arguments)))
    report = options.pop("report")
    return EvaluationOptions(**options), report


if __name__ == "__main__":
    sys.exit(main())
