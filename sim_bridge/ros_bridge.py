"""The node /sim_bridge: a simulated robot with the ROS interface of the real one.

Started as `rosrun applr_ros1 sim_bridge.py`.

Publishes, under the names in the robot's description, here the Jackal's: /clock (100 Hz); front/scan at the laser's
rate; odometry/filtered, /tf, /tf_static, imu/data, joint_states, collision, ~collision, ~ground_truth (frame world) at
the odometry's; ~obstacles (latched), ~movers. Subscribes: cmd_vel and ROBOT_velocity_controller/cmd_vel (the newest
command counts).
Services: ~reset (robot and odometry back to the start, costmaps cleared), ~load_world (the world that the parameter
~world names). Parameters: ~robot (name or folder of a description), ~world, ~simulator, ~seed, ~real_time_factor;
~start ("x y yaw" in the world, instead of the course's), ~paused (begin with the time standing),
~gazebo (Gazebo's services too: ros_gazebo.py); ~tf_prefix (in front of the names of all frames of the robot), ~map
(publish a map of the world on map, latched, and its frame).

One thread runs the simulation; callbacks only store what arrived. ROS time never goes back, not even at a reset.
"""

from __future__ import annotations

import gc
import threading
import time
from math import isfinite
from typing import Any

import rospy
from geometry_msgs.msg import Twist
from std_srvs.srv import Empty, EmptyResponse, Trigger, TriggerResponse

import worlds
from applr_ros1.common.arguments import frame_prefix, number_within, pose
from applr_ros1.common.progress import announced
from applr_ros1.common.ros_node import init_node, until_shutdown
from applr_ros1.robots import load

from . import make
from .ros_topics import BridgeTopics
from .simulator import warm_up

TICK_S = 0.01  # simulated seconds between clocks; data every second one
BASE_TIME_S = 1.0  # ROS time [s] at which the first world begins (ROS takes 0 for "no time")
CONTROL_FREQUENCY_HZ = 20.0  # Hz of a planner that states none, for the lock-step of real_time_factor 0
PATIENCE_S = 0.25  # wall seconds that the lock-step waits for a command
IDLE_FACTOR = 1.0  # the factor used in place of 0 while no commands come, so that planning has its usual time


