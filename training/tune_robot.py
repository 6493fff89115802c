"""Better parameters for the move_base that a robot runs already, from the robot's folder.

Started as `./applr tune ROBOT` or `python -m training.tune_robot ROBOT`. It begins on open floor: where a robot's own
parameters do not drive it there, it says why and what to change, and ends. CMA-ES searches in the kinematic simulator,
then in pybullet; the best sets race there, and of the winner each parameter is put back at the robot's own value where
nothing is lost by it. In all drives a planner with the defects of the C++ move_base starts with the set, as it will on
the robot; parameters that mean something else while it runs are left out, so that the method `static` drives the same.
The search drives without the collision monitor. In courses that it did not use the set is then judged twice: without
the monitor for ROBOT/tuned.yaml, which any move_base loads, and with it for ROBOT/static.json, with which the applr
node and the method `static` drive. A file is written only where its verdict is clearly better, and the exit status is 0
only where one is. A stopped run continues with the same command.
"""

from __future__ import annotations

import json
import os
import sys
import time
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    Iterable,
    Iterator,
    List,
    Literal,
    Mapping,
    Optional,
    Sequence,
    Tuple,
    TypeVar,
)

import numpy as np
from pydantic import Field

from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.common.extras import extra
from applr_ros1.common.files import StorageError, read_bytes, sha256, write_bytes
from applr_ros1.common.progress import announced
from applr_ros1.planner.parameters.declarations import servers
from applr_ros1.planner.variant import CPP_LIKE
from applr_ros1.policy import methods
from applr_ros1.policy.dimensionless import DimensionlessForm
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import NAMES, Robot, load
from training import open_floor
from training.common.command_line import AnyRobot, Seed, Workers, continuable, end_at_sigterm, parsed
from training.common.folders import Lock, make_folder
from training.common.options import PLACE, Options, option
from training.env.episode import TIME_LIMIT
from training.env.settings import CHALLENGE, TrialSettings
from training.evaluate import EvaluationOptions, evaluate
from training.report.verdict import SET, paired_trials, tuned_verdict
from training.trials.drive import drive
from training.trials.loaded import loadable_space
from training.trials.runner import TRIAL_RUNNER, content, content_of_worlds, world_list
from training.trials.score import AIMS, Baseline
from training.trials.table import Trials
from training.trials.trial import BASELINE, Result, Trial
from training.tune import parameter_file
from training.workers.pool import Pool
from worlds import World
from worlds.loading import FORMS

with extra(__name__):
    from training.tune.search import (
        Block,
        Drive,
        Saved,
        blocks_of,
        finalists,
        last_race,
        plan_sets,
        search,
        without_idle,
    )

if TYPE_CHECKING:
    import pandas as pd

    from training.report.tables import Table

# until which share of the time the search drives in the kinematic simulator, then in pybullet, the best sets race, and
# parameters are put back; the rest is the verdicts'
COARSE_SHARE, SEARCH_SHARE, RACE_SHARE, PUT_BACK_SHARE = 0.25, 0.62, 0.74, 0.86
JUDGED = ("tuned.yaml", "without", 0.93), ("static.json", "with", 1.0)  # file, its monitor, until which share
SEARCH: Dict[str, Any] = {"sigma": 0.3, "population": 12, "worlds_per_set": 20}
COARSE, FINE = "kinematic", "pybullet"  # simulators of the search's first part, and of all the rest
LIMIT_OPTIMAL_TIMES = 10.0  # after which a drive of the search has failed
PUT_BACK_BLOCKS = 6  # of drives, at most, in which a parameter is put back
VERDICT_COURSES = 12  # at least, of each verdict
BUSY = 0.5  # share of a processor below which a machine counts as busy with other work
LINES_S = 10.0, 15.0  # between the lines about long work: until the first, and further ones
WORLDS, UNSEEN = "generated:learn", "fresh:40000-40099"  # of a search without --worlds, and of all verdicts
DRAWN: Dict[str, Any] = {  # how drives differ from the nominal robot, which stays on its own ground
    **{"start_xy": 0.05, "start_yaw": 0.1, "scan_noise": [1, 5], "latency": [0, 0.05]},
    **{"friction": [0.8, 1.2], "slip": [0.7, 1.4], "odometry": [0.5, 2]},
}
T = TypeVar("T")
say = partial(print, flush=True)


