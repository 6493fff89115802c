"""Logbook as JSON values and as a page, with a page of each drive a click away."""

from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Sequence, Tuple
from urllib.parse import quote

import numpy as np

from applr_ros1.common.angles import transform_point
from applr_ros1.common.files import write_bytes
from applr_ros1.common.pages.page import Page
from applr_ros1.why.answer import thinned, values_of
from training.common.folders import make_folder
from training.why.common_change import CommonChange
from training.why.driven import trials_values
from training.why.logbook import Logbook, LoggedStop
from training.why.logbook_words import (
    LostTime,
    advice,
    by_day,
    by_parameter,
    by_place,
    by_reason,
    how_sure,
    lines_of,
    stop_in_words,
)
from training.why.logged_bag import LoggedBag
from training.why.pages import MARKS, drive_page
from worlds.map_reader import is_occupied
from worlds.world import Grid

TRACK_S = 0.5  # interval between the positions of a driven path on a map [s]
CELL_M = 0.1  # distance of the points of a map [m]
MOST_POINTS = 40_000  # number of points of a map above which it is drawn more coarsely
SCRIPTS = (MARKS, Path(__file__).with_name("logbook.js"))
DRIVEN = (
    "Changes were driven in simulation, from the recorded start to the goal in the worlds that the "
    "laser saw at the worst stops: a change is advised only if it takes a tenth less time over all "
    "of them with seeds that did not choose it, and in none a tenth more. A drive that does not "
    "arrive counts with its time limit."
)
FRAMES = (
    "Stops within a robot's length in the same frame are one place. Odometry, also if scan "
    "matching corrects it (matched), begins anew at each start of the robot: two of its frames are "
    "drawn as one only if the laser saw the same there."
)


def logbook_values(logbook: Logbook, change: Optional[CommonChange]) -> Dict[str, Any]:
    """Return a logbook as JSON values, without maps."""
    number_of = {id(logged): number for number, logged in enumerate(logbook.stops)}

    def groups(lost_times: Sequence[LostTime]) -> List[Dict[str, Any]]:
        return [_group_values(lost_time, number_of) for lost_time in lost_times]

    places = []
    for place, group in zip(logbook.places, groups(by_place(logbook.places))):
        x, y = place[0].position
        floor = place[0].bag.floor
        places.append({**group, "place": [round(x, 3), round(y, 3)], "floor": floor})
    remedies = []
    if change is not None and change.trials.remedy is not None:
        remedies.append(str(change.trials.remedy.candidate))
    return {
        "lines": lines_of(logbook, change),
        "advice": advice(logbook, change),
        "sure": how_sure(logbook),
        "reproduced": logbook.reproduced / logbook.commands if logbook.commands else 0.0,
        "remedies": remedies,
        "notes": logbook.notes,
        "robots": logbook.robots,
        "bags": [str(bag.path) for bag in logbook.bags],
        "events": list(map(_stop_values, logbook.stops)),
        "places": places,
        "reasons": groups(by_reason(logbook.stops)),
        "parameters": groups(by_parameter(logbook.stops)),
        "days": groups(by_day(logbook.stops)),
        "driven": _change_values(change),
    }


def _group_values(lost_time: LostTime, number_of: Dict[int, int]) -> Dict[str, Any]:
    """Return stops that have something in common as JSON values."""
    return {
        "words": lost_time.words,
        "lost": round(lost_time.lost, 1),
        "stops": [number_of[id(logged)] for logged in lost_time.stops],
    }


def _stop_values(logged: LoggedStop) -> Dict[str, Any]:
    """Return a stop as JSON values."""
    answer = logged.bag.answer
    is_guessed = bool(answer.guess) and not logged.stop.is_outside
    return {
        **values_of(replace(logged.stop, place=logged.position, cycles=())),
        "title": stop_in_words(logged),
        "bag": logged.bag.path.name,
        "robot": answer.robot,
        "time": round(logged.begin, 2),
        "guess": str(answer.guess[0]) if is_guessed else "",
        "frame": answer.frame,
        "floor": logged.bag.floor,
    }


def _change_values(change: Optional[CommonChange]) -> Optional[Dict[str, Any]]:
    """Return what was driven for a logbook as JSON values, without paths."""
    if change is None:
        return None
    values = trials_values(change.trials)
    for tried in [*values["tried"], values["recorded"]]:
        del tried["paths"]
    return {
        **values,
        "bags": [bag.path.name for bag in change.bags],
        "gains": [round(gain, 2) for gain in change.gains],
    }


