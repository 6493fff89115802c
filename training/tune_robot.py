"""Better parameters for the move_base that a robot runs already, from the robot's folder.

Started as `./applr tune ROBOT` or `python -m training.tune_robot ROBOT`. CMA-ES searches in the kinematic simulator,
then in pybullet; the best sets race there, and of the winner each parameter is put back at the robot's own value where
nothing is lost by it. Courses that the search did not use say in three sentences what the rest is worth. Where that is
clearly better, ROBOT/tuned.yaml takes it for any move_base, and ROBOT/static.json for `try`, `evaluate` and the method
`static`. The exit status is 0 only then. A stopped run continues with the same command.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from contextlib import closing
from functools import partial
from itertools import count
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, Dict, Iterable, Iterator, List, Literal, Mapping, Optional, Sequence, Tuple, TypeVar

import numpy as np
import pandas as pd
import yaml
from pydantic import Field

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from applr_ros1.common.files import read_json, sha256, write_bytes, write_json
from applr_ros1.drives.comparison import Estimate
from applr_ros1.planner.parameters.check import complete
from applr_ros1.planner.parameters.declarations import servers
from applr_ros1.policy import methods
from applr_ros1.policy.dimensionless import DimensionlessForm
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import NAMES, Robot, load, measured
from applr_ros1.robots.reader import FILE
from sim_bridge import Randomisation
from training.actors.pool import make_pool
from training.common.command_line import AnyRobot, Seed, Workers, continuable, end_at_sigterm, parsed
from training.common.folders import make_folder
from training.common.options import PLACE, Options, option
from training.env.episode import TIME_LIMIT
from training.env.protocols import CHALLENGE
from training.env.settings import TrialSettings
from training.evaluation.plan import plan_trials
from training.evaluation.run import EvaluationOptions, drive, settings
from training.evaluation.score import AIMS
from training.evaluation.store import TrialStore
from training.evaluation.trials import TRIAL_RUNNER, content, world_list
from training.report import page
from training.report.tables import Table
from training.report.verdict import KEEP, OWN, SET, paired_trials, tuned_verdict
from training.tune import parameter_file
from worlds import sdf_writer
from worlds.loading import specs

with extra(__name__):
    from training.tune import bag
    from training.tune.search import SetTrials, blocks_of, finalists, last_race, said, search, set_trials, without_idle

# until which share of the time the search drives in the kinematic simulator, then in pybullet, the best sets race, and
# parameters are put back; the rest is the verdict's
KINEMATIC, SEARCHED, RACED, PUT_BACK = 0.25, 0.62, 0.74, 0.86
SEARCH: Dict[str, Any] = {"sigma": 0.3, "population": 12, "worlds_per_set": 20}
SLOW = 10.0  # optimal times after which a drive of the search has failed
JUDGED = "pybullet"  # the simulator of all but the search's first part
MOST, FEWEST = 6, 8  # blocks of drives in which a parameter is put back; courses of the verdict
COPIES = 16  # of each course of a bag, moved; half of them are kept for the verdict
WORLDS, UNSEEN = "generated:learn", "fresh:40000-40099"  # to search in and to judge in
RECIPE = Path(__file__).parent / "recipes" / "applr.yaml"  # how drives differ from the nominal robot in training
T = TypeVar("T")


class TuneOptions(Options):
    """What to tune for, and for how long."""

    # fmt: off
    robot: AnyRobot = Field(
        description="Folder with robot.yaml, or the name of an included robot.", json_schema_extra=PLACE)
    bag: List[Path] = option([],
        "Bags of drives with move_base, ROS 1 or 2, or folders of them: half of the courses are then theirs and moved "
        "copies, and the robot has what the bags measure.")
    anyway: bool = option(False,
        "Go on where the simulated drive on a bag's course takes another time than the recorded one.")
    minutes: float = option(15.0, "Time [min] from the first drive to the verdict.", gt=0, le=10_000)
    for_: Literal["fast", "careful", "smooth"] = option("fast",
        "What counts beside arriving without a contact: fast, the time; careful, also the distance from obstacles; "
        "smooth, also little jerk and turning.")
    workers: Workers
    out: str = option("",
        "Folder for all trials and the page, and for what is found for an included robot. Default: tune/ROBOT.")
    seed: Seed
    runner: str = option(TRIAL_RUNNER, "")  # tests give a toy
    # fmt: on


class Budget:
    """The time of a run [s], of which some was spent before it was interrupted."""

    def __init__(self, seconds: float, before: float):
        self._seconds, self._began = seconds, time.monotonic() - before

    def spent(self) -> float:
        """The share that is over."""
        return (time.monotonic() - self._began) / self._seconds

    def until(self, share: float, blocks: Iterable[T], fewest: int = 1) -> Iterator[T]:
        """Those of the blocks that begin before so much is spent, at least the fewest."""
        for number, block in enumerate(blocks):
            if number >= fewest and self.spent() >= share:
                return
            yield block


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Exit status 0 where something better was found; else 1, as for a mistake, or 130 after Ctrl-C."""
    end_at_sigterm()
    name = "./applr tune"
    return run_main(lambda: run(parsed(TuneOptions, name, __doc__, arguments)), name)


