"""Writes the report of an evaluation, anew or for the first time: `python -m training.report FOLDER`."""

import argparse
import sys
from typing import Optional, Sequence

from applr_ros1.common.errors import run_main
from training.report import write


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command; returns the exit status."""
    return run_main(lambda: run(arguments), "report")


def run(arguments: Optional[Sequence[str]] = None) -> None:
    """Write the report and print its path."""
    parser = argparse.ArgumentParser(prog="python -m training.report", description=__doc__)
    parser.add_argument("folder", help="Folder of an evaluation, --out of evaluate.py.")
    parser.add_argument(
        "--training", default="", help="Folder of a training run whose learning curves are shown as well."
    )
    parser.add_argument(
        "--beside",
        action="append",
        default=[],
        metavar="FOLDER",
        help="Folder of another evaluation, for instance with --planner cpp-like, whose figures stand beside these in "
        "one more table; may be given several times.",
    )
    parser.add_argument(
        "--join",
        action="append",
        default=[],
        metavar="FOLDER",
        help="Folder of an evaluation of the same methods in other worlds, for instance the training worlds with fewer "
        "trials, or of other methods in the same worlds, which all tables count in; may be given several times.",
    )
    options = parser.parse_args(arguments)
    print(write(options.folder, options.training, options.beside, options.join))


if __name__ == "__main__":
    sys.exit(main())
