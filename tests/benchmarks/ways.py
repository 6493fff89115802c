"""Code paths of a scan, a decision and a transition through the source files. Called by run.py.

The count covers Python functions of the package without ROS: their files, and the moves, which are calls from one file
into another. Compiled kernels count with the file that calls them. The path of a transition is counted only in
training/, because driving is covered by scan and decision.
"""

import sys
import tempfile
from pathlib import Path

import sim_bridge
import worlds
from applr_ros1 import robots
from applr_ros1.planner.move_base import MoveBase
from applr_ros1.policy import methods
from tests.support import ROOT
from tests.support.jackal import JACKAL
from training import train
from training.env.episode import Episode

TRAINING = (str(ROOT / "training"),)
PACKAGES = tuple(str(ROOT / name) for name in ("applr_ros1", "sim_bridge", "training", "worlds"))
COURSE = "generated:140"


class Way:
    """Profiler of calls while it is active: from the first call of `begin` to the first return of `end`.

    Args:
        begin: (file below the repository, function), or None to begin at the start.
        end: (file below the repository, function), or None to end with the with block.
        packages: folders whose files count.
    """

    def __init__(self, begin=None, end=None, packages=PACKAGES):
        self._begin, self._end, self._packages = begin, end, packages
        self._on = begin is None
        self.files, self.moves = set(), 0

    def __enter__(self):
        sys.setprofile(self._count)
        return self

    def __exit__(self, *_):
        sys.setprofile(None)

    def _count(self, frame, event, _):
        path = frame.f_code.co_filename
        if event not in ("call", "return") or not path.startswith(self._packages):
            return
        place = str(Path(path).relative_to(ROOT)), frame.f_code.co_name
        self._on |= event == "call" and place == self._begin
        if self._on and event == "call":
            self.files.add(path)
            self.moves += frame.f_back is not None and frame.f_back.f_code.co_filename not in (path, __file__)
        if event == "return" and place == self._end:
            self._on, self._begin = False, None

    def figure(self):
        """Return the number of files, and the text that run.py prints after it."""
        return len(self.files), "files, %d moves between them" % self.moves


def make_episode(simulator, move_base=None, period=2.0, **options):
    move_base = move_base or MoveBase(dict(JACKAL, planner_frequency=20.0))
    return Episode(sim_bridge.make(simulator), move_base, period=period, **options)


def _driving():
    policy = methods.make("applr", robots.JACKAL)
    episode = make_episode("kinematic", period=policy.period, monitor=True)
    episode.layout = policy.layout
    episode.reset(worlds.load(COURSE), seed=0)
    episode.decide(policy.theta(episode.context()))
    return episode, policy


def way_of_scan():
    """Count from the laser's ranges to the simulated base: costmaps, a new plan, the local plan, the monitor."""
    episode, _ = _driving()
    with Way() as way:
        episode._cycle()
    return way.figure()


def way_of_decision():
    """Count from scan and plan through observation and policy to the parameters in force."""
    episode, policy = _driving()
    with Way() as way:
        episode.apply(policy.theta(episode.context()))
    return way.figure()


def way_of_transition():
    """Count from the episode that an actor drives to the end of the networks' first update, with --actors 0."""
    options = "--recipe jackal --actors 0 --total-timesteps 1 --learning-starts 1 --batch-size 1 --worlds generated:140"
    way = Way(("training/workers/collect.py", "collect"), ("training/td3/td3.py", "update"), TRAINING)
    with tempfile.TemporaryDirectory() as folder, way:
        train.main([*options.split(), "--simulator", "kinematic", "--eval-worlds", COURSE, "--out", folder])
    return way.figure()