class TuneOptions(Options):
    """Options of a search."""

    # fmt: off
    robot: AnyRobot = Field(
        description="Folder with robot.yaml, or the name of an included robot.", json_schema_extra=PLACE)
    anyway: bool = option(False,
        "Go on where the robot's own parameters do not drive it on open floor.")
    worlds: str = option(WORLDS,
        f"Courses to search in: {FORMS}; several are separated by commas. {UNSEEN} are for the verdict.")
    minutes: float = option(15.0,
        "Time [min] of driving, from the first drive to the verdict; what other programs take of it does not count.",
        gt=0, le=10_000)
    for_: Literal["fast", "careful", "smooth"] = option("fast",
        "What counts beside arriving without a contact: fast, the time; careful, the distance from obstacles; smooth, "
        "little jerk and turning; both without taking longer.")
    workers: Workers
    out: str = option("",
        "Folder for all trials and the page, and for what is found for an included robot. Default: tune/ROBOT.")
    seed: Seed
    runner: str = option(TRIAL_RUNNER, "")  # tests give a toy
    # fmt: on


class Clock:
    """The time of driving in a run: a machine that is busy with other work makes it pass more slowly.

    Wall time counts by the share of it in which drives had a processor. A table keeps each look at it: a run that goes
    on decides as before it was interrupted.

    Args:
        table: keeps the looks.
        name: under which it keeps them.
        seconds: that the run has.

    Attributes:
        minutes: at the last look.
    """

    def __init__(self, table: Trials, name: str, seconds: float):
        self._table, self._name, self._seconds = table, name, seconds
        self._looks = table.notes.get(name, [])
        self._again = iter(list(self._looks))
        self._last, self.minutes = time.monotonic(), 0.0
        self._took = self._passed = np.zeros(2)  # processor and wall time of drives since the last look; both here

    def took(self, processor_s: float, wall_s: float) -> None:
        """Count a drive."""
        self._took = self._took + (min(processor_s, wall_s), wall_s)

    def spent(self) -> float:
        """Return the share that is over. The first look begins the time."""
        now, at = next(self._again, None), time.monotonic()
        if now is None:
            passed = (at - self._last) * (self._took / self._took[1] if self._took[1] else np.ones(2))
            now = self._looks[-1] + float(passed[0]) if self._looks else 0.0
            self._passed = self._passed + passed * bool(self._looks)
            self._looks.append(now)
            self._table.note(**{self._name: self._looks})
        self._last, self._took, self.minutes = at, np.zeros(2), now / 60.0
        return now / self._seconds

    def busy(self) -> str:
        """Return a line that says how busy the machine has been since this process began; "" where it was its own."""
        driving, wall = self._passed / 60.0
        if driving >= BUSY * wall:
            return ""
        return f"this machine is busy: {wall:.1f} minutes here were {driving:.1f} minutes of driving, which count"

    def until(self, share: float, blocks: Iterable[T], fewest: int = 1) -> Iterator[T]:
        """Yield those of the blocks that begin before so much is spent, at least the fewest."""
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
    """Search, compare, write and print; return the exit status. One at a time in a folder and for a robot."""
    robot = options.robot
    out = make_folder(options.out or os.path.join("tune", robot.name))
    if "," in str(out):
        raise ApplrError(f"{out}: lists of worlds and methods are divided by commas; give an --out without one")
    included = robot.name in NAMES and robot.folder == load(robot.name).folder
    folder = out if included else Path(robot.folder)
    with ExitStack() as stack:
        for place, name in [(out, "lock"), (folder, "")][: 1 if included else 2]:
            stack.callback(Lock(place, "./applr tune", name).close)
        return tuned(options, out, folder)


