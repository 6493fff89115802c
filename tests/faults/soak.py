"""Drives the whole stack for hours of simulated time and measures memory, descriptors and threads of every process.

    ./applr exec python -m tests.faults.soak --hours 2 --out soak

It starts the launch file at real_time_factor 0, sends one goal after another through the built-in worlds, and samples
every process once per simulated minute. `--out` gets samples.csv while it runs, and summary.json at the end or after
Ctrl-C: for each process the memory's trend in MB per simulated hour, and how many descriptors and threads it had.
Exit status 1 if a process ended, grew by more than `--most` MB per hour, or kept opening descriptors or threads.
"""

import argparse
import json
import os
import sys
import time
from pathlib import Path

import numpy as np
import psutil

from applr_ros1.nodes.tools import processes

WARM_UP = 0.2  # share of the time left out of the trends: kernels are loaded, buffers and caches fill
EVERY = 60.0  # simulated seconds between samples
LONGEST = 60.0  # simulated seconds for one course
SILENCE = 120.0  # wall seconds without a new clock after which the stack counts as dead
FIELDS = ("simulated_s", "wall_s", "process", "pid", "memory_mb", "descriptors", "threads")


def processes_below(root):
    """{name: pid} of the stack's processes: the nodes by their ROS names, the others by their programs."""
    found = {}
    parent = psutil.Process(root)
    for process in [parent, *parent.children(recursive=True)]:
        try:
            words = process.cmdline()
        except psutil.Error:
            continue
        named = [word.partition(":=")[2] for word in words if word.startswith("__name:=")]
        programs = [Path(word).name for word in words[:2] if word and "python" not in Path(word).name]
        name = named[0] if named else (programs or ["?"])[0]
        found.setdefault(name, process.pid)
    return found


def measure(pid):
    """(resident memory [MB], open descriptors, threads) of a process, or None once it has ended."""
    try:
        process = psutil.Process(pid)
        return process.memory_info().rss / 2**20, process.num_fds(), process.num_threads()
    except psutil.Error:
        return None


def summary(samples, warm_up=WARM_UP):
    """What samples (rows of FIELDS) say of each process.

    Returns:
        {process: {"mb_per_hour", "mb_first", "mb_last", "mb_most", "descriptors": [least, most], "threads": [least,
        most], "opening", "restarts"}}. The trend is a least-squares line through the samples after the warm-up, in
        megabytes per simulated hour; "opening" says that the last quarter never had as few descriptors or threads as
        the first.
    """
    table = {}
    last = max((row[0] for row in samples), default=0.0)
    for name in sorted({row[2] for row in samples}):
        rows = [row for row in samples if row[2] == name]
        steady = [row for row in rows if row[0] >= warm_up * last] or rows
        hours, memory = (np.array([row[i] for row in steady], dtype=float) for i in (0, 4))
        trend = np.polyfit(hours / 3600.0, memory, 1)[0] if len(steady) > 2 else 0.0
        table[name] = {
            "mb_per_hour": round(float(trend), 2),
            "mb_first": round(steady[0][4], 1),
            "mb_last": round(steady[-1][4], 1),
            "mb_most": round(max(row[4] for row in rows), 1),
            "descriptors": [min(row[5] for row in steady), max(row[5] for row in steady)],
            "threads": [min(row[6] for row in steady), max(row[6] for row in steady)],
            "opening": any(_rises([row[i] for row in steady]) for i in (5, 6)),
            "restarts": len({row[3] for row in rows}) - 1,
        }
    return table


