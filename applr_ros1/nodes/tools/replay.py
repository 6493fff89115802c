"""Plays a recorded drive back: every topic of the bag, and its time on /clock.

Called by scripts/replay.py (replay.launch), which becomes rosbag's player. A recorded /clock is left out: beside the
player's own it would let the time jump back and forth.
"""

from __future__ import annotations

import argparse
import os
import sys
from typing import List

from applr_ros1.common.arguments import boolean, without_remappings
from applr_ros1.common.errors import ApplrError, reason

from .processes import become

LEFT_OUT = ("/clock", "/rosout", "/rosout_agg")


def main() -> None:
    """The command replay.py. Returns only with an error."""
    words = sys.argv[1:]
    parser = argparse.ArgumentParser(prog="replay.py", description="Play a bag back with its time on /clock.")
    parser.add_argument("bag", help="Bag file that was recorded, for instance with record:=drive.bag.")
    parser.add_argument("--rate", type=float, default=1.0, help="Recorded seconds per second. Default: %(default)s.")
    parser.add_argument(
        "--start",
        type=float,
        default=0.0,
        help="Seconds of the bag that are left out at its start. Default: %(default)s.",
    )
    parser.add_argument(
        "--delay", type=float, default=0.2, help="Seconds to wait before the bag begins. Default: %(default)s."
    )
    parser.add_argument(
        "--loop", default="false", help="Whether to begin again at the end: true or false, the default."
    )
    options = parser.parse_args(without_remappings(words))
    if not 0.0 < options.rate <= 1000.0:
        raise ApplrError(f"rate is {options.rate:g}: give a number above 0, at most 1000")
    if not 0.0 <= options.start < float("inf"):
        raise ApplrError(f"start is {options.start:g}: give 0 seconds or more")
    arguments = ["--clock", f"--rate={options.rate:g}", f"--start={options.start:g}", f"--delay={options.delay:g}"]
    arguments.append("--loop" if boolean("loop", options.loop) else "--keep-alive")
    arguments += ["--quiet", "--topics", *replayed(options.bag), "--bags", options.bag]
    become("rosbag", "play", arguments + [word for word in words if word.startswith("__")])


def replayed(bag: str) -> List[str]:
    """The topics of a bag file that are played back.

    Raises:
        ApplrError: It is not there, was not closed, cannot be read, or holds nothing.
    """
    import rosbag

    if not os.path.isfile(bag):
        raise ApplrError(f"bag is {bag}: there is no such file")
    try:
        with rosbag.Bag(bag) as file:
            found = sorted(file.get_type_and_topic_info().topics)
    except rosbag.ROSBagUnindexedException:
        raise ApplrError(f"bag is {bag}: it was not closed; mend it with rosbag reindex") from None
    except (rosbag.ROSBagException, OSError, ValueError, KeyError) as error:
        raise ApplrError(f"bag is {bag}: it cannot be read ({reason(error)})") from None
    found = [topic for topic in found if topic not in LEFT_OUT]
    if not found:
        raise ApplrError(f"bag is {bag}: there is nothing in it")
    return found
