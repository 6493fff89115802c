"""Tunes the parameters of the move_base that a robot already runs, given the robot's folder.

Run it as `./applr tune ROBOT` or `python -m training.tune ROBOT`. It begins on open floor: if the robot's
default parameters do not drive there, it reports why and what to change. CMA-ES then searches in the kinematic
simulator and in pybullet, the best parameter sets race, and each parameter of the winner is reverted to its default if
nothing is lost. Each drive starts a planner with the parameter set and with the defects of the C++ move_base, without
the collision monitor. The winner is judged twice on courses that the search did not use: without the monitor for
ROBOT/tuned.yaml, which any move_base loads, and with the monitor for ROBOT/static.json, which the applr node uses. A
file is written only if its verdict is clearly better, and the exit status is 0 only if a file is written. The same
command continues a stopped run.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Optional, Sequence

from applr_ros1.common.errors import run_main
from applr_ros1.common.files import read_bytes, sha256, write_bytes
from applr_ros1.common.progress import announced
from applr_ros1.policy.parameter_space import space_of
from applr_ros1.robots import NAMES
from training.common.command_line import continuable, parsed, robot_name
from training.common.folders import make_folder
from training.env.settings import CHALLENGE
from training.evaluate.runner import content, content_of_worlds, world_list
from training.evaluate.table import Trials
from training.evaluate.verdict import SET, verdict
from training.robot import open_floor
from training.tune.best_set import LINES_S, best_set, drives_of, show, warm_starts
from training.tune.clock import Clock
from training.tune.found_set import changes, driven_unseen, write_set
from training.tune.options import TuneOptions, check_maps, split

JUDGED = ("tuned.yaml", "without"), ("static.json", "with")  # files, each judged with or without the collision monitor


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command. Return 0 if a better parameter set was written, 1 if not or after an error, 130 after Ctrl-C."""
    name = "./applr tune"
    return run_main(lambda: run(parsed(TuneOptions, name, __doc__, arguments)), name)


def run(options: TuneOptions) -> int:
    """Search for a parameter set, judge it, write files and report; return the exit status."""
    from training.evaluate import report

    robot = options.robot
    check_maps(options.worlds, robot)
    searched, unseen = split(options.worlds)
    worlds = world_list(searched, CHALLENGE, robot)
    out = make_folder(options.out or os.path.join("tune", robot.name))
    folder = out if robot_name(robot) in NAMES else Path(robot.folder)
    with announced("driving on open floor (compiles kernels the first time, about a minute)", show, *LINES_S):
        can, floor = open_floor.try_out(robot)
    show("\n".join(floor))
    if not (can or options.anyway):
        return 1
    starts = warm_starts(robot)
    settings = drives_of(robot, worlds)
    asked = {
        "drives": settings.model_dump(mode="json", exclude={"robot", "simulator"}),
        **{"robot": content(robot), "seed": options.seed, "worlds": content_of_worlds(worlds)},
        "starts": starts.tolist(),
    }
    with continuable(), Trials(out / f"search-{sha256(json.dumps(asked))[:8]}", asked) as table:
        clock = Clock(table, f"readings_{options.for_}", 60.0 * options.minutes)
        theta, saved = best_set(options, settings, worlds, starts, table, clock)
        values = {name: value for name, value in space_of(robot).as_dict(theta).items() if name in saved}
        if not values:
            show("better: no, no changed parameter saves anything")
            return 1
        drives = make_folder(out / f"{options.for_}_{sha256(repr((values, asked, unseen)).encode())[:8]}")
        write_set(robot, values, drives / "static.json", drives / "tuned.yaml")
        changed = changes(robot, values, saved)
        write_bytes(drives / "changes.csv", changed.to_csv(index=False).encode())
        show("what each parameter saves per course:\n" + changed.drop(columns="meaning").to_string(index=False))
        written = []
        for file, monitor in JUDGED:
            method, lines = verdict(driven_unseen(options, unseen, drives, monitor))
            lines.insert(0, f"{file}, {monitor} the collision monitor:")
            shown = report.write(drives / monitor, above=lines)
            if method == SET:
                write_bytes(folder / file, read_bytes(drives / file))
                written.append(folder / file)
            end = f"written: {folder / file}" if method == SET else f"nothing written: the set is in {drives / file}"
            show("\n".join([*lines, end, f"page: {shown}"]))
    return 0 if written else 1


if __name__ == "__main__":
    sys.exit(main())
