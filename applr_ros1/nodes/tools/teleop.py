"""The teleoperation node: a person drives the robot.

Run by scripts/teleop.py in a terminal, beside the simulated or the real robot; --help lists its parameters. Publishes
cmd_vel (20 Hz) and demonstration (who drives, latched). With the launch argument record:= the drive becomes a bag for
`python -m training.appld BAG`.
"""

import contextlib
import json
import signal
import termios
import time

import rospy
from geometry_msgs.msg import Twist
from sensor_msgs.msg import Joy
from std_msgs.msg import String

from applr_ros1.common.arguments import number_within
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.ros_node import init_node
from applr_ros1.nodes.conversions import twist
from applr_ros1.nodes.tools.teleop_input import HELP, Joystick, Keyboard, VelocitySmoother

COMMAND_PERIOD = 0.05  # s of wall time between commands
ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # Ctrl-C, kill, a terminal that is closed

USAGE = f"""usage: teleop.py [_PARAMETER:=VALUE ...]

Drives the robot by hand, with the keyboard or a joystick. move_base commands the same robot, so start it without a goal
(goal:=none); with record:=FILE.bag its launch file records the drive for appld.py. Remap cmd_vel for another topic.

  _input:=keyboard     Input device: keyboard or joystick.
  _joystick:=          Joystick device such as /dev/input/js0; empty reads the topic joy.
  _button:=4           Number of the joystick's button that has to be held to drive.
  _axis_forward:=1     Number of the joystick's axis for the speed.
  _axis_turn:=0        Number of the joystick's axis for the turn rate.
  _speed:=0.5          Forward speed [m/s] at the beginning, 0.05 to 2.
  _turn:=1.0           Turn rate [rad/s] at the beginning, 0.1 to 4.

Keys:
{HELP}"""


class InputDevice:
    """The keyboard, a joystick device or the topic joy.

    Args:
        kind: "keyboard" or "joystick".
        device: A joystick device such as /dev/input/js0; "" takes the topic joy.
        button: Number of the button that has to be held to drive.
        forward: Number of the axis for the speed.
        turn: Number of the axis for the turn rate.
    """

    def __init__(self, kind, device, button, forward, turn):
        self.kind, self.keyboard, self.joystick, self._joy = kind, None, None, None
        self.button, self.forward, self.turn = button, forward, turn
        if kind == "keyboard":
            self.keyboard = Keyboard()
        elif device:
            self.joystick = Joystick(device)
        else:
            rospy.Subscriber("joy", Joy, self._on_joy, queue_size=1)

    def _on_joy(self, message):
        self._joy = message

    def poll(self, smoother, now):
        """Hand what was pressed since the last call to the smoother. Returns False when the person ends the drive."""
        if self.keyboard:
            return all([smoother.key(key, now) for key in self.keyboard.read()])
        if self.joystick:
            self.joystick.read()
            stick = self.joystick
            smoother.stick(
                stick.axes.get(self.forward, 0.0),
                stick.axes.get(self.turn, 0.0),
                stick.buttons.get(self.button, 0),
                now,
            )
            return True
        message, self._joy = self._joy, None
        if message is not None:
            smoother.stick(
                _at(message.axes, self.forward), _at(message.axes, self.turn), _at(message.buttons, self.button), now
            )
        return True

    def __enter__(self):
        if self.keyboard:
            self.keyboard.__enter__()
        return self

    def __exit__(self, *exc):
        if self.keyboard:
            with contextlib.suppress(termios.error):  # the terminal is gone
                self.keyboard.__exit__(*exc)
        if self.joystick:
            self.joystick.close()


def _at(values, number):
    return values[number] if 0 <= number < len(values) else 0.0


def drive(smoother, device, publisher):
    """Until the person ends it. Whatever happens, the last command is to stand. Raises ApplrError."""
    last = time.monotonic()
    try:
        while not rospy.is_shutdown():
            now = time.monotonic()
            if not device.poll(smoother, now):
                return
            publisher.publish(twist(*smoother.command(now, min(now - last, 0.2))))
            last = now
            time.sleep(COMMAND_PERIOD)
    except OSError as error:
        raise ApplrError(f"{device.kind} is gone ({error.strerror or error})") from None
    finally:
        publisher.publish(twist(0.0, 0.0))
        time.sleep(0.1)  # so that it goes out


def _number(name, default, low, high):
    return number_within(name, rospy.get_param("~" + name, default), low, high)


def _input_device():
    kind, device = rospy.get_param("~input", "keyboard"), str(rospy.get_param("~joystick", ""))
    if kind not in ("keyboard", "joystick"):
        raise ApplrError(f"input is {kind}: give keyboard or joystick")
    numbers = [
        int(_number(name, default, 0, 63)) for name, default in (("button", 4), ("axis_forward", 1), ("axis_turn", 0))
    ]
    try:
        return InputDevice(kind, device, *numbers)
    except OSError as error:
        what = f"joystick {device} cannot be opened ({error.strerror})" if device else str(error)
        raise ApplrError(what) from None


def main():
    """Drives until the person ends it."""
    init_node("teleop", disable_signals=True)  # rospy's own would shut the topics before the robot stands
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup's SIGHUP
            signal.signal(number, _interrupt)
    smoother = VelocitySmoother(_number("speed", 0.5, 0.05, 2.0), _number("turn", 1.0, 0.1, 4.0))
    with contextlib.suppress(KeyboardInterrupt), _input_device() as device:
        who = rospy.Publisher("demonstration", String, queue_size=1, latch=True)
        who.publish(json.dumps({"demonstrator": f"a person, by {device.kind}"}))
        publisher = rospy.Publisher("cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
        if device.keyboard:
            print(HELP, flush=True)
        rospy.loginfo("teleop: ready, %s", device.kind)
        drive(smoother, device, publisher)
    rospy.signal_shutdown("teleop has ended")


def _interrupt(*_):
    for number in ENDING:  # a terminal that is closed sends SIGHUP more than once
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
