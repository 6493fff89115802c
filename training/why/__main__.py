"""Explains why a robot stopped: what happened, why, and what helps when it is driven.

Run it as `./applr why BAG` or `python -m training.why BAG`. The recorded drive is replayed through
move_base's local planner, cycle by cycle. Changes of parameters are then driven in simulation, in
the world that the laser saw. With two bags, it reports which parameters differ and which of them
explains the difference. Of a folder, or of more bags, it makes a logbook: where, why and when time
was lost, and which change would help most. The answers are kept beside the bags (BAG.why.json).
"""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path
from typing import Any, Dict, Iterable, List, Optional, Sequence

from tqdm import tqdm

from applr_ros1.common.errors import ApplrError
from applr_ros1.common.extras import extra
from applr_ros1.common.files import is_in_writable_folder, write_bytes
from applr_ros1.why.answer import answer_of
from applr_ros1.why.diagnosis import diagnose
from applr_ros1.why.replay import Replay, Watch
from training.common.command_line import continuable, run_command
from training.common.options import argument, option

with extra(__name__):
    from training.bags.read import METADATA, bags_in
    from training.why.common_change import change_for
    from training.why.comparison import compared
    from training.why.driven import with_trials
    from training.why.logbook import logbook_of
    from training.why.logbook_page import logbook_values, write_pages
    from training.why.pages import drive_page
    from training.why.recorded import (
        BagAnswerOptions,
        NotReplayedError,
        described_in,
        with_description,
    )
    from training.why.remedies import driven_trials, possible_guesses
    from training.why.replayed import replay_in
    from training.why.seen_world import MAP_RESOLUTION_M, seen_grid, write_map
    from training.workers.pool import Pool
    from worlds.map_reader import read_map

LONGEST_BAG_S = 7200.0  # time after which a worker counts as hung, for replays of long bags [s]
COMPARED = 2  # number of bags that are compared with each other
# Style of the bars of a logbook, which only a terminal shows
BAR: Dict[str, Any] = {"dynamic_ncols": True, "leave": False, "disable": None}


class WhyOptions(BagAnswerOptions):
    """Options of a replay."""

    bag: List[str] = argument(
        "Bag of a drive, of ROS 1 or ROS 2. A second one is compared with it. Of a folder, or of "
        "three bags and more, a logbook is made."
    )
    at: Optional[float] = option(
        None,
        "Time in the bag to explain, whatever happened then [s]. Nothing is driven in simulation.",
        ge=0,
    )
    out: str = option(
        "", "HTML page to write, with map, path, events and the trajectories of their cycles."
    )
    on: str = option("", "Map (map.yaml) under the drives on the page of a logbook.")
    map: str = option(
        "",
        "Map to write of what the laser saw, MAP.yaml, in which demo, evaluate and tune can drive.",
    )
    workers: int = option(
        2, "Number of processes that drive in simulation; 0 uses this one.", ge=0, le=64
    )
    json_: bool = option(False, "Print a JSON object instead of text.")


def run(options: WhyOptions) -> None:
    """Replay the bags and print the diagnosis, or the logbook of many bags."""
    bag_paths = bags_in(options.bag)
    # An answer of minutes must not end with a file that cannot be written.
    for option_name in ("out", "map"):
        file_path = getattr(options, option_name)
        if file_path and not is_in_writable_folder(file_path):
            remedy = "give a file in a folder that can be written"
            raise ApplrError(f"--{option_name} {file_path}: {remedy}")
    is_folder = any(map(_holds_bags, options.bag))
    if is_folder or len(bag_paths) > COMPARED:
        _keep_logbook(bag_paths, options)
        return
    if options.map and not options.map.endswith(".yaml"):
        raise ApplrError(f"--map {options.map}: give a file that ends in .yaml")
    if options.on:
        raise ApplrError("--on is the map of a logbook: give a folder, or three bags and more")
    # A bag of the black box says which robot drove.
    options = with_description(bag_paths[0], options)
    try:
        replays = [_replayed(bag_path, options) for bag_path in bag_paths]
    except NotReplayedError as problem:
        if len(bag_paths) > 1:
            raise ApplrError(
                f"{problem}; ask about one bag, drives are compared by replays"
            ) from None
        values = answer_of(problem.diagnosis).values()
        _print_notes(bag_paths[0], values["notes"])
        _print(values, options)
        _name_unused(options)
        return
    first_replay, *other_replays = replays
    if options.map:
        write_map(seen_grid(first_replay.recording, MAP_RESOLUTION_M), options.map)
    diagnosis = diagnose(first_replay, options.at, described_in(bag_paths[0]))
    guesses = possible_guesses(diagnosis)
    answer = answer_of(diagnosis, guesses)
    if not options.quick:
        with Pool(options.workers) as pool:
            answer = with_trials(answer, driven_trials(diagnosis, guesses, pool))

    values = answer.values()
    for other_replay in other_replays:
        values["lines"] += compared(first_replay, other_replay)
    _print(values, options)
    if options.out:
        write_bytes(options.out, drive_page(values).html())


