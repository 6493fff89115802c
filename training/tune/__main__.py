"""Tunes the parameters of the move_base that a robot already runs, given the robot's folder.

Run it as `./applr tune ROBOT` or `python -m training.tune ROBOT`. It begins on open floor: if the
robot's default parameters do not drive there, it reports why and what to change. CMA-ES then
searches in the kinematic simulator and in pybullet. It also searches the obstacle range of the
costmaps, which move_base reads at its start. The best parameter sets race, and each parameter of
the winner is reverted to its default if nothing is lost. Each drive starts a planner with the
parameter set and with the defects of the C++ move_base, without the collision monitor. The winner
is judged twice on courses that the search did not use: without the monitor for ROBOT/tuned.yaml,
which any move_base loads, and with the monitor for ROBOT/static.json, which the applr node uses. A
file is written only if its verdict is clearly better, and the exit status is 0 only if a file is
written. The minutes are those of the search; the verdicts take some more. The same command
continues a stopped run.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Optional, Sequence

from applr_ros1.common.files import read_bytes, sha256, write_bytes
from applr_ros1.robots import NAMES
from training.attempts.candidates import search_space
from training.common.command_line import continuable, robot_name, run_command
from training.common.folders import make_folder
from training.env.settings import CHALLENGE
from training.evaluate.runner import check_unseen, content, content_of_worlds, world_list
from training.evaluate.score import AIMS
from training.evaluate.table import TrialTable
from training.evaluate.verdict import SET
from training.robot import open_floor
from training.robot.open_floor import show
from training.tune.best_set import best_set, drives_of, warm_starts
from training.tune.clock import SearchClock
from training.tune.found_set import (
    NEXT,
    ONLY_WITH_MONITOR,
    Judgement,
    changes,
    judged,
    scope,
    write_set,
)
from training.tune.options import TuneOptions, check_maps, split

# files, each judged with or without the collision monitor
JUDGED = ("tuned.yaml", "without"), ("static.json", "with")


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command. Return 0 if a file was written, 130 after Ctrl-C, else 1."""
    return run_command(TuneOptions, run, "./applr tune", __doc__, arguments)


def run(options: TuneOptions) -> int:
    """Search for a parameter set, judge it, write files and report; return the exit status."""
    robot = options.robot
    check_maps(options.worlds, robot)
    searched, unseen = split(options.worlds)
    worlds = world_list(searched, CHALLENGE, robot)
    unseen_worlds = world_list(unseen, CHALLENGE, robot)
    check_unseen([world.name for world in worlds], [world.name for world in unseen_worlds])
    run_folder = make_folder(options.out or os.path.join("tune", robot.name))

    # A search could only find out slowly that a robot's description is wrong.
    drives_there, lines = open_floor.try_out(robot)
    show("\n".join(lines))
    if not (drives_there or options.anyway):
        return 1

    verdict_drives = 2 * len(JUDGED) * len(unseen_worlds)
    show(f"{options.minutes:g} min of search, then {verdict_drives} drives for the two verdicts")

    # A table belongs to everything on which the drives of the search depend.
    starts = warm_starts(robot)
    settings = drives_of(robot, worlds)
    identity = {
        "drives": settings.model_dump(mode="json", exclude={"robot", "simulator"}),
        "robot": content(robot),
        "seed": options.seed,
        "worlds": content_of_worlds(worlds),
        "starts": starts.tolist(),
    }
    table_folder = run_folder / f"search-{sha256(json.dumps(identity))[:8]}"
    with continuable(), TrialTable(table_folder, identity) as table:
        clock = SearchClock(table, f"readings_{options.for_}", 60.0 * options.minutes)
        theta, effects = best_set(options, settings, worlds, starts, table, clock)

        # A set consists of the parameters that differ from the defaults.
        values = {}
        for parameter_name, parameter_value in search_space(robot).as_dict(theta).items():
            if parameter_name in effects:
                values[parameter_name] = parameter_value
        if not values:
            show(f"better: no, no changed parameter saves anything\n{NEXT}")
            return 1

        # The verdicts' drives belong to the set and to the worlds, as the search's table does.
        drives_name = sha256(repr((values, identity, unseen)).encode())[:8]
        drives = make_folder(run_folder / f"{options.for_}_{drives_name}")
        write_set(robot, values, drives / "static.json", drives / "tuned.yaml")
        changed = changes(robot, values, effects)
        write_bytes(drives / "changes.csv", changed.to_csv(index=False).encode())
        show(
            "by how much the cost per course rises if only one parameter is reverted to its "
            "default (unclear: the 95 % interval holds 0):"
        )
        show(changed.drop(columns="meaning").to_string(index=False))
        context = scope(options, worlds, unseen_worlds)
        show(context)
        from training.tune import page

        # Each verdict drives its own courses, which takes minutes.
        judgements = []
        for file_name, monitor in JUDGED:
            judgements.append(judge(options, unseen, drives, file_name, monitor))
        for_any_move_base, with_monitor = judgements
        is_written = for_any_move_base.is_better or with_monitor.is_better
        if not is_written:
            show(NEXT)
        elif not for_any_move_base.is_better:
            show(ONLY_WITH_MONITOR)
        rule = AIMS[options.for_].rule
        show(f"page: {page.write(robot, drives, changed, judgements, context, rule)}")
    return 0 if is_written else 1


def judge(options: TuneOptions, unseen: str, drives: Path, file: str, monitor: str) -> Judgement:
    """Judge the set in `drives`, and write the file if it is better.

    Args:
        options: Options of the command.
        unseen: Worlds that the search did not use.
        drives: Folder with the parameter set.
        file: Name of the file.
        monitor: "with" or "without" the collision monitor.
    """
    robot = options.robot
    judged_set = judged(options, unseen, drives, monitor)
    is_better = judged_set.method == SET
    if is_better:
        folder = Path(robot.folder)
        if robot_name(robot) in NAMES:
            folder = drives.parent  # An included robot's folder is not written to.
        set_file = folder / file
        write_bytes(set_file, read_bytes(drives / file))
        written_where = f"written: {set_file}"
    else:
        set_file = drives / file
        written_where = f"nothing written: the set is in {set_file}"
    title = f"{file}, {monitor} the collision monitor:"
    show("\n".join([title, *judged_set.lines, written_where]))
    return Judgement(file, monitor, judged_set.lines, is_better, set_file)


if __name__ == "__main__":
    sys.exit(main())
