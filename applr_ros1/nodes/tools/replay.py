"""The node replay plays a recorded drive back: every topic of the bag, and its time on /clock.

Called by scripts/replay.py (replay.launch). rosbag's player is its child, which begins anew at another time or speed. A
recorded /clock is left out: beside the player's own it would let the time jump back and forth.

Subscribes: ~seek (std_msgs/Float64: seconds since the bag's start), ~rate (std_msgs/Float64: recorded seconds per
second). Service of the player: replay_player/pause_playback. Sets ~start (time of the first message), ~length and
~decisions (when the policy changed a parameter), in seconds; the last two count from ~start.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from typing import Any, Dict, List, Tuple

from applr_ros1.common.arguments import boolean, without_remappings
from applr_ros1.common.errors import ApplrError, reason

from .processes import leave_with_parent, program_of

START, LENGTH, DECISIONS = "replay/start", "replay/length", "replay/decisions"  # parameters
SEEK, RATE, PAUSE = "replay/seek", "replay/rate", "replay_player/pause_playback"
FASTEST = 1000.0
SOON = 0.2  # s that rosbag's player waits before it begins anew
LEFT_OUT = ("/clock", "/rosout", "/rosout_agg")


def main() -> int:
    """The command replay.py: exit status of rosbag's player, 0 at shutdown. Raises ApplrError, one line."""
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
    if not 0.0 < options.rate <= FASTEST:
        raise ApplrError(f"rate is {options.rate:g}: give a number above 0, at most {FASTEST:g}")
    if not 0.0 <= options.start < float("inf"):
        raise ApplrError(f"start is {options.start:g}: give 0 seconds or more")
    loop = boolean("loop", options.loop)
    topics, known = replayed(options.bag)
    arguments = ["--loop" if loop else "--keep-alive", "--clock", "--quiet", "--topics", *topics, "--bags", options.bag]
    return _play(program_of("rosbag", "play"), arguments, options, known)


def _play(program: str, arguments: List[str], options: Any, known: Dict[str, Any]) -> int:
    """Play until shutdown or until the player ends; other nodes change time and speed."""
    import rospy
    from std_msgs.msg import Float64

    from applr_ros1.common.ros_node import init_node

    init_node("replay")
    wanted: Dict[str, float] = {}
    for name, value in known.items():
        rospy.set_param("~" + name, value)
    rospy.Subscriber("~seek", Float64, lambda message: wanted.update(at=message.data), queue_size=1)
    rospy.Subscriber("~rate", Float64, lambda message: wanted.update(rate=message.data), queue_size=1)
    at, rate, delay = options.start, options.rate, options.delay
    while not rospy.is_shutdown():
        timing = [f"--start={at:g}", f"--rate={rate:g}", f"--delay={delay:g}"]
        names = ["__name:=" + rospy.get_name().split("/")[-1] + "_player", "__ns:=" + rospy.get_namespace()]
        player = subprocess.Popen([program, *timing, *arguments, *names], preexec_fn=leave_with_parent)
        while player.poll() is None and not wanted and not rospy.is_shutdown():
            time.sleep(0.05)
        if player.poll() is not None:
            return player.returncode
        now = min(max(rospy.get_time() - known["start"], 0.0), known["length"])
        at, delay = min(max(wanted.get("at", now), 0.0), known["length"] - SOON), SOON
        rate = min(max(wanted.get("rate", rate), 0.01), FASTEST)
        wanted.clear()
        player.terminate()
        player.wait()
    return 0


def replayed(bag: str) -> Tuple[List[str], Dict[str, Any]]:
    """The topics of a bag file that are played back, and {start, length, decisions} as the node's parameters.

    Raises:
        ApplrError: It is not there, was not closed, cannot be read, or holds nothing.
    """
    import rosbag

    if not os.path.isfile(bag):
        raise ApplrError(f"bag is {bag}: there is no such file")
    try:
        with rosbag.Bag(bag) as file:
            found = sorted(set(file.get_type_and_topic_info().topics) - set(LEFT_OUT))
            decisions = [topic for topic in found if topic.endswith("applr/decision")]
            made = file.read_messages(decisions) if decisions else ()
            changes = [when.to_sec() for _, made, when in made if made.before.values != made.after.values]
            start, end = (file.get_start_time(), file.get_end_time()) if found else (0.0, 0.0)
    except rosbag.ROSBagUnindexedException:
        raise ApplrError(f"bag is {bag}: it was not closed; mend it with rosbag reindex") from None
    except (rosbag.ROSBagException, OSError, ValueError, KeyError) as error:
        raise ApplrError(f"bag is {bag}: it cannot be read ({reason(error)})") from None
    if not found:
        raise ApplrError(f"bag is {bag}: there is nothing in it")
    return found, {"start": start, "length": end - start, "decisions": [when - start for when in changes]}
