"""Evaluates methods: drives each in every world, and writes tables, figures and statistics.

Run it as `./applr evaluate`, `rosrun applr_ros1 evaluate.py` or `python -m training.evaluate`. The
same command continues a stopped evaluation, whose results do not depend on the interruption.
docs/howto/evaluation.md describes the results, docs/reference/methods.md lists the methods and
explains how to write one.
"""

from __future__ import annotations

import os
import sys
from typing import Optional, Sequence

from training.common.command_line import continuable, run_command
from training.common.words import counted
from training.evaluate.evaluation import EvaluationOptions, evaluate
from training.evaluate.table import TRIALS, read_trials


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command.

    Returns:
        The exit status: 0 if all trials are done and reported, 1 after a one-line error, 130 after
        Ctrl-C.
    """
    return run_command(EvaluationOptions, run, "./applr evaluate", __doc__, arguments)


def run(options: EvaluationOptions) -> None:
    """Evaluate and write the report.

    If stopped, report how to continue.
    """
    with continuable():
        evaluate(options)
        table_path = os.path.join(options.out, TRIALS)
        # The table may have more trials than this command has asked for.
        print(f"{counted(len(read_trials(table_path)), 'trial')} in {table_path}")
        if options.report:
            # Imported here, because pandas and scipy take seconds, which --help must not wait for.
            from training.evaluate.report import headline, summary, write
            from training.evaluate.stored import Results

            results = Results(options.out)
            print("\n".join(summary(results) or [headline(results)]))
            print(f"report: {write(options.out)}")


if __name__ == "__main__":
    sys.exit(main())
