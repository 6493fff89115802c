"""Keyboard and joystick for the teleoperation node (teleop.py), and the smoothing of the velocities that they ask for.

Nothing here knows ROS; time is an argument.
"""

import contextlib
import os
import re
import select
import struct
import sys
import termios
import tty

from applr_ros1.common.errors import ApplrError

SPECIAL_KEY = re.compile(r"\x1b(\[[0-9;?]*[ -/]*[@-~]|O[@-~])")  # what an arrow or function key sends; Esc alone is not
KEYS = {
    "i": (1, 0),
    "u": (1, 1),
    "o": (1, -1),
    "j": (0, 1),
    "l": (0, -1),
    "k": (0, 0),
    " ": (0, 0),
    ",": (-1, 0),
    "m": (-1, -1),
    ".": (-1, 1),
}  # forward, left; as teleop_twist_keyboard has them
FASTER = {
    "w": (1.1, 1.0),
    "x": (1 / 1.1, 1.0),
    "e": (1.0, 1.1),
    "c": (1.0, 1 / 1.1),
    "q": (1.1, 1.1),
    "z": (1 / 1.1, 1 / 1.1),
}
QUIT = "\x1b\x03\x04"  # Esc, Ctrl-C, Ctrl-D
HELP = """  u i o     forward, turning left, straight, turning right      w / x   more / less speed
  j k l     turn left, stop, turn right                         e / c   more / less turn rate
  m , .     backward, turning, straight, turning                Esc     end
Hold a key to drive. The robot stops when it is released."""
HELD = 0.6  # s for which the last key or stick position counts: a terminal repeats a held key late
SPEED, TURN = (0.05, 2.0), (0.1, 4.0)  # bounds of what keys may set [m/s, rad/s]
GAIN, BRAKE, TURN_GAIN = 1.0, 2.0, 6.0  # of the smoothed command [m/s^2, m/s^2, rad/s^2]
DEAD = 0.08  # share of a stick's range about its middle that counts as 0


class VelocitySmoother:
    """Turns keys or stick positions into velocity commands within acceleration limits.

    Args:
        speed: What a key, or a fully deflected stick, asks for [m/s].
        turn: The same for the turn rate [rad/s].
    """

    def __init__(self, speed=0.5, turn=1.0):
        self.speed, self.turn = _within(speed, SPEED), _within(turn, TURN)
        self.v = self.w = 0.0
        self._target, self._received = (0.0, 0.0), float("-inf")

    def key(self, key, now):
        """A key was pressed at time `now` [s]. Returns False for a key that ends the drive."""
        if key in QUIT:
            self._target = (0.0, 0.0)
            return False
        if key in FASTER:
            faster, quicker = FASTER[key]
            self.speed, self.turn = _within(self.speed * faster, SPEED), _within(self.turn * quicker, TURN)
        elif key in KEYS:
            self._target, self._received = KEYS[key], now
        return True

    def stick(self, forward, left, held, now):
        """A joystick's position at time `now` [s]: forward and left in [-1, 1]; 0 while no button is held."""
        live = held and abs(forward) <= 1.001 and abs(left) <= 1.001  # NaN is neither
        self._target = (_dead(forward), _dead(left)) if live else (0.0, 0.0)
        self._received = now

    def command(self, now, dt):
        """The command (v, w) [m/s, rad/s] at time `now` [s], `dt` [s] after the previous one."""
        forward, left = self._target if now - self._received < HELD else (0.0, 0.0)
        if not (forward or left):
            self._target = (0.0, 0.0)
        v, w = forward * self.speed, left * self.turn
        gain = GAIN if abs(v) > abs(self.v) and v * self.v >= 0.0 else BRAKE
        self.v += max(-gain * dt, min(gain * dt, v - self.v))
        self.w += max(-TURN_GAIN * dt, min(TURN_GAIN * dt, w - self.w))
        return self.v, self.w


class Keyboard:
    """The terminal, key by key. Context manager; raises ApplrError where standard input is no terminal."""

    name = "keyboard"

    def __init__(self, stream=sys.stdin):
        self.file = stream.fileno()
        if not os.isatty(self.file):
            raise ApplrError("standard input is no terminal: start it with rosrun in one, or take _input:=joystick")

    def __enter__(self):
        self._before = termios.tcgetattr(self.file)
        tty.setcbreak(self.file)
        return self

    def __exit__(self, *exc):
        with contextlib.suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(self.file, termios.TCSADRAIN, self._before)

    def poll(self, smoother, now):
        """Hand the keys typed since the last call to the smoother. Returns False when the person ends the drive."""
        return all([smoother.key(key, now) for key in self.read()])

    def read(self):
        """The characters typed since the last call; "" for none."""
        typed = b""
        while select.select([self.file], [], [], 0.0)[0]:
            more = os.read(self.file, 64)
            if not more:
                return QUIT[0]  # the terminal is gone
            typed += more
        return SPECIAL_KEY.sub("", typed.decode("ascii", "ignore"))


class Joystick:
    """A Linux joystick device (/dev/input/js0), read directly.

    axes, buttons: {number: value}, an axis in [-1, 1] with forward and left positive, as ROS's joy node has them.
    """

    EVENT = struct.Struct("<IhBB")

    def __init__(self, path):
        self.path = path
        self.file = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        self.axes, self.buttons = {}, {}

    def read(self):
        """Update axes and buttons with the events since the last call. True; raises OSError when the device is gone."""
        while True:
            try:
                data = os.read(self.file, 64 * self.EVENT.size)
            except BlockingIOError:
                return True
            for at in range(0, len(data) - self.EVENT.size + 1, self.EVENT.size):
                _, value, kind, number = self.EVENT.unpack_from(data, at)
                if kind & 0x02:
                    self.axes[number] = -value / 32767.0
                elif kind & 0x01:
                    self.buttons[number] = value
            if len(data) < 64 * self.EVENT.size:
                return True


def _dead(value):
    return float(value) if abs(value) > DEAD else 0.0


def _within(value, bounds):
    return min(bounds[1], max(bounds[0], float(value)))