def run(options: TuneOptions) -> int:
    """Searches, judges, writes and prints; returns the exit status."""
    robot, searched, unseen = options.robot, WORLDS, UNSEEN
    out = make_folder(options.out or os.path.join("tune", robot.name))
    included = robot.name in NAMES and robot.folder == load(robot.name).folder
    folder = out if included else Path(robot.folder)
    with continuable():
        if options.bag:
            robot, searched, unseen = recorded(options, out, folder)
        theta, worth, budget = find(options, robot, searched, out)
        values = {name: value for name, value in space_of(robot).as_dict(theta).items() if name in worth}
        if not values:
            print(f"Nothing better than the parameters of {robot.name} was found. {KEEP}")
            return 1
        drives = make_folder(out / f"{options.for_}_{sha256(repr((values, unseen, content(robot))).encode())[:8]}")
        parameter_file.write(robot, values, drives / "static.json", drives / "tuned.yaml")
        trials = judge(options, robot, unseen, drives, budget)
    better, sentences = tuned_verdict(trials, robot.name, str(folder / "tuned.yaml"), options.for_)
    table = changes(robot, values, worth)
    shown = page.write(drives, said=sentences, first=[table])
    if better:
        parameter_file.write(robot, values, folder / "static.json", folder / "tuned.yaml")
    lines = [f"  {name}: {tuned} instead of {own}; {gain} s" for name, own, tuned, gain, _ in table.rows]
    found = (folder if better else drives) / "tuned.yaml"
    print("\n".join([*sentences, "What each parameter saves per course:", *lines, f"set: {found}", f"page: {shown}"]))
    return 0 if better else 1


