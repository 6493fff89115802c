"""Program that an AnswerProcess starts for each stop: reads its bag, prints a line an answer.

It needs no ROS master.
"""

from __future__ import annotations

import json
import sys

from applr_ros1.common.errors import run_main
from applr_ros1.nodes.black_box.messages import deserialize
from applr_ros1.why.black_box.answering import answers_of
from applr_ros1.why.black_box.bag_file import read_messages


def main() -> int:
    """Answer to the bag on stdin."""
    messages = list(read_messages(sys.stdin.buffer.read()))
    for answer in answers_of(messages, deserialize):
        print(json.dumps(answer.message()), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(run_main(main, "black box"))
