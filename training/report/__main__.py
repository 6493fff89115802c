"""`python -m training.report FOLDER [--training RUN]`: makes the report of an evaluation anew."""

import argparse
import sys

from training.report import ReportError, write
from training.storage import StorageError


def main() -> int:
    """Run the command; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m training.report", description=__doc__)
    parser.add_argument("folder", help="what evaluate.py --out wrote")
    parser.add_argument("--training", default="", help="folder of a training run, whose learning curves are shown too")
    options = parser.parse_args()
    try:
        print(write(options.folder, options.training))
    except (ReportError, StorageError) as error:
        print("error: %s" % error, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
