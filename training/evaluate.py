"""Evaluation: drives every method in every world, and makes tables, figures and statistics of the trials.

Started as `rosrun applr_ros1 evaluate.py` or `python -m training.evaluate`. An evaluation that was stopped continues
with the same command, and its rows are the same as without the stop. docs/howto/evaluation.md describes the results,
docs/reference/methods.md the methods, and how to write one.
"""

from __future__ import annotations

import os
import sys
from typing import Optional, Sequence

from applr_ros1.common.errors import run_main
from training.common.command_line import continuable, end_at_sigterm, parsed
from training.evaluation.evaluation import EvaluationOptions, evaluate
from training.evaluation.table import TRIALS


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0 when all trials are done and reported; 1 and one line on stderr otherwise; 130 after Ctrl-C."""
    end_at_sigterm()
    name = "evaluate.py"
    return run_main(lambda: run(parsed(EvaluationOptions, name, __doc__, arguments)), name)


def run(options: EvaluationOptions) -> None:
    """Evaluate and write the report; say how to go on where it is stopped."""
    with continuable():
        print(f"{len(evaluate(options))} trials in {os.path.join(options.out, TRIALS)}")
        if options.report:
            from training.evaluation.report import write

            print(f"report: {write(options.out)}")


if __name__ == "__main__":
    sys.exit(main())
