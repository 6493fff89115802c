"""Explains why a robot stopped: what happened, why, and what helps when it is driven.

Run it as `./applr why BAG` or `python -m training.why BAG`. The recorded drive is replayed through
move_base's local planner, cycle by cycle. Changes of parameters are then driven in simulation, in
the world that the laser saw. With two bags, it reports which parameters differ and which of them
explains the difference.
"""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import List, Optional

from tqdm import tqdm

from applr_ros1.common.errors import run_main
from applr_ros1.common.extras import extra
from applr_ros1.common.files import write_bytes
from applr_ros1.common.pages.page import Page
from applr_ros1.drives.drive import Drive, Motion
from applr_ros1.why.diagnosis import diagnose
from applr_ros1.why.outside import seen_from_outside
from applr_ros1.why.replay import Replay, Watch
from training.common.command_line import parsed
from training.common.options import argument, option

with extra(__name__):
    from training.bags.read import bags_in
    from training.why.answer import Answer, lines_of, outside_lines
    from training.why.comparison import compared
    from training.why.recorded import (
        OtherPlannerError,
        RecordedOptions,
        with_description,
    )
    from training.why.remedies import driven_trials, possible_guesses
    from training.why.replayed import check_cycles, replay_in
    from training.why.seen_world import seen_grid, write_map
    from training.why.values import outside_values, values_of
    from training.workers.pool import Pool

REPLAYED = (
    "The recorded drive was replayed through the local planner, cycle by cycle, on the map that "
    "the laser built."
)
DRIVEN = (
    "Changes were driven from the recorded start to the goal in simulation, in "
    "the world that the laser saw: a change is advised only if it is a tenth faster with seeds "
    "that did not choose it, and slower with none of them."
)
SCRIPTS = (Path(__file__).with_name("why.js"),)


class WhyOptions(RecordedOptions):
    """Options of a replay."""

    bag: List[str] = argument(
        "Bag of a drive, of ROS 1 or ROS 2. Further bags are compared with the first."
    )
    at: Optional[float] = option(
        None, "Time in the bag to explain, whatever happened then [s].", ge=0
    )
    out: str = option(
        "", "HTML page to write, with map, path, events and the trajectories of their cycles."
    )
    quick: bool = option(
        False, "Leave out the drives in simulation: only the replay ranks changes of parameters."
    )
    map: str = option(
        "",
        "Map to write of what the laser saw, MAP.yaml, in which demo, evaluate and tune can drive.",
    )
    workers: int = option(
        2, "Number of processes that drive in simulation; 0 uses this one.", ge=0, le=64
    )
    json_: bool = option(False, "Print a JSON object instead of text.")


def run(options: WhyOptions) -> None:
    """Replay the bags and print the diagnosis."""
    bag_paths = bags_in(options.bag)
    # A bag of the black box says which robot drove.
    options = with_description(bag_paths[0], options)
    try:
        replays = [_replayed(bag_path, options) for bag_path in bag_paths]
    except OtherPlannerError as other:
        if other.drive.odometry is None:
            raise
        _answer_from_outside(other.drive, other.drive.odometry, options)
        return
    first_replay, *other_replays = replays
    if options.map:
        write_map(seen_grid(first_replay.recording), options.map)
    if options.quick:
        diagnosis = diagnose(first_replay, options.at)
        answer = Answer(diagnosis, possible_guesses(diagnosis))
    else:
        with Pool(options.workers) as pool:
            diagnosis = diagnose(first_replay, options.at)
            guesses = possible_guesses(diagnosis)
            answer = Answer(diagnosis, guesses, driven_trials(diagnosis, guesses, pool))

    lines = lines_of(answer)
    for other_replay in other_replays:
        lines += compared(first_replay, other_replay)
    answer_values = {**values_of(answer), "lines": lines}
    print(json.dumps(answer_values) if options.json_ else "\n".join(lines))
    if options.out:
        driven_notes = [DRIVEN] if answer.trials is not None else []
        page = Page(
            kind=f"why · {first_replay.drive.name}",
            title="Why did the robot stop or slow down?",
            verdict=answer_values["happened"],
            scripts=SCRIPTS,
            data=answer_values,
            measured=[answer_values["sure"], *first_replay.drive.notes, REPLAYED, *driven_notes],
        )
        write_bytes(options.out, page.html())


def _answer_from_outside(drive: Drive, odometry: Motion, options: WhyOptions) -> None:
    """Print what is known of a drive of a local planner that is not replayed."""
    found_events = seen_from_outside(drive, odometry, options.robot)
    lines = outside_lines(found_events)
    if options.json_:
        print(json.dumps(outside_values(drive, found_events, lines)))
    else:
        print("\n".join(lines))
    if options.out:
        print(f"{options.out}: not written: a page shows a replay", file=sys.stderr)


def _replayed(path: Path, options: WhyOptions) -> Replay:
    """Return the replay of the drive in a bag, with its progress and notes on stderr."""
    watch: Watch = partial(tqdm, desc=path.name, leave=False, disable=None)
    replay = replay_in(path, options, watch)
    # On stderr, so that --json prints nothing but the object
    for note in replay.drive.notes:
        print(f"{path}: {note}", file=sys.stderr)
    check_cycles(path, replay)
    return replay


def main(arguments: Optional[List[str]] = None) -> int:
    """Run the command; return its exit status."""
    return run_main(
        lambda: run(parsed(WhyOptions, "./applr why", __doc__, arguments)), "./applr why"
    )


if __name__ == "__main__":
    sys.exit(main())
