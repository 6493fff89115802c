"""Program that an AnswerProcess starts for each stop: reads messages, prints a line an answer.

It needs no ROS master.
"""

from __future__ import annotations

import json
import marshal
import sys
from contextlib import suppress

from applr_ros1.common.errors import run_main
from applr_ros1.nodes.black_box.messages import deserialize
from applr_ros1.why.black_box.answering import answers_of
from applr_ros1.why.black_box.bag_file import Publication, RawMessage


def main() -> int:
    """Answer to the messages on stdin."""
    messages = []
    with suppress(EOFError):
        while True:
            time, publication, data = marshal.load(sys.stdin.buffer)
            messages.append(RawMessage(time, Publication(*publication), data))
    for answer in answers_of(messages, deserialize):
        print(json.dumps(answer.message()), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(run_main(main, "black box"))
