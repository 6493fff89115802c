"""Finds the best single parameter set over the training worlds with CMA-ES and races: the baseline `static`.

Started as `rosrun applr_ros1 static_search.py` or `python -m training.static_search`. In each generation the candidates
race through the same newly drawn worlds with the same seeds, and CMA-ES is given their ranks. At the end theta_0, the
given sets, and the means and winners of the last generations race through other worlds. A search that was stopped
continues with the same command and comes to the same result.
"""

from __future__ import annotations

import shlex
import sys
import time
from functools import partial
from itertools import repeat
from pathlib import Path
from typing import Any, Dict, List, Literal, Optional

import numpy as np

from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import ApplrError, reason, run_main
from applr_ros1.common.extras import extra
from applr_ros1.common.files import read_json, write_json
from applr_ros1.policy.parameter_space import SPACE, Space, space_of
from training.actors.pool import make_pool
from training.common.command_line import (
    AnyRobot,
    ContactSeconds,
    Monitor,
    Planner,
    ProtocolName,
    RayAddress,
    Seed,
    SimulatorName,
    Workers,
    continuable,
    parsed,
)
from training.common.folders import make_folder
from training.common.options import Options, option
from training.env.settings import TrialSettings
from training.evaluation.plan import TrialResult
from training.evaluation.score import CONTACT_SECONDS, barn_metric, trial_seconds
from training.evaluation.trials import world_list
from training.tune import parameter_file
from worlds.loading import FORMS

with extra(__name__):
    from training.tune.search import blocks_of, finalists, last_race, said, search, set_trials


class StaticOptions(Options):
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
    generations: int = option(40, "Number of generations of CMA-ES.", ge=1, le=10**6)
    population: int = option(16, "Number of parameter sets in a generation.", ge=4, le=10**6)
    worlds_per_set: int = option(24,
        "Number of worlds that a generation races in: all sets drive a quarter of them, the better half another "
        "quarter, and the better half of those the rest.", ge=1, le=10**6)
    sigma: float = option(0.5,
        "Initial standard deviation of the search, with parameters scaled to [-1, 1].", ge=1e-3, le=2)
    seed: Seed
    objective: Literal["score", "metric"] = option("score",
        "What is searched for: the smallest score, the time in seconds of a trial with 100 s for a failure; or the "
        "largest BARN metric, success x OT / clip(time, 2 OT, 8 OT), where OT is the reference path over 2 m/s.")
    contact_seconds: ContactSeconds = CONTACT_SECONDS
    final_worlds: str = option("generated:validation",
        f"Worlds of the last race: {FORMS}; several are separated by commas.")
    final_simulator: SimulatorName = option("pybullet", "Simulator of the last race.")
    final_trials: int = option(2, "Number of trials in each world of the last race.", ge=1, le=1000)
    out: str = option("applr_ros1/robots/jackal/static.json",
        'JSON file for the best set: {"meter_scoring": false, "parameters": {NAME: VALUE}}; its distance biases count '
        "per cell. Beside it, NAME_log.json takes the log and NAME_trials.csv every trial, from which a stopped "
        "search continues. NAME.yaml holds the same set as parameters of move_base, to be loaded after the robot's own "
        "files.")
    # fmt: on

    def cost(self, result: TrialResult) -> float:
        """What is made small: a trial's score [s], or its negated metric."""
        if self.objective == "metric":
            return -float(barn_metric(result.success, result.collided, result.time_s, result.route_m))
        return trial_seconds(result.success, result.time_s, result.collided, self.contact_seconds)


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

    log: List[Dict[str, Any]] = []
    how = {name: getattr(options, name) for name in ("seed", "sigma", "population", "worlds_per_set")}
    rules: Dict[str, Any] = {"protocol": options.protocol, "monitor": options.monitor, "robot": options.robot.folder}
    first = TrialSettings(simulator=options.simulator, planner_frequency=options.planner_frequency, **rules)
    second = TrialSettings(simulator=options.final_simulator, **rules)
    with continuable(), make_pool(options.workers, options.ray_address) as pool:
        made = partial(set_trials, pool, options.robot, stem + "_trials.csv", planner=options.planner)
        trials = made(first, worlds)
        for line in search(repeat(trials, options.generations), starts, options.cost, **how):
            seconds = round(time.monotonic() - began, 1)
            log.append({**line, "trials": trials.driven, "seconds": seconds})
            where = f"generation {len(log)} of {options.generations}: winner {said(line['winner'])}"
            print(f"{where}, sigma {line['sigma']:.3f}, {trials.driven} trials in all, {seconds:.0f} s", flush=True)
        last = made(second, final_worlds)
        blocks = blocks_of(len(final_worlds), options.final_trials, options.seed)
        table = last_race(last, finalists(space, starts, log), blocks, options.cost, options.seed)
    for line in table:
        print(f"{said(line)}: {line['parameters']}", flush=True)
    best = table[0]["parameters"]
    found = {
        "theta": best,
        "result": table[0],
        "finalists": table,
        "log": log,
        "trials": trials.driven + last.driven,
        "seconds": round(time.monotonic() - began, 1),
        "command": shlex.join(["python", "-m", "training.static_search", *arguments]),
    }
    write_json(stem + "_log.json", found)
    parameter_file.write(options.robot, best, Path(options.out), Path(stem + ".yaml"))
    print(f"{options.out}: {best}")
    print(f"{stem}.yaml: the same for move_base, to be loaded after {options.robot.name}'s own files")


def start(path: str, space: Space = SPACE) -> np.ndarray:
    """The set (n,) in a JSON file: one set, or the one that an earlier search found, by its log."""
    content = read_json(path)
    if isinstance(content, dict) and "theta" in content:
        try:
            return space.from_dict(dict(content["theta"]))
        except (TypeError, ValueError) as error:
            raise ApplrError(f"--start {path}: no set of parameters ({reason(error)})") from None
    return space.read(path)


if __name__ == "__main__":
    sys.exit(main())