class Bridge:
    """The node's state: the simulator, the newest velocity command and ROS time."""

    def __init__(self):
        factor, seed = rospy.get_param("~real_time_factor", 1.0), rospy.get_param("~seed", 0)
        self.factor = number_within("real_time_factor", factor, 0, 1e6)  # 0: as fast as it goes
        self.seed = int(number_within("seed", seed, 0, 2**31 - 1))
        name = rospy.get_param("~simulator", "pybullet")
        self.base_time = BASE_TIME_S
        with_map = bool(rospy.get_param("~map", False))
        robot = load(str(rospy.get_param("~robot", "jackal")), with_map=with_map)
        self.scale = robot.world_scale
        world = self._load(str(rospy.get_param("~world", "generated:0")))
        self.simulator = make(name, robot)
        start = str(rospy.get_param("~start", ""))
        self.start = pose("start", start) if start else None
        compiling = "compiling the simulator's kernels (half a minute, the first time on this machine)"
        with announced(compiling, rospy.loginfo):
            warm_up(self.simulator, world)
        self.lock = threading.Lock()  # of the simulator
        self.arrived = threading.Condition()  # of the next four
        self.newest = None  # newest command (v, w) not yet given to the simulator
        self.driven = False  # whether velocity commands come in
        self.period, self.due = 0.0, 0.0  # of the commands [s]; simulated time at which the next one is due
        self.touched = False
        self.running = threading.Event()  # simulated time goes on
        if not rospy.get_param("~paused", False):
            self.running.set()
        prefix = frame_prefix(str(rospy.get_param("~tf_prefix", "")))
        self.topics = BridgeTopics(robot, prefix, with_map)
        self.simulator.reset(world, self.seed, self.start)
        self.topics.publish_world(self.simulator, self.stamp())
        if rospy.get_param("~gazebo", False):
            from .ros_gazebo import GazeboInterface  # needs gazebo_msgs, which a robot does not have

            GazeboInterface(self)
        self._connect()
        if not rospy.get_param("/use_sim_time", False):
            rospy.logwarn(
                "sim_bridge: /use_sim_time is not true: nodes that take the computer's time find scans and transforms "
                "too old; rosparam set /use_sim_time true, then start them"
            )
        counts = f"{len(world.cylinders)} cylinders, {len(world.boxes)} boxes, {len(world.movers)} moving"
        run = f"simulator {name}, seed {self.seed}, real time factor {self.factor:g}"
        rospy.loginfo(f"sim_bridge: ready: world {world.name} ({counts}), {run}")

    def _connect(self):
        robot = self.simulator.robot
        for topic in (robot.topics.cmd_vel, robot.name + "_velocity_controller/cmd_vel"):
            rospy.Subscriber(topic, Twist, self.on_command, queue_size=1, buff_size=2**16, tcp_nodelay=True)
        rospy.Service("~reset", Empty, lambda _: self._restart() or EmptyResponse())
        rospy.Service("~load_world", Trigger, self.on_load_world)

    def _load(self, spec):
        """Return a world at the robot's scale."""
        return worlds.scaled(worlds.load(spec), self.scale)

    def stamp(self) -> rospy.Time:
        """Return the ROS time of the simulator's present state."""
        return rospy.Time.from_sec(self.base_time + self.simulator.state.time)

    # -- the simulating thread ---------------------------------------------------------------------
    @until_shutdown()
    def spin(self) -> None:
        """Simulate and publish until the node is shut down."""
        pace, ticks, robot = RealTimeRate(), 0, self.simulator.robot
        every, every_scan = (max(1, round(1.0 / TICK_S / rate)) for rate in (robot.odometry.rate, robot.laser.rate))
        while not rospy.is_shutdown():
            if not self.running.is_set():
                self.running.wait(0.02)
                pace.begin()
                continue
            ticks += 1
            with self.lock:
                self._take_command()
                state = self.simulator.advance(TICK_S)
                self.touched |= state.contact
                stamp = self.stamp()
                if ticks % every == 0:
                    self.topics.publish_state(state, stamp, self.touched)
                    self.touched = False
                if ticks % every_scan == 0:
                    self.topics.publish_scan(self.simulator.scan(), stamp)
                if ticks % 10 == 0:
                    self.topics.publish_movers(self.simulator, stamp)
                self.topics.publish_clock(stamp)
            if self.factor == 0.0:
                self._lock_step()
                if self.driven:
                    pace.begin()
                else:
                    pace.wait(TICK_S, IDLE_FACTOR, False)
            else:
                pace.wait(TICK_S, self.factor)

    def _take_command(self):
        with self.arrived:
            command, self.newest = self.newest, None
        if command is not None:
            self.simulator.command(*command)
            now = self.simulator.state.time
            self.due = self.period + (self.due if now <= self.due <= now + 0.5 * self.period else now)

    def _lock_step(self):
        """Wait for the planner's next command once it is due.

        So the simulation runs as fast as it can without running ahead of the planner. It waits at most PATIENCE_S; if
        nothing comes, it does not wait again before the next command.
        """
        if self.driven and self.simulator.state.time > self.due - 1e-6:
            with self.arrived:
                self.driven = self.arrived.wait_for(lambda: self.newest is not None, PATIENCE_S)

    # -- callbacks ---------------------------------------------------------------------------------
    def on_command(self, message: Any) -> None:
        """Store a velocity command for the simulating thread; refuse one that is not finite."""
        v, w = message.linear.x, message.angular.z
        if not (isfinite(v) and isfinite(w)):
            rospy.logwarn_throttle(5.0, f"sim_bridge: velocity command ({v:g}, {w:g}) refused: it must be finite")
            return
        if not self.driven:  # who commands from now on may do so at another rate
            self.period = 1.0 / float(rospy.get_param("move_base/controller_frequency", CONTROL_FREQUENCY_HZ))
        with self.arrived:
            self.newest, self.driven = (v, w), True
            self.arrived.notify()

    # -- for Gazebo's services ------------------------------------------------------------------------
    def pause(self) -> None:
        """Stop simulated time. Returns when the step under way is over."""
        self.running.clear()
        with self.lock:
            pass

    def unpause(self) -> None:
        """Let simulated time go on."""
        self.running.set()

    def teleport(self, pose: Any) -> None:
        """Put the robot at pose (x, y, yaw) of the world, standing, while time goes on."""
        with self.lock:
            self.simulator.teleport(pose)
            self.touched = False
            self.topics.publish_frames(self.simulator, self.stamp())

    def on_load_world(self, _: Any) -> TriggerResponse:
        """Service ~load_world: change to the world that the parameter ~world names."""
        try:
            world = self._load(str(rospy.get_param("~world", "")))
        except (ValueError, OSError) as error:
            rospy.logerr("sim_bridge: world stays %s: %s", self.simulator.world.name, error)
            return TriggerResponse(False, str(error))
        self._restart(world)
        rospy.loginfo("sim_bridge: world %s", world.name)
        return TriggerResponse(True, f"world {world.name}")

    def _restart(self, world=None):
        """Begin anew in `world`; without one in the present world, under the next seed."""
        with self.lock:
            if world is None:
                world, self.seed = self.simulator.world, self.seed + 1
            else:
                self.start = None  # that of the new world's course
            self.base_time += self.simulator.state.time + TICK_S
            with self.arrived:
                self.newest, self.driven, self.due = None, False, 0.0
            state = self.simulator.reset(world, self.seed, self.start)
            self.touched = False
            self.topics.publish_world(self.simulator, self.stamp())
            self.topics.publish_state(state, self.stamp(), False)
            self.topics.publish_scan(self.simulator.scan(), self.stamp())
            self.topics.publish_clock(self.stamp())
        time.sleep(0.05)  # scans from the old place pass before the maps are cleared
        _clear_costmaps()