def tuned(options: TuneOptions, out: Path, folder: Path) -> int:
    """Search in courses whose trials are kept in `out`, compare, write the set into a folder, and print; as `run`."""
    robot = options.robot
    from training.report import page

    with announced("driving on open floor (compiles kernels the first time, about a minute)", say, *LINES_S):
        can, floor = open_floor.check(robot)
    print("\n".join(floor), flush=True)
    if not (can or options.anyway):
        return 1
    worlds = world_list(options.worlds, CHALLENGE, robot)
    settings = drives_of(robot, worlds)
    asked = {
        "drives": {"planner": CPP_LIKE, **settings.model_dump(mode="json", exclude={"robot", "simulator"})},
        **{"robot": content(robot), "seed": options.seed, "worlds": content_of_worlds(worlds)},
    }
    with continuable(), Trials(out / f"search-{sha256(json.dumps(asked))[:8]}", asked) as table:
        clock = Clock(table, f"looks_{options.for_}", 60.0 * options.minutes)
        theta, worth = find(options, settings, worlds, table, clock)
        values = {name: value for name, value in space_of(robot).as_dict(theta).items() if name in worth}
        if not values:
            print("better: no, no other value of a parameter saves anything")
            return 1
        drives = make_folder(out / f"{options.for_}_{sha256(repr((values, asked, UNSEEN)).encode())[:8]}")
        parameter_file.write(robot, values, drives / "static.json", drives / "tuned.yaml")
        changed = changes(robot, values, worth)
        lines = [
            f"  {name}: {tuned} instead of {own}; {gain} s, in the median {median} s"
            for name, own, tuned, gain, median, _ in changed.rows
        ]
        print("\n".join(["What each parameter saves per course:", *lines]), flush=True)
        any_better = False
        for file, monitor, share in JUDGED:
            trials = driven_unseen(options, drives, monitor, clock, share)
            better, lines = tuned_verdict(trials, options.for_)
            lines.insert(0, f"{file}, {monitor} the collision monitor:")
            shown = page.write(drives / monitor, above=lines, first=[changed])
            if better:
                write_bytes(folder / file, read_bytes(drives / file))
            found = (folder if better else drives) / file
            print("\n".join([*lines, f"set: {found}", f"page: {shown}"]), flush=True)
            any_better |= better
    return 0 if any_better else 1


def drives_of(robot: Robot, worlds: Sequence[Tuple[str, str, World]]) -> TrialSettings:
    """Return what a search in worlds drives with, but for the simulator."""
    farthest = max(world.course.route_m for *_, world in worlds)
    rules: Dict[str, Any] = {"robot": robot.folder, "protocol": CHALLENGE, "loaded": True}
    rules["randomisation"] = DRAWN
    return TrialSettings(**rules, time_limit=min(TIME_LIMIT, LIMIT_OPTIMAL_TIMES * farthest / robot.base.max_speed))


