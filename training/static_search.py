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
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Dict, Iterator, List, Mapping, Optional, Tuple

import numpy as np
import yaml

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError, reason, run_main
from applr_ros1.common.extras import extra
from applr_ros1.common.files import read_json, write_bytes, write_json
from applr_ros1.common.trees import branch
from applr_ros1.policy.parameter_space import SPACE, Space, space_of
from applr_ros1.robots import Robot
from training.actors.tasks import RunnerSpec
from training.common.command_line import (
    AnyRobot,
    Monitor,
    Planner,
    ProtocolName,
    RayAddress,
    SimulatorName,
    Workers,
    continuable,
    parsed,
)
from training.common.folders import make_folder
from training.common.options import option
from training.evaluation.remembered import RememberedTrials
from training.evaluation.store import TrialTable
from training.evaluation.trials import TRIAL_RUNNER, content, world_list
from worlds.loading import FORMS

with extra(__name__):
    from training.baselines.set_search import SearchOptions, SetTrials, choose, explore, finalists


class StaticOptions(SearchOptions):
    """Where and how to search."""

    # fmt: off
    worlds: str = option("generated:learn", f"Worlds to search over: {FORMS}; several are separated by commas.")
    robot: AnyRobot
    simulator: SimulatorName = "kinematic"
    planner: Planner
    protocol: ProtocolName
    monitor: Monitor
    workers: Workers
    ray_address: RayAddress
    start: List[str] = option([],
        "JSON file with a parameter set, or the log of an earlier search, that takes part in the first generation and "
        "in the last race; may be given several times. The search begins around the first. Without it the search "
        "begins at the default parameters, theta_0.")
    planner_frequency: Optional[int] = option(None,
        "Global plans per simulated second during the generations. 10 or 5 make the search faster and less exact; the "
        "last race plans as often as the robot does. Default: as often as the robot does.", ge=1, le=20)
    final_worlds: str = option("generated:validation",
        f"Worlds of the last race: {FORMS}; several are separated by commas.")
    final_simulator: SimulatorName = option("pybullet", "Simulator of the last race.")
    out: str = option("applr_ros1/robots/jackal/static.json",
        'JSON file for the best set: {"meter_scoring": false, "parameters": {NAME: VALUE}}; its distance biases count '
        "per cell. Beside it, NAME_log.json takes the log and NAME_trials.sqlite every trial, from which a stopped "
        "search continues. NAME.yaml holds the same set as parameters of move_base, to be loaded after the robot's own "
        "files.")
    # fmt: on


def main(arguments: Optional[List[str]] = None) -> int:
    """Exit status 0; 1 with one line for a mistake; 130 after Ctrl-C."""
    return run_main(lambda: run(without_remappings(arguments)), "static_search.py")


def run(arguments: List[str]) -> None:
    """Searches as the arguments say and writes the set and its log."""
    options = parsed(StaticOptions, "static_search.py", (__doc__ or "").splitlines()[0], arguments)
    stem = str(Path(options.out).with_suffix(""))
    make_folder(Path(options.out).parent)
    worlds, final_worlds = (
        [w[:2] for w in world_list(text, options.protocol, options.robot)]
        for text in (options.worlds, options.final_worlds)
    )
    space = space_of(options.robot)
    starts = [start(path, space) for path in options.start] or [space.theta0]
    began = time.monotonic()

    @contextmanager
    def driver(worlds: List[Tuple[str, str]], simulator: str, planner_frequency: Optional[int]) -> Iterator[SetTrials]:
        rules = {"simulator": simulator, "protocol": options.protocol, "monitor": options.monitor}
        made = {**rules, "planner_frequency": planner_frequency, "robot": options.robot.folder}
        table = TrialTable(stem + "_trials.sqlite", [*rules.values(), planner_frequency, content(options.robot)])
        drives = RememberedTrials(RunnerSpec(TRIAL_RUNNER, made), options.workers, options.ray_address, table)
        with closing(table), closing(drives):
            yield SetTrials(drives, worlds, space, options.planner)

    with continuable():
        with driver(worlds, options.simulator, options.planner_frequency) as trials:
            log = explore(trials, starts, options, show)
        with driver(final_worlds, options.final_simulator, None) as last:
            table = choose(last, finalists(space, starts, log), options, show)
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
    print(f"{options.out}: {found['theta']}")
    write_bytes(stem + ".yaml", yaml.safe_dump(move_base_parameters(options.robot, found["theta"])).encode())
    print(f"{stem}.yaml: the same for move_base, to be loaded after {options.robot.name}'s own files")


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
            raise ApplrError(f"--start {path}: no set of parameters ({reason(error)})") from None
    return space.read(path)


def show(line: str) -> None:
    """A line of progress."""
    print(line, flush=True)


if __name__ == "__main__":
    sys.exit(main())
