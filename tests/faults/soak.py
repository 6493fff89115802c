"""Drives the whole stack for hours of simulated time and measures memory, descriptors and threads of every process.

    ./applr exec python -m tests.faults.soak --hours 2 --out soak

It sends one goal after another through the built-in worlds at real_time_factor 0 and samples every process once per
simulated minute. `--out` gets samples.csv and, at the end or after Ctrl-C, summary.json: the memory's trend of each
process in MB per simulated hour, and its descriptors and threads. Exit status 1 if a process ended, grew by more than
`--most` MB per hour, or kept opening descriptors or threads.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import actionlib
import numpy as np
import pandas as pd
import psutil
import rospy
from actionlib_msgs.msg import GoalStatus
from move_base_msgs.msg import MoveBaseAction
from nav_msgs.msg import Odometry
from std_srvs.srv import Trigger

import worlds
from applr_ros1.common.errors import ApplrError, run_main
from applr_ros1.nodes.tools import send_goal
from applr_ros1.nodes.tools.launcher import private_stack

COLUMNS = ("simulated_s", "process", "pid", "memory_mb", "descriptors", "threads")
WARM_UP = 0.2  # share of the time left out of the trends: kernels are loaded, buffers and caches fill
EVERY = 60.0  # simulated seconds between samples
LONGEST = 60.0  # simulated seconds for one course
SILENCE = 120.0  # wall seconds without a new clock after which the stack counts as dead


def sample(elapsed):
    """Rows (COLUMNS) for all processes below this one: nodes by their ROS names, others by their programs."""
    for process in psutil.Process().children(recursive=True):
        try:
            words = process.cmdline()
            name = next((word[8:] for word in words if word.startswith("__name:=")), Path(words[0]).name)
            memory = process.memory_info().rss / 2**20
            yield (elapsed, name, process.pid, memory, process.num_fds(), process.num_threads())
        except (psutil.Error, IndexError):  # it has ended
            continue


def summary(samples):
    """{process: {mb_per_hour, mb_last, descriptors, threads ([least, most]), opening, restarts}} of a table of samples.

    The trend is a least-squares line through the samples after the warm-up; "opening" says that the last quarter never
    had as few descriptors or threads as the first.
    """
    found = {}
    for name, rows in samples.groupby("process"):
        steady = rows[rows.simulated_s >= WARM_UP * samples.simulated_s.max()]
        counts, quarter = steady[["descriptors", "threads"]], max(1, len(steady) // 4)
        trend = np.polyfit(steady.simulated_s / 3600.0, steady.memory_mb, 1)[0] if len(steady) > 2 else 0.0
        found[name] = {
            "mb_per_hour": round(float(trend), 2),
            "mb_last": round(float(steady.memory_mb.iloc[-1]), 1),
            **{column: [int(counts[column].min()), int(counts[column].max())] for column in counts},
            "opening": bool((counts[-quarter:].min() > counts[:quarter].max()).any()),
            "restarts": rows.pid.nunique() - 1,
        }
    return found


class Driver:
    """One goal after another in the running stack; `samples` grows meanwhile."""

    def __init__(self, stack):
        rospy.init_node("soak", anonymous=True, disable_signals=True)
        self.samples, self.courses, self.reached, self.newest = [], 0, 0, None
        self._stack = stack
        rospy.Subscriber("/sim_bridge/ground_truth", Odometry, self._on_pose, queue_size=1)
        self._client = actionlib.SimpleActionClient("move_base", MoveBaseAction)
        stack.wait(lambda: self.newest and self._client.wait_for_server(rospy.Duration(0.01)), 900.0, "not up")

    def _on_pose(self, message):
        position = message.pose.pose.position
        self.newest = message.header.stamp.to_sec(), position.x, position.y

    def run(self, hours):
        """Until so many hours of simulated time are over. Raises ApplrError where a process ends or nothing moves."""
        start, due = self.newest[0], 0.0
        while self.newest[0] - start < 3600.0 * hours:
            course, began = self._begin(f"generated:{self.courses % 300}"), self.newest[0]
            arrived, running = False, (GoalStatus.PENDING, GoalStatus.ACTIVE)
            while not arrived and self.newest[0] - began < LONGEST and self._client.get_state() in running:
                if self.newest[0] - start >= due:
                    due += EVERY
                    self.samples += sample(round(self.newest[0] - start, 1))
                before = self.newest
                self._stack.wait(lambda before=before: self.newest != before, SILENCE, "no new pose", pause=0.05)
                arrived = course.arrived(*self.newest[1:])
            self.reached += arrived

    def _begin(self, name):
        """Load a world and send its goal; returns its course."""
        self._client.cancel_all_goals()
        rospy.set_param("/sim_bridge/world", name)
        answer = rospy.ServiceProxy("/sim_bridge/load_world", Trigger)()
        assert answer.success, answer.message
        course = worlds.load(name).course
        self._client.send_goal(send_goal.message(send_goal.course_goal(course)))
        self.courses += 1
        return course


def main():
    """The command. Returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=2.0, help="Simulated hours to drive.")
    parser.add_argument("--out", type=Path, default=Path("soak"), help="Folder for samples.csv and summary.json.")
    parser.add_argument("--most", type=float, default=5.0, help="Growth of one process [MB per hour] that is a leak.")
    parser.add_argument("--simulator", default="kinematic", help="Simulator of the robot: kinematic or pybullet.")
    chosen, ended = parser.parse_args(), ""
    chosen.out.mkdir(parents=True, exist_ok=True)
    given = {"goal": "none", "real_time_factor": "0", "simulator": chosen.simulator}
    with private_stack(given) as stack:
        driver, began = Driver(stack), time.monotonic()
        try:
            driver.run(chosen.hours)
        except (KeyboardInterrupt, ApplrError) as stopped:
            ended = str(stopped)
    table = pd.DataFrame(driver.samples, columns=COLUMNS)
    table.to_csv(chosen.out / "samples.csv", index=False)
    found = summary(table)
    (chosen.out / "summary.json").write_text(json.dumps(found, indent=1) + "\n")
    hours = (time.monotonic() - began) / 3600.0
    print(f"{driver.courses} courses, {driver.reached} to the goal, {hours:.2f} h; {ended}")
    print(pd.DataFrame(found).T.to_string())
    leaks = [n for n, row in found.items() if row["mb_per_hour"] > chosen.most or row["opening"] or row["restarts"]]
    if leaks:
        raise ApplrError(f"{', '.join(leaks)} grew, kept opening descriptors or threads, or was started again")
    return 1 if ended else 0


if __name__ == "__main__":
    sys.exit(run_main(main, "soak"))