def recorded(options: TuneOptions, out: Path, folder: Path) -> Tuple[Robot, str, str]:
    """What bags say: the robot with the fields that they measure, and worlds to search and to judge in.

    Half of the worlds are the bags' own: the courses and moved copies of them, others for the verdict.

    Raises:
        ApplrError: the bags hold no course, or the simulator does not agree with them.
    """
    found = bag.read(options.bag, options.robot, copies=COPIES)
    check = found.check(seed=options.seed)
    measured_fields = [f"{section}.{name}: {value}" for (section, name), value in found.fields.items()]
    print("\n".join([*found.remarks, *measured_fields, *check.lines, check.sentence]), flush=True)
    if not check.agrees and not options.anyway:
        raise ApplrError(f"{check.sentence}; give --anyway to go on all the same")
    text = measured.written((Path(options.robot.folder) / FILE).read_text(), found.fields)
    place = out / options.robot.name
    shutil.copytree(options.robot.folder, place, dirs_exist_ok=True)
    for described in (place, folder) if folder != out else (place,):
        write_bytes(described / FILE, text.encode())
    halves: Tuple[List[str], List[str]] = [], []
    for number, world in enumerate(found.worlds):
        file = make_folder(out / "worlds") / f"{world.name}.world"
        sdf_writer.write(world, str(file))
        halves[number >= 2 * len(found.courses) and number // 2 % 2].append(str(file))
    both = [[*half, *specs(made_up)[: len(half)]] for half, made_up in zip(halves, (WORLDS, UNSEEN))]
    return load(str(place)), ",".join(both[0]), ",".join(both[1])


def find(
    options: TuneOptions, robot: Robot, searched: str, out: Path
) -> Tuple[np.ndarray, Dict[str, Estimate], Budget]:
    """The best set (n,) of a robot's parameters in the worlds `searched`.

    Returns:
        The set, what each parameter that it changes saves [s], and how the time stands.
    """
    aim, seed, seconds = AIMS[options.for_], options.seed, 60.0 * options.minutes
    space, cost = space_of(robot), partial(aim.seconds, robot=robot)
    worlds = world_list(searched, CHALLENGE, robot)
    rules: Dict[str, Any] = {
        "robot": robot.folder,
        "protocol": CHALLENGE,
        "monitor": True,
        "randomisation": randomisation(),
        "time_limit": min(TIME_LIMIT, SLOW * max(w.course.route_m for *_, w in worlds) / robot.base.max_speed),
    }
    names, drive = [world[:2] for world in worlds], resolve_name(options.runner)
    log, setting = out / f"search_{options.for_}.json", [content(robot), seed, [spec for _, spec in names]]
    stored = read_json(log) if log.exists() else {}
    earlier = stored["generations"] if stored.get("setting") == setting else []
    lines: List[Dict[str, Any]] = []
    simulators: List[str] = []
    with make_pool(options.workers) as pool:
        of = {
            name: set_trials(
                pool, robot, str(out / f"{name}.csv"), TrialSettings(simulator=name, **rules), names, "drawn", drive
            )
            for name in ("kinematic", JUDGED)
        }
        for trials in of.values():
            trials.run(space.theta0[None], [(0, 0)], seed)  # compiles kernels, which shall not count
        budget = Budget(seconds, earlier[-1]["seconds"] if earlier else 0.0)

        def rounds() -> Iterator[SetTrials]:
            """What drives each generation; those of an interrupted run are repeated from the table of trials."""
            for number in count():
                spent = earlier[number]["seconds"] / seconds if number < len(earlier) else budget.spent()
                if number and spent >= SEARCHED:
                    return
                name = "kinematic" if spent < KINEMATIC else JUDGED
                simulators.append(earlier[number]["simulator"] if number < len(earlier) else name)
                yield of[simulators[-1]]

        first = blocks_of(len(worlds), 1, seed)[:2]
        starts = [np.array(line["theta"]) for line in last_race(of["kinematic"], warm_starts(robot), first, cost, seed)]
        for line in search(rounds(), starts, cost, seed=seed, **SEARCH):
            number = len(lines)
            now = earlier[number]["seconds"] if number < len(earlier) else seconds * budget.spent()
            lines.append({**line, "simulator": simulators[-1], "seconds": now})
            write_json(log, {"setting": setting, "generations": [*lines, *earlier[number + 1 :]]})
            print(
                f"{now / 60.0:4.1f} min: generation {number + 1}, {simulators[-1]}: {said(line['winner'])}", flush=True
            )
        blocks = budget.until(RACED, blocks_of(len(worlds), 1, seed))
        best = last_race(of[JUDGED], finalists(space, starts, lines), blocks, cost, seed)[0]
        print(f"{seconds * budget.spent() / 60.0:4.1f} min: best of the last race: {said(best)}", flush=True)
        theta = space.clip([float(f"{value:.4g}") for value in best["theta"]])
        turns = np.linspace(budget.spent(), PUT_BACK, 1 + np.count_nonzero(theta != space.theta0))[1:].tolist()
        some = blocks_of(len(worlds), 1, seed + 1)[:MOST]
        return *without_idle(of[JUDGED], theta, lambda: budget.until(turns.pop(0), some), cost, seed + 1), budget


def warm_starts(robot: Robot) -> np.ndarray:
    """Sets (k, n): the robot's own, those of the other included robots at its size and speed, and those half-way.

    Parameters that the dimensionless form does not know are taken at the same place of their range.
    """
    space, found = space_of(robot), [space_of(robot).theta0]
    for other in (load(name) for name in NAMES if name != robot.name):
        path = methods.shipped("static.json", other)
        if not os.path.exists(path):
            continue
        theirs = space_of(other).read(path)
        try:
            form = DimensionlessForm(robot, 1.0)
        except ApplrError:  # of a laser that does not look ahead, which is a policy's matter
            break
        there = dict(zip(space_of(other).names, space_of(other).to_action(theirs)))
        here = zip(space.names, space.to_action(form.theta(DimensionlessForm(other, 1.0).action(theirs))))
        action = np.array([at if name in form.chosen else there.get(name, at) for name, at in here])
        found += [space.to_theta(action), space.to_theta(0.5 * (action + space.to_action(space.theta0)))]
    return np.array(found)


def randomisation() -> Dict[str, Any]:
    """How drives differ from the nominal robot, which stays on its own ground: as where policies are trained."""
    recipe = yaml.safe_load(RECIPE.read_text())
    return {name: recipe[name] for name in vars(Randomisation()) if name in recipe and name != "ground"}


def judge(options: TuneOptions, robot: Robot, unseen: str, drives: Path, budget: Budget) -> pd.DataFrame:
    """Drives the robot's own parameters and the set in `drives` in the worlds `unseen`: paired_trials of both."""
    cost = partial(AIMS[options.for_].seconds, robot=robot)
    how = {name: getattr(options, name) for name in ("workers", "seed", "runner")}
    evaluation = EvaluationOptions.model_construct(
        **how,
        robot=robot,
        simulator=JUDGED,
        protocol=CHALLENGE,
        planner="ours",
        monitor=True,
        trials=1,
        out=str(drives),
    )
    worlds = world_list(unseen, CHALLENGE, robot)
    chosen = [(OWN, OWN), (SET, str(drives / "static.json"))]
    plan = plan_trials([world[:2] for world in worlds], chosen, 1, options.seed)
    size = len(chosen) * max(1, options.workers)
    blocks = [plan[first : first + size] for first in range(0, len(plan), size)]
    with closing(TrialStore(drives, settings(evaluation, worlds, chosen), plan)) as store:
        drive(store, evaluation, budget.until(1.0, blocks, fewest=-(-FEWEST // max(1, options.workers))))
        return paired_trials(store.results, (OWN, SET), cost)


def changes(robot: Robot, values: Mapping[str, Any], worth: Mapping[str, Estimate]) -> Table:
    """The parameters that a set changes: own value, its value, what it saves [s], and what the parameter is."""
    space, rows = space_of(robot), []
    known = servers(complete(robot.parameters()))
    for name, own in space.as_dict(space.theta0).items():
        if name not in values:
            continue
        target = space.targets[name][0]
        declared = next(p for p in known[target.server].parameters if p.name in target.names)
        unit, (gain, low, high) = f" {declared.unit}".rstrip(), worth[name]
        rows.append(
            {
                "parameter": name,
                "own": f"{own:.4g}{unit}",
                "tuned": f"{values[name]:.4g}{unit}",
                "saves per course [s]": f"{gain:.1f} ({low:.1f} to {high:.1f})",
                "what it is": declared.doc,
            }
        )
    note = "What is lost [s] when the parameter alone is put back at the robot's own value, with its 95 % interval."
    return Table.of("changes", "What changed", rows, note)


if __name__ == "__main__":
    sys.exit(main())
