"""Finds the best single parameter set over the training worlds with CMA-ES and races: the baseline `static`.

Started as `rosrun applr_ros1 static_search.py` or `python -m training.static_search`. In each generation the candidates
race through the same newly drawn worlds with the same seeds, and clearly worse ones drop out. At the end the means and
winners of the last generations race through other worlds (training/baselines/set_search.py). A search that was stopped
continues with the same command and comes to the same result.
"""

from __future__ import annotations

import shlex
import sys
import time
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Tuple

import numpy as np
import yaml

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError, reason, run_main
from applr_ros1.common.files import read_json, write_bytes, write_json
from applr_ros1.common.trees import branch
from applr_ros1.policy.parameter_space import SPACE, Space, space_of
from applr_ros1.robots import Robot
from training.actors.pool import KINDS
from training.baselines.set_search import SearchOptions, choose, explore, finalists
from training.baselines.set_trials import SetTrials
from training.common.command_line import (
    Parser,
    add_contact_seconds,
    add_planner,
    add_robot,
    add_seed,
    add_simulator,
    add_workers,
    add_worlds,
    continuable,
    number,
    simulator,
    whole,
)
from training.common.folders import make_folder
from training.evaluation.score import CONTACT_SECONDS
from training.evaluation.trials import world_list
from worlds.loading import FORMS


def parser() -> Parser:
    """The command line. A mistake raises ApplrError."""
    p = Parser("static_search.py", description=(__doc__ or "").splitlines()[0])
    add_worlds(p, "generated:learn", "search over")
    add_robot(p)
    add_simulator(p, "kinematic")
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
        default=24,
        help="Number of worlds that a generation races in: all sets drive a quarter of them, the better half another "
        "quarter, and the better half of those the rest. Default: %(default)s.",
    )
    add_contact_seconds(p, CONTACT_SECONDS)
    add_workers(p, 2)
    p.add_argument(
        "--pool",
        default="processes",
        choices=KINDS,
        help="How trials are driven at the same time: in child processes, or by Ray actors. Default: %(default)s.",
    )
    p.add_argument("--ray-address", default="", help="Address HOST:PORT of a Ray cluster to drive on.")
    p.add_argument(
        "--start",
        action="append",
        default=[],
        metavar="FILE",
        help="JSON file with a parameter set, or the log of an earlier search, that takes part in the first generation "
        "and in the last race; may be given several times. The search begins around the first. Without it the search "
        "begins at the default parameters, theta_0.",
    )
    p.add_argument(
        "--sigma",
        type=number(1e-3, 2.0),
        default=0.5,
        help="Initial standard deviation of the search, with parameters scaled to [-1, 1]. Default: %(default)s.",
    )
    p.add_argument(
        "--planner-frequency",
        type=whole(1, 20),
        default=None,
        help="Global plans per simulated second during the generations. 10 or 5 make the search faster and less exact; "
        "the last race plans as often as the robot does. Default: as often as the robot does.",
    )
    p.add_argument(
        "--final-worlds",
        default="generated:validation",
        help="Worlds of the last race: %s; several are separated by commas. Default: %%(default)s." % FORMS,
    )
    p.add_argument(
        "--final-simulator",
        type=simulator,
        default="pybullet",
        help="Simulator of the last race. Default: %(default)s.",
    )
    p.add_argument(
        "--final-trials",
        type=whole(1, 1000),
        default=2,
        help="Number of trials in each world of the last race. Default: %(default)s.",
    )
    add_seed(p)
    p.add_argument(
        "--out",
        default="applr_ros1/models/static.json",
        help='JSON file for the best set: {"meter_scoring": false, "parameters": {NAME: VALUE}}; its distance biases '
        "count per cell. Beside it, NAME_log.json takes the log and NAME_trials.sqlite "
        "every trial, from which a stopped search continues. NAME.yaml holds the same set as parameters of move_base, "
        "to be loaded after the robot's own files. Default: %(default)s.",
    )
    return p


def main(arguments: Optional[List[str]] = None) -> int:
    """Exit status 0; 1 with one line for a mistake; 130 after Ctrl-C."""
    return run_main(lambda: run(without_remappings(arguments)), "static_search.py")


def run(arguments: List[str]) -> None:
    """Searches as the arguments say and writes the set and its log."""
    options = parser().parse_args(arguments)
    stem = str(Path(options.out).with_suffix(""))
    make_folder(Path(options.out).parent)
    worlds, final_worlds = (
        [w[:2] for w in world_list(text, "paper", options.robot)] for text in (options.worlds, options.final_worlds)
    )
    space = space_of(options.robot)
    starts = [start(path, space) for path in options.start] or [space.theta0]
    chosen = SearchOptions(**{f.name: getattr(options, f.name) for f in fields(SearchOptions)})
    began = time.monotonic()

    def driver(worlds: List[Tuple[str, str]], simulator: str, planner_frequency: Optional[int]) -> SetTrials:
        return SetTrials(
            worlds,
            simulator,
            options.workers,
            options.pool,
            options.ray_address,
            options.planner,
            planner_frequency,
            stem + "_trials.sqlite",
            robot=options.robot,
        )

    with continuable():
        with closing(driver(worlds, options.simulator, options.planner_frequency)) as trials:
            log = explore(trials, starts, chosen, show)
        with closing(driver(final_worlds, options.final_simulator, None)) as last:
            table = choose(last, finalists(space, starts, log), chosen, show)
    found = {
        "theta": table[0]["parameters"],
        "result": table[0],
        "finalists": table,
        "log": log,
        "trials": trials.driven + last.driven,
        "seconds": round(time.monotonic() - began, 1),
        "command": shlex.join(["python", "-m", "training.static_search", *arguments]),
    }
    write_json(options.out, {"meter_scoring": False, "parameters": found["theta"]})
    write_json(stem + "_log.json", found)
    print("%s: %s" % (options.out, found["theta"]))
    write_bytes(stem + ".yaml", yaml.safe_dump(move_base_parameters(options.robot, found["theta"])).encode())
    print("%s.yaml: the same for move_base, to be loaded after %s's own files" % (stem, options.robot.name))


def move_base_parameters(robot: Robot, values: Mapping[str, Any]) -> Dict[str, Any]:
    """A set as the nested parameters of move_base that, loaded after the robot's own files, replace theirs.

    They have the names and places of those files, which may be older ones (robots.description.find).

    Args:
        robot: The robot.
        values: {name: value} of the set.
    """
    made: Dict[str, Any] = {}
    space, own = space_of(robot), robot.parameters()
    for server, request in space.requests(space.from_dict(dict(values))).items():
        costmap = server.rpartition("/")[0]
        place = costmap if costmap and "plugins" not in branch(own, costmap) else server
        for _, target in space.targets_of(server):
            names = [name for name in target.names if name in branch(own, place)] or target.names[:1]
            branch(made, place, create=True).update(dict.fromkeys(names, request[target.names[0]]))
    return made


def start(path: str, space: Space = SPACE) -> np.ndarray:
    """The set (n,) in a JSON file: one set, or the one that an earlier search found, by its log."""
    content = read_json(path)
    if isinstance(content, dict) and "theta" in content:
        try:
            return space.from_dict(dict(content["theta"]))
        except (TypeError, ValueError) as error:
            raise ApplrError("--start %s: no set of parameters (%s)" % (path, reason(error))) from None
    return space.read(path)


def show(line: str) -> None:
    """A line of progress."""
    print(line, flush=True)


if __name__ == "__main__":
    sys.exit(main())
