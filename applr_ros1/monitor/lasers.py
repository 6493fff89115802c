"""Lasers of a robot, by topic and frame: which of them must send scans, and what each has seen.

CollisionMonitor holds one Lasers. Lasers that share a topic are told apart by their frames.
"""

from typing import Iterable, Iterator, List, Optional

from applr_ros1.common.scan import LaserScan
from applr_ros1.monitor.known_space import ObstacleMemory
from applr_ros1.monitor.scanner import ScannerCheck
from applr_ros1.monitor.settings import MonitorSettings
from applr_ros1.movers.tracker import NO_MOVERS, MoverTracker

# Number of scans after which a laser belongs to the robot: if it falls silent, the robot stops.
ESTABLISHED_SCANS = 50
LET_GO_S = 5.0  # silence after which a laser that has sent fewer scans is let go [s]


class WatchedLaser:
    """State of one laser: obstacle memory, tracker, fault check, and its latest scan.

    Attributes:
        topic: name of its topic, "" for that of the robot's first laser.
        frame: frame of its scans, None before the first one.
        words: its scan in messages, such as "scan", "scan on rear" or "scan of frame laser_2".
        stamp: stamp of the latest valid scan [s], None before the first one.
        fault: fault of the latest scan, "" if there is none.
        latest: stamp of the latest scan, valid or not [s], None before the first one.
        count: number of scans since the start.
        tracker: tracker of what moves in its scans.
        movers: moving obstacles of the latest valid scan whose velocities are certain, in the
            odometry's frame.
    """

    def __init__(self, settings: MonitorSettings, topic: str, frame: Optional[str] = None):
        self.topic = topic
        self.frame = frame
        self.words = f"scan on {topic}" if topic else "scan"
        self.memory = ObstacleMemory(settings.memory_radius, settings.memory_seconds)
        self.check = ScannerCheck()
        limits = settings.max_speed, settings.max_yaw_rate, settings.scan_period
        self.tracker = MoverTracker(*limits)
        self.count = 0
        self.clear()

    def clear(self) -> None:
        """Forget the scans."""
        self.forget_place()
        self.forget_tracks()
        self.check.clear()
        self.stamp: Optional[float] = None
        self.latest: Optional[float] = None
        self.fault = "no scan has arrived yet"

    def forget_place(self) -> None:
        """Forget what was seen, because the robot is elsewhere.

        Tracks end by themselves. If a large obstacle that moves made the scan look like another
        place, its track is still needed.
        """
        self.memory.clear()

    def forget_tracks(self) -> None:
        """Forget what moves, because poses are corrected anew."""
        self.tracker.reset()
        self.movers = NO_MOVERS


class Lasers:
    """All lasers that must send scans, the first one first.

    Each topic has a laser from the start. A scan of another frame on the topic adds a further one.
    A laser that falls silent stops the robot. But one that has sent only a few scans may be
    another program's, so that it is let go when a laser of the same topic goes on without it.

    Args:
        settings: settings of the monitor.
        more_topics: names of further lasers' topics; that of the robot's first laser is "".
    """

    def __init__(self, settings: MonitorSettings, more_topics: Iterable[str]):
        self._settings = settings
        self._lasers = [WatchedLaser(settings, topic) for topic in ("", *more_topics)]

    def __iter__(self) -> Iterator[WatchedLaser]:
        return iter(self._lasers)

    @property
    def first(self) -> WatchedLaser:
        """The robot's first laser, which corrects the pose."""
        return self._lasers[0]

    def clear(self) -> None:
        """Forget all scans, and the further lasers that have sent only a few."""
        for laser in list(self._lasers):
            laser.clear()
            is_further = laser is not self._of_topic(laser.topic)[0]
            if is_further and laser.count < ESTABLISHED_SCANS:
                self._lasers.remove(laser)

    def of(self, scan: LaserScan, topic: str) -> WatchedLaser:
        """Return the laser of a scan. An unknown topic or frame adds a laser."""
        of_topic = self._of_topic(topic)
        for laser in of_topic:
            if laser.frame in (None, scan.frame):
                laser.frame = scan.frame
                return laser
        laser = WatchedLaser(self._settings, topic, scan.frame)
        if of_topic:
            laser.words += f" of frame {scan.frame}"
        self._lasers.append(laser)
        return laser

    def let_go(self, laser: WatchedLaser) -> List[WatchedLaser]:
        """Remove and return the strays on a laser's topic, after its latest scan.

        A stray has sent fewer than ESTABLISHED_SCANS scans, and none for LET_GO_S.
        """
        latest = laser.latest
        if latest is None or laser.count < ESTABLISHED_SCANS:
            return []
        strays = []
        of_topic = self._of_topic(laser.topic)
        for other in of_topic:
            if other.latest is None:
                other.latest = latest  # It has been silent since the reset: count from here.
            is_silent = latest - other.latest > LET_GO_S
            if is_silent and other.count < ESTABLISHED_SCANS:
                strays.append(other)
        first_laser = of_topic[0]
        if first_laser in strays:
            # The stray has sent the first scan on the topic: this laser takes its place.
            laser.words = first_laser.words
            self._lasers.remove(laser)
            self._lasers.insert(self._lasers.index(first_laser), laser)
        for stray in strays:
            self._lasers.remove(stray)
        return strays

    def _of_topic(self, topic: str) -> List[WatchedLaser]:
        return [laser for laser in self._lasers if laser.topic == topic]