def _rises(counts):
    quarter = max(1, len(counts) // 4)
    return min(counts[-quarter:]) > max(counts[:quarter])


class Soak:
    """The running stack, one goal after another in it, and the samples of its processes.

    Args:
        port: TCP port of the ROS master.
        root: pid of roslaunch.
        out: folder for samples.csv.
    """

    def __init__(self, port, root, out):
        os.environ["ROS_MASTER_URI"] = "http://localhost:%d" % port
        import actionlib
        import rospy
        from move_base_msgs.msg import MoveBaseAction
        from nav_msgs.msg import Odometry

        self.root, self.samples, self.ended, self.goals = root, [], [], [0, 0]
        self.began = time.monotonic()
        self._table = out / "samples.csv"
        self._table.write_text(",".join(FIELDS) + "\n")
        rospy.init_node("soak", anonymous=True, disable_signals=True)
        self._now, self._position = 0.0, None
        rospy.Subscriber("/sim_bridge/ground_truth", Odometry, self._hear, queue_size=1)
        self._client = actionlib.SimpleActionClient("move_base", MoveBaseAction)

    def _hear(self, message):
        p = message.pose.pose.position
        self._now, self._position = message.header.stamp.to_sec(), (p.x, p.y)

    def run(self, hours, wall_hours):
        """Until so many hours of simulated or of wall time are over, or a process has ended."""
        self._wait(lambda: self._position is not None and self._server_is_up())
        start, due, number = self._now, 0.0, 0
        while True:
            number += 1
            self._begin_course("generated:%d" % (number % 300))
            course_began = self._now
            while not self._course_is_over(course_began):
                elapsed = self._now - start
                if elapsed >= due:
                    due += EVERY
                    self._sample(elapsed)
                    if self.ended:
                        return
                if elapsed >= 3600.0 * hours or time.monotonic() - self.began >= 3600.0 * wall_hours:
                    self._sample(elapsed)
                    return
                before = self._now
                time.sleep(0.05)
                if self._now == before:
                    self._wait(lambda before=before: self._now != before)

    def _server_is_up(self):
        import rospy

        return self._client.wait_for_server(rospy.Duration(0.01))

    def _begin_course(self, name):
        import rospy
        from std_srvs.srv import Trigger

        import worlds
        from applr_ros1.nodes.tools import send_goal as goal

        self._client.cancel_all_goals()
        rospy.set_param("/sim_bridge/world", name)
        answer = rospy.ServiceProxy("/sim_bridge/load_world", Trigger)()
        assert answer.success, answer.message
        self._course = worlds.load(name).course
        self._client.send_goal(goal.message(goal.course_goal(self._course)))
        self.goals[0] += 1

    def _course_is_over(self, began):
        from actionlib_msgs.msg import GoalStatus

        arrived = self._course.done(*self._position)
        self.goals[1] += arrived
        return (
            arrived
            or self._now - began > LONGEST
            or self._client.get_state() not in (GoalStatus.PENDING, GoalStatus.ACTIVE)
        )

    def _wait(self, condition):
        end = time.monotonic() + SILENCE
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError("soak: the stack has been silent for %g s" % SILENCE)
            time.sleep(0.05)

    def _sample(self, elapsed):
        below = processes_below(self.root)
        known = {row[2]: row[3] for row in self.samples}
        self.ended = sorted(name for name, pid in known.items() if below.get(name) != pid)
        for name, pid in sorted(below.items()):
            found = measure(pid)
            if found is not None:
                row = (round(elapsed, 1), round(time.monotonic() - self.began, 1), name, pid, *found)
                self.samples.append(row)
                with open(self._table, "a") as file:
                    file.write(",".join(map(str, row)) + "\n")


def main(arguments=None):
    """The command. Returns its exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=2.0, help="Simulated hours to drive.")
    parser.add_argument("--wall-hours", type=float, default=24.0, help="Hours of real time after which it ends anyway.")
    parser.add_argument("--out", type=Path, default=Path("soak"), help="Folder for samples.csv and summary.json.")
    parser.add_argument("--most", type=float, default=5.0, help="Growth of one process [MB per hour] that is a leak.")
    parser.add_argument("--simulator", default="kinematic", help="Simulator of the robot: kinematic or pybullet.")
    chosen = parser.parse_args(arguments)
    chosen.out.mkdir(parents=True, exist_ok=True)
    port = processes.free_port()
    environment = dict(os.environ, ROS_MASTER_URI="http://localhost:%d" % port)
    command = ["roslaunch", "--skip-log-check", "-p", str(port), "applr_ros1", "jackal_applr.launch", "goal:=none"]
    command += ["real_time_factor:=0", "simulator:=" + chosen.simulator]
    with open(chosen.out / "launch.log", "wb") as log:
        launch = processes.start(command, environment, log)
    soak = None
    try:
        soak = Soak(port, launch.pid, chosen.out)
        soak.run(chosen.hours, chosen.wall_hours)
    except KeyboardInterrupt:
        pass
    finally:
        processes.stop(launch)
    table = summary(soak.samples if soak else [])
    driven = max((row[0] for row in soak.samples), default=0.0) / 3600.0 if soak else 0.0
    report = {"simulated_hours": round(driven, 3), "goals": soak.goals if soak else [0, 0], "processes": table}
    (chosen.out / "summary.json").write_text(json.dumps(report, indent=1) + "\n")
    print("%.2f simulated hours, %d courses, %d of them to the goal" % (driven, *report["goals"]))
    for name, found in table.items():
        print(
            "%-18s %7.2f MB/h  %6.1f to %6.1f MB  descriptors %s  threads %s"
            % (name, found["mb_per_hour"], found["mb_first"], found["mb_last"], found["descriptors"], found["threads"])
        )
    leaks = [
        name
        for name, found in table.items()
        if found["mb_per_hour"] > chosen.most or found["opening"] or found["restarts"]
    ]
    for name in sorted(set(leaks) | set(soak.ended if soak else [])):
        print(
            "soak: %s ended, grew by more than %g MB per hour, or kept opening descriptors or threads"
            % (name, chosen.most),
            file=sys.stderr,
        )
    return 1 if leaks or not table or soak.ended else 0


if __name__ == "__main__":
    sys.exit(main())