class RealTimeRate:
    """Keeps simulated and wall time in step."""

    def __init__(self):
        self.begin()

    def begin(self) -> None:
        """Count time from now on."""
        self.next = time.monotonic()

    def wait(self, simulated: float, factor: float, report: bool = True) -> None:
        """Sleep until wall time has caught up; a delay of more than .2 s is given up and reported."""
        now = time.monotonic()
        self.next += simulated / factor
        if self.next > now:
            time.sleep(self.next - now)
        elif now - self.next > 0.2:
            self.next = now
            if report:
                busy = f"this machine is too busy for real_time_factor {factor:g}: the simulation runs slower"
                rospy.logwarn_throttle(60.0, "sim_bridge: " + busy)


def _clear_costmaps():
    """Ask move_base, if there is one, to clear its costmaps."""
    name = rospy.resolve_name("move_base/clear_costmaps")
    try:
        rospy.wait_for_service(name, 0.1)
        rospy.ServiceProxy(name, Empty)()
    except rospy.ROSException:
        pass  # no move_base: nothing to clear
    except rospy.ServiceException as error:
        rospy.logwarn("sim_bridge: costmaps not cleared: %s", error)


def main() -> int:
    """Runs until shutdown."""
    init_node("sim_bridge")
    bridge = Bridge()
    gc.collect()
    gc.freeze()  # what is loaded by now stays: looking through it again would hold the clock up for 100 ms
    # Not in the main thread: rospy shuts down in the signal's handler there, which would wait for the very lock
    # that an interrupted publish() holds.
    spinning = threading.Thread(target=bridge.spin, daemon=True)
    spinning.start()
    while spinning.is_alive():
        spinning.join(0.5)  # a signal that another thread was given is noticed in between alone
    return 0 if rospy.core.is_shutdown_requested() else 1
