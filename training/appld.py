"""APPLD, the paper's second baseline: from recorded demonstrations to a file that can drive.

Started as `rosrun applr_ros1 appld.py` or `python -m training.appld`. Changepoints cut the demonstrations into
segments, similar segments form contexts, CMA-ES finds the parameters of each context, and a small network learns to
recognise the context from the scan. evaluate.py (--methods FILE) and method:=FILE use it. docs/howto/training.md
describes the method.
"""

from __future__ import annotations

import sys
from typing import List

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from training.common.command_line import parsed

with extra(__name__):
    from training.bags.bag import bags_in
    from training.baselines.appld.demonstration import read_demonstration
    from training.baselines.appld.learn import AppldOptions, learn


def main(arguments=None) -> int:
    """Exit status 0; 1 with one line when there is no file."""
    return run_main(lambda: run(without_remappings(arguments)), "appld.py")


def run(arguments: List[str]) -> None:
    """Learns from the bags that the arguments name and writes the file and its log."""
    options = parsed(AppldOptions, "appld.py", __doc__, arguments)
    if not options.out.endswith(".safetensors"):
        raise ApplrError(f"--out {options.out}: give a name that ends in .safetensors")
    try:
        demonstrations = [read_demonstration(bag, options.topics(), options.robot) for bag in bags_in(options.bags)]
        log = learn(demonstrations, options, arguments)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; nothing was written") from None
    print(f"{options.out}: {len(log['contexts'])} contexts in {log['seconds']:.0f} s")


if __name__ == "__main__":
    sys.exit(main())