def _print(values: Dict[str, Any], options: WhyOptions) -> None:
    """Print an answer."""
    print(json.dumps(values) if options.json_ else "\n".join(values["lines"]))


# -- many bags -------------------------------------------------------------------------------------
def _holds_bags(path: str) -> bool:
    """Return whether a path is a folder with bags, not a bag of ROS 2."""
    return Path(path).is_dir() and not (Path(path) / METADATA).exists()


def _keep_logbook(bag_paths: Sequence[Path], options: WhyOptions) -> None:
    """Print the logbook of bags, and write its pages."""
    for option_name in ("at", "map"):
        if option_name in options.model_fields_set:
            raise ApplrError(f"--{option_name} is about one bag, there are several: give one bag")
    if options.on and not options.out:
        raise ApplrError("--on is the map on the page of a logbook: name the page with --out")
    floor_map = read_map(options.on) if options.on else None
    given = {name: getattr(options, name) for name in options.model_fields_set}
    bag_options = BagAnswerOptions(
        **{name: value for name, value in given.items() if name in BagAnswerOptions.model_fields}
    )
    with continuable(), Pool(options.workers, seconds=LONGEST_BAG_S) as pool:
        logbook = logbook_of(bag_paths, bag_options, pool, _bag_bar)
        change = None
        if not options.quick:
            bar = tqdm(desc="drives in simulation", unit="drive", **BAR)
            try:
                with bar:
                    change = change_for(logbook, bag_options, pool, bar.update)
            except ApplrError as problem:
                # The stops are known without it.
                logbook.notes.append(f"no change is advised: {problem}")
    for note in logbook.notes:
        print(note, file=sys.stderr)
    logged_values = logbook_values(logbook, change)
    _print(logged_values, options)
    if options.out:
        write_pages(Path(options.out), logged_values, logbook, change, floor_map)


def _bag_bar(calls: Iterable[Any], total: int, done: int) -> Iterable[Any]:
    """Show the progress over bags."""
    bar: Iterable[Any] = tqdm(calls, total=total, initial=done, unit="bag", **BAR)
    return bar


# -- one bag ---------------------------------------------------------------------------------------
def _name_unused(options: WhyOptions) -> None:
    """Say which options are not used for a drive that is not replayed."""
    for option_name, use in (
        ("out", "a page shows"),
        ("map", "a map needs"),
        ("at", "it explains"),
    ):
        if option_name in options.model_fields_set:
            print(f"--{option_name} is not used: {use} a replay", file=sys.stderr)


def _replayed(path: Path, options: WhyOptions) -> Replay:
    """Return the replay of the drive in a bag, with its progress and notes on stderr."""
    watch: Watch = partial(tqdm, desc=path.name, leave=False, disable=None)
    replay = replay_in(path, options, watch)
    _print_notes(path, replay.drive.notes)
    return replay


def _print_notes(path: Path, notes: Iterable[str]) -> None:
    """Print notes on a drive on stderr, so that --json prints nothing but the object."""
    for note in notes:
        print(f"{path}: {note}", file=sys.stderr)


def main(arguments: Optional[List[str]] = None) -> int:
    """Run the command; return its exit status."""
    return run_command(WhyOptions, run, "./applr why", __doc__, arguments)


if __name__ == "__main__":
    sys.exit(main())
