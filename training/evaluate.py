"""Evaluation: drives every method in every world, and makes tables, figures and statistics of the trials.

Started as `rosrun applr_ros1 evaluate.py` or `python -m training.evaluate`. An evaluation that was stopped continues
with the same command, and its rows are the same as without the stop. docs/howto/evaluation.md describes the results.
"""

from __future__ import annotations

import os
import sys
from typing import Optional, Sequence

from applr_ros1.common.errors import run_main
from applr_ros1.policy import methods
from training.common import command_line
from training.env.settings import PROTOCOLS
from training.evaluation.evaluation import EvaluationOptions, evaluate
from training.evaluation.table import TRIALS


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0 when all trials are done and reported; 1 and one line on stderr otherwise; 130 after Ctrl-C."""
    command_line.end_at_sigterm()
    return run_main(lambda: run(parse(arguments)), "evaluate.py")


def run(options: EvaluationOptions) -> None:
    """Evaluate and write the report; say how to go on where it is stopped."""
    with command_line.continuable():
        print(f"{len(evaluate(options))} trials in {os.path.join(options.out, TRIALS)}")
        if options.report:
            from training.evaluation.report import write

            print(f"report: {write(options.out)}")


def parse(arguments: Optional[Sequence[str]] = None) -> EvaluationOptions:
    """Return the options of a command line. Raises ApplrError."""
    named = "\n".join(f"  {n:16} {m[1]}" for n, m in methods.METHODS.items())
    protocols = "\n".join(f"  {n:16} {v.sentence}" for n, v in PROTOCOLS.items())
    own = (methods.__doc__ or "").split("\n\n", 1)[1]
    epilog = f"methods:\n{named}\n\nprotocols:\n{protocols}\n\na method of your own:\n{own}"
    return command_line.parsed(EvaluationOptions, "evaluate.py", __doc__, arguments, epilog)


if __name__ == "__main__":
    sys.exit(main())
