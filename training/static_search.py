"""Finds the best single parameter set over the training worlds with CMA-ES: the baseline `static`.

Started as `rosrun applr_ros1 static_search.py` or `python -m training.static_search`. In each generation every
candidate drives through the same newly drawn worlds with the same seeds. At the end the means of the last generations
are driven through all worlds, and the fastest of them is the result (training/baselines/set_search.py).
"""

from __future__ import annotations

import shlex
import sys
from dataclasses import fields
from pathlib import Path
from typing import List, Optional

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import UsageError, run_main
from applr_ros1.common.files import write_json
from training.baselines.set_search import SearchOptions, SetTrials, search
from training.command_line import (
    Parser,
    add_planner,
    add_seed,
    add_simulator,
    add_weights,
    add_worlds,
    number,
    whole,
)
from training.evaluation.trials import world_list
from training.storage import make_folder
from training.workers.pool import KINDS


def parser() -> Parser:
    """The command line. A mistake raises UsageError."""
    p = Parser("static_search.py", description=(__doc__ or "").splitlines()[0])
    add_worlds(p, "generated:train", "search over")
    add_simulator(p, "kinematic")
    add_weights(p)
    add_planner(p)
    p.add_argument(
        "--generations",
        type=whole(1, 10**6),
        default=40,
        help="Number of generations of CMA-ES. Default: %(default)s.",
    )
    p.add_argument(
        "--population",
        type=whole(4, 10**6),
        default=16,
        help="Number of parameter sets in a generation. Default: %(default)s.",
    )
    p.add_argument(
        "--worlds-per-set",
        type=whole(1, 10**6),
        default=25,
        help="Number of worlds that each parameter set is driven in. Default: %(default)s.",
    )
    p.add_argument(
        "--contact-seconds",
        type=number(0.0, 1e6),
        default=5.0,
        help="Time [s] that a trial with a contact is charged in addition. Default: %(default)s.",
    )
    p.add_argument(
        "--actors",
        type=whole(0, 4096),
        default=2,
        help="Number of trials that are driven at the same time; 0 drives them in this process. Default: %(default)s.",
    )
    p.add_argument(
        "--pool",
        default="processes",
        choices=KINDS,
        help="How trials are driven at the same time: in child processes, or by Ray actors. Default: %(default)s.",
    )
    p.add_argument("--ray-address", default="", help="Address HOST:PORT of a Ray cluster to drive on.")
    p.add_argument(
        "--start",
        default="",
        help=(
            "Where the search begins: a JSON file with a parameter set, or the log of an earlier search, which is "
            "then continued. Without it the search begins at the default parameters, theta_0."
        ),
    )
    p.add_argument(
        "--sigma",
        type=float,
        default=0.5,
        help="Initial standard deviation of the search, with parameters scaled to [-1, 1]. Default: %(default)s.",
    )
    add_seed(p)
    p.add_argument(
        "--out",
        default="applr_ros1/models/static.json",
        help='JSON file for the best set: {"weights": WHAT, "parameters": {NAME: VALUE}}, where WHAT says what its '
        "distance weights count. The log is written beside it as NAME_log.json. Default: %(default)s.",
    )
    return p


def main(arguments: Optional[List[str]] = None) -> int:
    """Exit status 0; 1 with one line for a mistake; 130 after Ctrl-C."""
    return run_main(lambda: run(without_remappings(arguments)), "static_search.py")


def run(arguments: List[str]) -> None:
    """Searches as the arguments say and writes the set and its log."""
    options = parser().parse_args(arguments)
    command = shlex.join(["python", "-m", "training.static_search", *arguments])
    log, partial = (Path(str(Path(options.out).with_suffix("")) + end) for end in ("_log.json", "_partial.json"))
    if not 0.0 < options.sigma <= 2.0:
        raise UsageError("--sigma is %r: give more than 0, 2 at most" % options.sigma)
    make_folder(Path(options.out).parent)
    worlds = [world[:2] for world in world_list(options.worlds, "paper")]
    trials = SetTrials(
        worlds,
        options.simulator,
        options.contact_seconds,
        options.actors,
        options.pool,
        options.ray_address,
        options.weights,
        options.planner,
    )
    chosen = SearchOptions(**{f.name: getattr(options, f.name) for f in fields(SearchOptions)})
    try:
        found = search(
            trials, len(worlds), chosen, lambda lines: write_json(partial, {"command": command, "log": lines})
        )
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            "stopped; --start %s goes on from the last generation" % partial
            if partial.exists()
            else "stopped in the first generation; nothing was written"
        ) from None
    finally:
        trials.close()
    write_json(options.out, {"weights": options.weights, "parameters": found["theta"]})
    write_json(log, dict(found, command=command))
    partial.unlink(missing_ok=True)
    print("%s: %s" % (options.out, found["theta"]))


if __name__ == "__main__":
    sys.exit(main())
