"""The viewer's tabs Replay and Bags: the time line of a bag that is played, and which bags there are to play."""

from __future__ import annotations

import glob
import os
import time
from typing import Any, Callable

import rospy
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from applr_ros1.common.errors import ApplrError
from applr_ros1.nodes.tools.replay import DECISIONS, LENGTH, PAUSE, RATE, SEEK, START, replayed

from .listening import TOUCHED, Say, ask, by_hand, show, tell

PLAYED = "/play/arguments"  # parameter: what ./applr play was called with; it starts anew with what is put there
FOLDER = "APPLR_PLAY_FOLDER"  # environment variable: where ./applr play was called
RATES = ("0.25", "0.5", "1", "2", "4")
END = 0.3  # s before the last message, from which on the bag counts as over
AGAIN = 2.0  # wall seconds between two looks into the folder


class Replay:
    """The time line of the bag that the node replay plays: play, pause, seek, speed.

    Attributes:
        next: What the button does next: Pause, Play or Again.
    """

    def __init__(self, gui: Any, say: Say):
        while not rospy.has_param(LENGTH) and not rospy.is_shutdown():
            time.sleep(0.1)
        self._say, self._start, self._length = say, rospy.get_param(START), rospy.get_param(LENGTH)
        self._seek = rospy.Publisher(SEEK, Float64, queue_size=1)
        self._speed = rospy.Publisher(RATE, Float64, queue_size=1)
        self._paused, self._touched, self.next = False, False, "Pause"
        marks = tuple(rospy.get_param(DECISIONS))
        hint = "Dots: where the policy changed a parameter."
        self._line = gui.add_slider("time [s]", 0.0, self._length, 0.1, initial_value=0.0, marks=marks, hint=hint)
        by_hand(self._line, self._touch)
        self._rate = gui.add_dropdown("speed", RATES, initial_value="1")
        by_hand(self._rate, lambda rate: self._set(self._speed, float(rate)))

    def _touch(self, _: float) -> None:
        self._touched = True

    def _set(self, publisher: Any, value: float) -> Any:
        self._paused = False
        tell(self._say, publisher, value)

    def play(self) -> None:
        """Pause, go on, or begin again at the end."""
        if self.next == "Again":
            self._set(self._seek, 0.0)
        elif ask(self._say, PAUSE, SetBool, not self._paused):
            self._paused = not self._paused

    def look(self) -> None:
        """Bring the time line up to date, or the bag to where a person has put it."""
        if self._touched and time.time() - self._line.update_timestamp > TOUCHED:
            self._touched = False
            self._set(self._seek, self._line.value)
        elif not self._touched:
            show(self._line, round(min(max(rospy.get_time() - self._start, 0.0), self._length), 1))
        over = self._line.value >= self._length - END
        self.next = "Again" if over else "Play" if self._paused else "Pause"


class Bags:
    """The bags of a folder. restart: as Viewer.restart; replay: whether one is played now; say: shows a line."""

    def __init__(self, gui: Any, folder: str, restart: Callable[..., bool], replay: bool, say: Say):
        self._folder, self._restart, self._say, self._looked = folder, restart, say, 0.0
        gui.add_markdown(f"Bags in `{folder}`. `./applr play record:=drive.bag` records one until Ctrl-C.")
        self._bags = gui.add_dropdown("bag", ("",))
        self._open = gui.add_button("open")
        self._open.on_click(lambda _: self._play(os.path.join(folder, self._bags.value)))
        if replay:
            gui.add_button("drive").on_click(lambda _: restart("The robot", bag="none"))

    def _play(self, bag: str) -> None:
        try:
            replayed(bag)
        except ApplrError as problem:
            self._say(str(problem))
            return
        self._restart(os.path.basename(bag), bag=bag)

    def look(self) -> None:
        """Take in which bags there are."""
        if time.monotonic() - self._looked > AGAIN:
            self._looked = time.monotonic()
            names = tuple(sorted(os.path.basename(path) for path in glob.glob(os.path.join(self._folder, "*.bag"))))
            if names != self._bags.options:
                self._bags.options = names or ("",)
            self._bags.visible = self._open.visible = bool(names)
