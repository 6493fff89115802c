"""The teleoperation node: a person drives the robot.

Run by scripts/teleop.py in a terminal, beside the simulated or the real robot; --help lists its parameters. Publishes
cmd_vel (20 Hz) and demonstration (who drives, latched). With the launch argument record:= the drive becomes a bag for
`python -m training.appld BAG`.
"""

import contextlib
import json
import signal
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


class JoyTopic:
    """The topic joy, with axes and buttons as a Joystick has them."""

    def __init__(self):
        self.axes, self.buttons, self._newest = {}, {}, None
        rospy.Subscriber("joy", Joy, lambda message: setattr(self, "_newest", message), queue_size=1)

    def read(self):
        """Whether a message has come since the last call: a topic that falls silent asks for nothing."""
        message, self._newest = self._newest, None
        if message is not None:
            self.axes, self.buttons = dict(enumerate(message.axes)), dict(enumerate(message.buttons))
        return message is not None


class Stick:
    """A Joystick or JoyTopic whose axes and button drive, by their numbers."""

    name = "joystick"

    def __init__(self, device, button, forward, turn):
        self._device, self._button, self._axes = device, button, (forward, turn)

    def poll(self, smoother, now):
        """Hand its position to the smoother. Returns True: it never ends the drive."""
        if self._device.read():
            forward, turn = (self._device.axes.get(number, 0.0) for number in self._axes)
            smoother.stick(forward, turn, self._device.buttons.get(self._button, 0), now)
        return True


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
        raise ApplrError(f"{device.name} is gone ({error.strerror or error})") from None
    finally:
        publisher.publish(twist(0.0, 0.0))
        time.sleep(0.1)  # so that it goes out


def _number(name, default, low, high):
    return number_within(name, rospy.get_param("~" + name, default), low, high)


@contextlib.contextmanager
def _input_device():
    """The keyboard or a joystick."""
    kind, device = rospy.get_param("~input", "keyboard"), str(rospy.get_param("~joystick", ""))
    if kind == "keyboard":
        with Keyboard() as keyboard:
            print(HELP, flush=True)
            yield keyboard
    elif kind == "joystick":
        numbers = (int(_number(*given, 0, 63)) for given in (("button", 4), ("axis_forward", 1), ("axis_turn", 0)))
        yield Stick(Joystick(device) if device else JoyTopic(), *numbers)
    else:
        raise ApplrError(f"input is {kind}: give keyboard or joystick")


def main():
    """Drives until the person ends it."""
    init_node("teleop", disable_signals=True)  # rospy's own would shut the topics before the robot stands
    for number in ENDING:
        if signal.getsignal(number) is not signal.SIG_IGN:  # nohup's SIGHUP
            signal.signal(number, _interrupt)
    smoother = VelocitySmoother(_number("speed", 0.5, 0.05, 2.0), _number("turn", 1.0, 0.1, 4.0))
    with contextlib.suppress(KeyboardInterrupt), _input_device() as device:
        who = rospy.Publisher("demonstration", String, queue_size=1, latch=True)
        who.publish(json.dumps({"demonstrator": f"a person, by {device.name}"}))
        publisher = rospy.Publisher("cmd_vel", Twist, queue_size=1, tcp_nodelay=True)
        rospy.loginfo("teleop: ready, %s", device.name)
        drive(smoother, device, publisher)
    rospy.signal_shutdown("teleop has ended")


def _interrupt(*_):
    for number in ENDING:  # a terminal that is closed sends SIGHUP more than once
        signal.signal(number, signal.SIG_IGN)
    raise KeyboardInterrupt
