"""The recorded drive in tests/data, on which anyone can try `./applr why`:

    ./applr why tests/data/stopped.bag --robot turtlebot3_burger

A simulated TurtleBot3 burger stands before a gap, because its DWAPlannerROS weighs costs 25 times
as much as in the robot's files. `python -m tests.support.stopped_drive` writes the bag anew.
"""

import sys
import tempfile
from dataclasses import replace
from pathlib import Path

from rosbags.rosbag1 import Reader, Writer

from applr_ros1.robots import load
from tests.support import DATA
from tests.support.bags import write
from tests.support.drives import changed, simulated
from tests.support.replays import updates

ROBOT = "turtlebot3_burger"
BAG = DATA / "stopped.bag"
# The cause of the stop, and what the robot's files say
PLANNER = "DWAPlannerROS"
PARAMETER = "occdist_scale"
SPOILT_VALUE = 0.5
WORLD = "generated:61"
LIMIT_S = 17.0


def main():
    """Drive, and write the bag."""
    robot = load(ROBOT)
    spoilt_values = {PARAMETER: SPOILT_VALUE}
    drive, _ = simulated(changed(robot, {PLANNER: spoilt_values}), WORLD, LIMIT_S)
    # As if a person had set the value with rqt_reconfigure: the bag says so, not the robot's files.
    drive = replace(drive, changes=updates((0.0, PLANNER, spoilt_values)))
    with tempfile.TemporaryDirectory() as folder:
        plain_bag = write(Path(folder, "plain.bag"), drive, robot=robot)
        BAG.unlink(missing_ok=True)
        compress(plain_bag, BAG)
    return 0


def compress(plain_bag, compressed_bag):
    """Copy a bag with compressed messages, as `rosbag compress` does."""
    with Reader(plain_bag) as reader:
        writer = Writer(compressed_bag)
        writer.set_compression(Writer.CompressionFormat.BZ2)
        with writer:
            connections = {}
            for connection in reader.connections:
                connections[connection.id] = writer.add_connection(
                    connection.topic,
                    connection.msgtype,
                    msgdef=connection.msgdef.data,
                    md5sum=connection.digest,
                )
            for connection, time_ns, message in reader.messages():
                writer.write(connections[connection.id], time_ns, message)


if __name__ == "__main__":
    sys.exit(main())