def find(
    options: TuneOptions, settings: TrialSettings, worlds: Sequence[Tuple[str, str, World]], table: Trials, clock: Clock
) -> Tuple[np.ndarray, Dict[str, Saved]]:
    """Return the best set (n,) of a robot's parameters in worlds, and what each that it changes saves [s].

    Raises:
        ApplrError: no set arrives anywhere.
    """
    robot, seed = settings.load_robot(), options.seed
    whole, names, aim = loadable_space(robot), [world[:2] for world in worlds], AIMS[options.for_]
    space = whole.chosen
    means, driven = [], []  # type: List[np.ndarray], List[str]

    def tell(what: str) -> None:
        clock.spent()
        print("\n".join([f"{clock.minutes:4.1f} min: {what}", *filter(None, [clock.busy()])]), flush=True)

    def drives(simulator: str, sets: np.ndarray, block: Block, seed: int) -> List[List[Result]]:
        """Return each set's results in the worlds of a block; all sets drive the first one at first."""
        runner = partial(resolve_name(options.runner), settings.model_copy(update={"simulator": simulator}))
        plan = plan_sets(whole, names, np.array([whole.fill(theta) for theta in sets]), block, seed, simulator)
        trials = [trial for of_world in zip(*plan) for trial in of_world]
        with announced(f"driving {len(sets)} sets in {len(block)} courses, {simulator}", say, *LINES_S):
            results = drive(pool, runner, table, [trials], took=clock.took)
        return [[results[trial] for trial in of_set] for of_set in plan]

    def rounds() -> Iterator[Drive]:
        """Yield what drives each generation."""
        while (spent := clock.spent()) < SEARCH_SHARE or not driven:
            driven.append(COARSE if spent < COARSE_SHARE else FINE)
            yield partial(drives, driven[-1])

    with Pool(options.workers) as pool:
        coarse, fine = partial(drives, COARSE), partial(drives, FINE)
        with announced("compiling kernels (about a minute the first time)", say, *LINES_S):
            for run in (coarse, fine):
                run(space.theta0[None], [0], seed)  # which shall not count
        clock.spent()
        every = blocks_of(len(worlds), seed)
        (results,) = coarse(space.theta0[None], sum(every[:2], []), seed)
        cost = partial(aim.cost, robot=robot, baseline=Baseline.of(results, robot))
        first = noted_starts(robot, table, f"starts_{options.for_}")
        begun = last_race(coarse, whole.pick(first), every[:2], cost, seed)
        tell(f"best of {len(begun)} sets to begin with: {begun[0]}")
        starts = [one.theta for one in begun]
        for winner, mean in search(space, len(names), rounds(), starts, cost, seed=seed, **SEARCH):
            means.append(mean)
            tell(f"generation {len(means)}, {driven[-1]}: {winner}")
        best = last_race(fine, finalists(space, starts, means), clock.until(RACE_SHARE, every), cost, seed)[0]
        tell(f"best of the last race: {best}")
        if not any(result.success for result in best.results):
            demo = f"./applr demo robot:={robot.folder} method:=dwa world:={names[0][1]}"
            raise ApplrError(f"no set arrives in any course, so that there is nothing to compare: {demo} shows why")
        theta = space.clip([float(f"{value:.4g}") for value in best.theta])
        turns = np.linspace(clock.spent(), PUT_BACK_SHARE, 1 + np.count_nonzero(theta != space.theta0))[1:].tolist()
        some = blocks_of(len(worlds), seed + 1)[:PUT_BACK_BLOCKS]

        def next_turn() -> Iterator[Block]:
            say(f"putting back at the robot's own value, one by one: {len(turns)} parameters are left")
            return clock.until(turns.pop(0), some)

        theta, worth = without_idle(space, fine, theta, next_turn, cost, seed + 1, aim.asked())
        return whole.fill(theta), worth


def noted_starts(robot: Robot, table: Trials, name: str) -> np.ndarray:
    """Return the warm starts (k, n) that a table has under a name; it gets today's where it has none.

    What a run writes into the robot's folder does not change where it goes on from.

    Raises:
        StorageError: the table has something else there.
    """
    if name not in table.notes:
        table.note(**{name: warm_starts(robot).tolist()})
    with suppress(TypeError, ValueError):
        noted = np.array(table.notes[name], dtype=np.float64)
        if noted.size and noted.ndim == 2 and noted.shape[1] == len(space_of(robot)) and np.isfinite(noted).all():
            return noted
    raise StorageError(f"{table.folder}: {name} in it is no list of sets; give another --out")


