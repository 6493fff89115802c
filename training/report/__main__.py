"""Writes the report of an evaluation, anew or for the first time: `python -m training.report FOLDER`."""

from __future__ import annotations

import sys
from typing import List, Optional, Sequence

from applr_ros1.common.errors import run_main
from training.common.command_line import parsed
from training.common.options import Options, argument, option


class ReportOptions(Options):
    """Subject of the report."""

    # fmt: off
    folder: str = argument("Folder of an evaluation, --out of evaluate.py.")
    join: List[str] = option([],
        "Folder of an evaluation of the same methods in other worlds, for instance the training worlds with fewer "
        "trials, or of other methods in the same worlds, which all tables count in; may be given several times.")
    # fmt: on


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command; returns the exit status."""
    return run_main(lambda: run(arguments), "report")


def run(arguments: Optional[Sequence[str]] = None) -> None:
    """Write the report and print its path."""
    options = parsed(ReportOptions, "python -m training.report", __doc__, arguments)
    from training.report.page import write

    print(write(options.folder, options.join))


if __name__ == "__main__":
    sys.exit(main())