# -- pages -----------------------------------------------------------------------------------------
def write_pages(
    path: Path,
    values: Dict[str, Any],
    logbook: Logbook,
    change: Optional[CommonChange],
    floor_map: Optional[Grid],
) -> None:
    """Write the page of a logbook, and those of its drives into a folder beside it.

    Args:
        path: The page.
        values: Values of the logbook (logbook_values).
        logbook: The logbook.
        change: What was driven.
        floor_map: Map to draw under drives in its frame, or None.
    """
    folder = make_folder(path.with_name(f"{path.stem}_drives"))
    addresses: Dict[int, str] = {}
    taken_names = set()
    for bag in logbook.bags:
        if not bag.answer.is_replayed:
            continue
        # Bags of several folders may have one name.
        page_name = bag.path.name
        while page_name in taken_names:
            page_name += "_"
        taken_names.add(page_name)
        back = f'<p><a href="../{html.escape(quote(path.name))}">All stops</a></p>'
        page = drive_page(_drive_values(bag, change), back)
        write_bytes(folder / f"{page_name}.html", page.html())
        addresses[id(bag)] = quote(f"{folder.name}/{page_name}.html")

    links = [_link_to(logged, addresses) for logged in logbook.stops]
    floors = floors_of(logbook, floor_map)
    driven_notes = [DRIVEN] if change is not None else []
    page = Page(
        kind="why · logbook",
        title="Why did the robot stop or slow down, and where?",
        verdict=values["lines"][0],
        scripts=SCRIPTS,
        data={**values, "floors": floors, "links": links},
        measured=[values["sure"], FRAMES, *driven_notes],
    )
    write_bytes(path, page.html())


def _drive_values(bag: LoggedBag, change: Optional[CommonChange]) -> Dict[str, Any]:
    """Return the values of the page of one drive, with what was driven in its world."""
    values = bag.answer.values()
    if change is None or bag not in change.bags:
        return values
    trials = change.trials.on_course(change.bags.index(bag))
    return {**values, **trials_values(trials)}


def _link_to(logged: LoggedStop, addresses: Dict[int, str]) -> str:
    """Return the address of a stop on the page of its drive; "" if the drive has no page."""
    address = addresses.get(id(logged.bag))
    if address is None:
        return ""
    number = 1 + logged.bag.answer.events.index(logged.stop)
    return f"{address}#{number}"


def floors_of(logbook: Logbook, floor_map: Optional[Grid]) -> List[Dict[str, Any]]:
    """Return the frames with what was seen and driven in each, as JSON values."""
    floors = []
    for number in range(1 + max(bag.floor for bag in logbook.bags)):
        bags = [bag for bag in logbook.bags if bag.floor == number]
        has_map = floor_map is not None and bags[0].answer.is_shared
        points = _seen_points(bags)
        smallest_cell = CELL_M
        if floor_map is not None and has_map:
            points = _map_points(floor_map)
            smallest_cell = max(CELL_M, floor_map.resolution)
        points, cell_m = _thinned(points, smallest_cell)
        tracks = []
        for bag in bags:
            track = np.array(thinned(np.array(bag.answer.track), TRACK_S))
            tracks.append(bag.answer.placed(track[:, 1:3]).round(2).tolist())
        floors.append(
            {
                "frame": bags[0].answer.frame,
                "has_map": has_map,
                "points": points.round(2).tolist(),
                "cell": cell_m,
                "tracks": tracks,
            }
        )
    return floors


def _seen_points(bags: Sequence[LoggedBag]) -> np.ndarray:
    """Return points (n, 2) [m] that the laser saw in some drives."""
    return np.concatenate([bag.answer.placed(bag.answer.map) for bag in bags])


def _map_points(floor_map: Grid) -> np.ndarray:
    """Return the centres (n, 2) [m] of the occupied cells of a map."""
    rows, columns = np.nonzero(is_occupied(floor_map.cells))
    resolution = floor_map.resolution
    x, y = transform_point(
        floor_map.origin, (columns + 0.5) * resolution, (rows + 0.5) * resolution
    )
    return np.column_stack([x, y])


def _thinned(points: np.ndarray, cell_m: float) -> Tuple[np.ndarray, float]:
    """Return points (n, 2), one in each cell, and the edge of the cells [m], from cell_m on."""
    while True:
        cells = np.unique(np.floor(points / cell_m), axis=0)
        if len(cells) <= MOST_POINTS:
            return (cells + 0.5) * cell_m, cell_m
        cell_m *= 2.0