def warm_starts(robot: Robot) -> np.ndarray:
    """Return sets (k, n): the robot's own parameters, the set in its folder, those of included robots, and half-way.

    Those of others are brought to its size and speed. Parameters that the dimensionless form does not know are taken at
    the same place of their range.
    """
    space, found = space_of(robot), [space_of(robot).theta0]
    for other in (robot, *(load(name) for name in NAMES if name != robot.name)):
        with suppress(ApplrError):  # there is no set, or one of other parameters, or the laser does not look ahead
            theirs, _ = space_of(other).read(methods.shipped(methods.SET, other))
            action = space_of(other).to_action(theirs)
            if other is not robot:
                there = dict(zip(space_of(other).names, action))
                form, their_form = DimensionlessForm(robot, 1.0), DimensionlessForm(other, 1.0)
                here = zip(space.names, space.to_action(form.theta(their_form.action(theirs))))
                action = np.array([at if name in form.chosen else there.get(name, at) for name, at in here])
            found += [space.to_theta(action), space.to_theta(0.5 * (action + space.to_action(space.theta0)))]
    return np.array(found)


def driven_unseen(options: TuneOptions, drives: Path, monitor: str, clock: Clock, share: float) -> pd.DataFrame:
    """Drive the robot's own parameters and the set in `drives` in the worlds UNSEEN; return paired_trials of both.

    monitor: "with" or "without" the collision monitor; a folder in `drives`. share: of the time, at which they end.
    """
    robot = options.robot
    names, workers = f"{BASELINE},{drives / 'static.json'}", max(1, options.workers)
    how: Dict[str, Any] = {name: getattr(options, name) for name in ("workers", "seed", "runner")}
    how.update(protocol=CHALLENGE, planner=CPP_LIKE, monitor=monitor == "with", loaded=True, trials=1)
    evaluation = EvaluationOptions.model_construct(
        **how, robot=robot, worlds=UNSEEN, methods=names, out=str(drives / monitor)
    )

    def blocks(plan: List[Trial]) -> Iterator[Sequence[Trial]]:
        """Yield as many courses with both as there are workers, until the time is over."""
        parts = [plan[first : first + 2 * workers] for first in range(0, len(plan), 2 * workers)]
        return clock.until(share, parts, fewest=-(-VERDICT_COURSES // workers))

    results = evaluate(evaluation, blocks, clock.took)
    baseline = Baseline.of([result for trial, result in results.items() if trial.method == BASELINE], robot)
    return paired_trials(results, (BASELINE, SET), partial(AIMS[options.for_].cost, robot=robot, baseline=baseline))


def changes(robot: Robot, values: Mapping[str, Any], worth: Mapping[str, Saved]) -> Table:
    """Return the parameters that a set changes: own value, its value, what it saves [s], and what the parameter is."""
    space, rows = space_of(robot), []
    known = servers(robot.all_parameters())
    for name, own in space.as_dict(space.theta0).items():
        if name not in values:
            continue
        target = space.targets[name][0]
        declared = next(p for p in known[target.server].parameters if p.name in target.names)
        unit, ((gain, low, high), median) = f" {declared.unit}".rstrip(), worth[name]
        gain, low, high, median = (round(seconds, 1) + 0.0 for seconds in (gain, low, high, median))  # -0.0 is 0.0
        rows.append(
            {
                "parameter": name,
                "own": f"{own:.4g}{unit}",
                "tuned": f"{values[name]:.4g}{unit}",
                "saves per course [s]": f"{gain:.1f} ({low:.1f} to {high:.1f})",
                "in the median": f"{median:.1f}",
                "what it is": declared.doc,
            }
        )
    note = (
        "What is lost [s] when the parameter alone is put back at the robot's own value: the mean over courses with "
        "its 95 % interval, in which a failure counts for much, and the median."
    )
    from training.report.tables import Table

    return Table.of("changes", "What changed", rows, note)


if __name__ == "__main__":
    sys.exit(main())
