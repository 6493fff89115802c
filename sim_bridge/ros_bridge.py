"""Node /sim_bridge: a simulated robot with the ROS interface of the real robot.

Start it with `rosrun applr_ros1 sim_bridge.py`. Names come from the robot's description; these are
the Jackal's.

Published topics: /clock (100 Hz); front/scan at the laser's rate; odometry/filtered, /tf,
/tf_static, imu/data, collision, ~collision, ~ground_truth (frame world) at the odometry's rate;
~obstacles (latched), ~movers.
Subscribed topics: cmd_vel and ROBOT_velocity_controller/cmd_vel (the latest command counts).
Services: ~reset (moves robot and odometry back to the start and clears the costmaps), ~load_world
(loads the world named by the parameter ~world).
Parameters: ~robot (name or folder of a description), ~world, ~simulator, ~seed, ~real_time_factor,
~start ("x y yaw" in the world frame instead of the start of the course), ~paused (start with the
time stopped), ~gazebo (offer the services of ros_gazebo.py), ~tf_prefix (prefix of all frames of
the robot), ~map (publish a latched map of the world on map, and its frame).

One thread runs the simulation, and callbacks only store messages. ROS time never goes back, not
even at a reset.
"""

from __future__ import annotations

import gc
import threading
import time
from math import isfinite
from typing import Any, Optional, Sequence, Tuple

import rosgraph
import rospy
from geometry_msgs.msg import Twist as TwistMessage
from std_srvs.srv import Empty, EmptyResponse, Trigger, TriggerResponse

import worlds
from applr_ros1.common.angles import Twist
from applr_ros1.common.arguments import frame_prefix, number_within, pose
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.messages import twist_of
from applr_ros1.common.progress import announced
from applr_ros1.common.ros_node import command_topic, init_node, until_shutdown
from applr_ros1.robots import load
from applr_ros1.robots.robot_world import world_of

from . import make
from .ros_topics import BridgeTopics
from .simulator import warm_up

TICK_S = 0.01  # simulated time between two clock messages [s]
# ROS time at the start of the first world, not 0 because ROS reads 0 as "no time" [s]
BASE_TIME_S = 1.0
# Default frequency of commands in the lock-step of real_time_factor 0 [Hz]
CONTROL_FREQUENCY_HZ = 20.0
PATIENCE_S = 0.25  # longest wall time for which the lock-step waits for a command [s]
MOVERS_HZ = 10.0  # rate of ~movers [Hz]
LARGEST_DELAY_S = 0.2  # largest delay of simulated time that is caught up by running faster [s]
# Real-time factor instead of 0 while no commands arrive, so that planning gets its usual time
IDLE_FACTOR = 1.0


class Bridge:
    """State of the node: simulator, latest velocity command and ROS time."""

    def __init__(self) -> None:
        # Parameters, robot and world. A mistake in them ends the node before it publishes anything.
        time_factor = rospy.get_param("~real_time_factor", 1.0)
        # A factor of 0 means as fast as possible.
        self.factor = number_within("real_time_factor", time_factor, 0, 1e6)
        self.seed = int(number_within("seed", rospy.get_param("~seed", 0), 0, 2**31 - 1))
        simulator_name = rospy.get_param("~simulator", "pybullet")
        self.base_time = BASE_TIME_S
        with_map = bool(rospy.get_param("~map", False))
        robot = load(str(rospy.get_param("~robot", "jackal")), with_map=with_map)
        world = world_of(str(rospy.get_param("~world", "generated:0")), robot)
        self.simulator = make(simulator_name, robot)
        start_text = str(rospy.get_param("~start", ""))
        self.start = pose("start", start_text) if start_text else None
        compiling = "compiling the simulator's kernels (half a minute, the first time on a machine)"
        with announced(compiling, rospy.loginfo):
            warm_up(self.simulator, world)

        # State that the simulation thread and the callbacks share
        self.lock = threading.Lock()  # protects the simulator
        self.arrived = threading.Condition()  # protects the next four attributes
        # Latest command (v, w) that the simulator has not yet received [m/s, rad/s]
        self.newest: Optional[Twist] = None
        self.driven = False  # whether velocity commands arrive
        self.period = 0.0  # period of the commands [s]
        self.due = 0.0  # simulated time at which the next command is due [s]
        self.touched = False  # whether there was contact since the last message on ~collision
        self.running = threading.Event()  # set while simulated time advances
        if not rospy.get_param("~paused", False):
            self.running.set()

        own_topics = [
            rospy.resolve_name(robot.topics.odometry),
            rospy.resolve_name(robot.topics.scan),
        ]
        publishers, _, _ = rosgraph.Master(rospy.get_name()).getSystemState()
        refuse_beside_a_robot(own_topics, publishers, rospy.get_name())
        # Publishers first, so that every state is published with its world.
        prefix = frame_prefix(str(rospy.get_param("~tf_prefix", "")))
        self.topics = BridgeTopics(robot, prefix, with_map)
        self.simulator.reset(world, self.seed, self.start)
        self.topics.publish_world(self.simulator, self.stamp())
        if rospy.get_param("~gazebo", False):
            # Needs gazebo_msgs, which a robot does not have.
            from .ros_gazebo import GazeboInterface

            GazeboInterface(self)
        self._connect()
        if not rospy.get_param("/use_sim_time", False):
            rospy.logwarn(
                "sim_bridge: /use_sim_time is not true: nodes on wall time reject scans and "
                "transforms as too old; run `rosparam set /use_sim_time true`, then start them"
            )
        fixed_obstacles = f"{len(world.cylinders)} cylinders, {len(world.boxes)} boxes"
        obstacles = f"{fixed_obstacles}, {len(world.movers)} moving"
        scene = f"world {world.name} ({obstacles}), simulator {simulator_name}"
        run_settings = f"seed {self.seed}, real time factor {self.factor:g}"
        rospy.loginfo(f"sim_bridge: ready: {scene}, {run_settings}")

    def _connect(self) -> None:
        robot = self.simulator.robot
        for topic in (
            command_topic(robot.topics.cmd_vel),
            robot.name + "_velocity_controller/cmd_vel",
        ):
            rospy.Subscriber(topic, TwistMessage, self.on_command, queue_size=1, tcp_nodelay=True)
        rospy.Service("~reset", Empty, self.on_reset)
        rospy.Service("~load_world", Trigger, self.on_load_world)

    def stamp(self) -> rospy.Time:
        """Return the ROS time of the simulator's current state."""
        return rospy.Time.from_sec(self.base_time + self.simulator.state.time)

    # -- simulation thread -------------------------------------------------------------------------
    @until_shutdown()
    def spin(self) -> None:
        """Simulate and publish until the node is shut down."""
        robot = self.simulator.robot
        ticks_per_state = _ticks_of(robot.odometry.rate)
        ticks_per_scan = _ticks_of(robot.laser.rate)
        ticks_per_movers = _ticks_of(MOVERS_HZ)
        rate = RealTimeRate()
        ticks = 0
        while not rospy.is_shutdown():
            if not self.running.is_set():
                self.running.wait(0.02)
                rate.begin()
                continue
            ticks += 1
            with self.lock:
                self.take_command()
                state = self.simulator.advance(TICK_S)
                self.touched |= state.contact
                stamp = self.stamp()
                if ticks % ticks_per_state == 0:
                    self.topics.publish_state(state, stamp, self.touched)
                    self.touched = False
                if ticks % ticks_per_scan == 0 and not self.simulator.loses_scan():
                    self.topics.publish_scan(self.simulator.scan(), stamp)
                if ticks % ticks_per_movers == 0:
                    self.topics.publish_movers(self.simulator, stamp)
                # The clock comes last: a node that it wakes up finds the messages of this time.
                self.topics.clock.publish(stamp)
            if self.factor == 0.0:
                self.lock_step()
                if self.driven:
                    rate.begin()
                else:
                    rate.wait(TICK_S, IDLE_FACTOR, report=False)
            else:
                rate.wait(TICK_S, self.factor)

    def take_command(self) -> None:
        """Pass the latest command to the simulator, and compute when the next one is due."""
        with self.arrived:
            command = self.newest
            self.newest = None
        if command is None:
            return
        self.simulator.command(*command)
        sim_time = self.simulator.state.time
        # A command may come a tick early. The planner's cycle stays the same, so its due time
        # counts.
        is_early = sim_time <= self.due <= sim_time + 0.5 * self.period
        cycle_start = self.due if is_early else sim_time
        self.due = self.period + cycle_start

    def lock_step(self) -> None:
        """Wait for the planner's next command once the command is due, but at most for PATIENCE_S.

        The simulation then runs as fast as possible without running ahead of the planner. After a
        time-out, lock_step does not wait again until the next command has arrived.
        """
        if self.driven and self.simulator.state.time > self.due - 1e-6:
            with self.arrived:
                self.driven = self.arrived.wait_for(lambda: self.newest is not None, PATIENCE_S)

    # -- callbacks ---------------------------------------------------------------------------------
    def on_command(self, message: Any) -> None:
        """Store a velocity command for the simulation thread, unless it is not finite."""
        v, w = twist_of(message)
        if not (isfinite(v) and isfinite(w)):
            problem = f"velocity command ({v:g}, {w:g}) rejected: send finite numbers"
            rospy.logwarn_throttle(5.0, f"sim_bridge: {problem}")
            return
        if not self.driven:  # The new source of commands may have another frequency.
            frequency = rospy.get_param("move_base/controller_frequency", CONTROL_FREQUENCY_HZ)
            self.period = 1.0 / float(frequency)
        with self.arrived:
            self.newest = (v, w)
            self.driven = True
            self.arrived.notify()

    def on_reset(self, _: Any) -> EmptyResponse:
        """Handle the service ~reset: restart in the same world with the next seed."""
        self._restart()
        return EmptyResponse()

    # -- Gazebo services ---------------------------------------------------------------------------
    def pause(self, _: Any) -> EmptyResponse:
        """Stop simulated time, and return after the current step."""
        self.running.clear()
        with self.lock:
            return EmptyResponse()

    def unpause(self, _: Any) -> EmptyResponse:
        """Resume simulated time."""
        self.running.set()
        return EmptyResponse()

    def teleport(self, pose: Any) -> None:
        """Place the robot at rest at `pose` (x, y, yaw) in the world frame, while time goes on."""
        with self.lock:
            self.simulator.teleport(pose)
            self.touched = False
            self.topics.publish_frames(self.simulator, self.stamp())

    def on_load_world(self, _: Any) -> TriggerResponse:
        """Handle the service ~load_world: change to the world named by the parameter ~world."""
        try:
            world = world_of(str(rospy.get_param("~world", "")), self.simulator.robot)
        except ApplrError as error:
            rospy.logerr(
                "sim_bridge: no new world, keeping %s: %s", self.simulator.world.name, error
            )
            return TriggerResponse(False, str(error))
        self._restart(world)
        rospy.loginfo("sim_bridge: world %s", world.name)
        return TriggerResponse(True, f"world {world.name}")

    def _restart(self, world: Optional[worlds.World] = None) -> None:
        """Restart in `world`, by default in the current world with the next seed."""
        with self.lock:
            if world is None:
                world = self.simulator.world
                self.seed += 1
            else:
                self.start = None  # The course of the new world has its own start.
            self.base_time += self.simulator.state.time + TICK_S
            with self.arrived:
                self.newest = None
                self.driven = False
                self.due = 0.0
            state = self.simulator.reset(world, self.seed, self.start)
            self.touched = False
            self.topics.publish_world(self.simulator, self.stamp())
            self.topics.publish_state(state, self.stamp(), touched=False)
            self.topics.publish_scan(self.simulator.scan(), self.stamp())
            self.topics.clock.publish(self.stamp())
        time.sleep(0.05)  # Scans from the old position must arrive before the maps are cleared.
        _clear_costmaps()


def refuse_beside_a_robot(
    topics: Sequence[str], publishers: Sequence[Tuple[str, Sequence[str]]], own_name: str
) -> None:
    """Refuse to start a simulated robot beside a real one, which it would move blindly.

    Args:
        topics: Full names of the topics on which only one robot may publish.
        publishers: (topic, names of its nodes) of all publishers on the master.
        own_name: Name of this node, which an earlier one may have had.

    Raises:
        ApplrError: Another node publishes one of the topics.
    """
    for topic_name, node_names in publishers:
        others = set(node_names) - {own_name}
        if topic_name in topics and others:
            problem = f"{min(others)} publishes {topic_name} already"
            raise ApplrError(f"{problem}: give sim:=false for a real robot, or end that node")


def _ticks_of(rate: float) -> int:
    """Return the number of ticks between two messages at a rate [Hz]."""
    return max(1, round(1.0 / TICK_S / rate))


class RealTimeRate:
    """Synchronises simulated time with wall time."""

    def __init__(self) -> None:
        self.begin()

    def begin(self) -> None:
        """Restart the synchronisation at the current time."""
        self.next = time.monotonic()

    def wait(self, simulated: float, factor: float, report: bool = True) -> None:
        """Sleep until wall time has caught up, or drop a delay above LARGEST_DELAY_S and report it.

        Args:
            simulated: Simulated time since the last call [s].
            factor: Real-time factor.
            report: Whether to report a delay.
        """
        wall_time = time.monotonic()
        self.next += simulated / factor
        if self.next > wall_time:
            time.sleep(self.next - wall_time)
        elif wall_time - self.next > LARGEST_DELAY_S:
            self.next = wall_time
            if report:
                rospy.logwarn_throttle(
                    60.0,
                    f"sim_bridge: the simulation is slower than real_time_factor {factor:g}: "
                    "lower it, or end other programs",
                )


def _clear_costmaps() -> None:
    """Ask move_base to clear its costmaps if it runs."""
    service_name = rospy.resolve_name("move_base/clear_costmaps")
    try:
        rospy.wait_for_service(service_name, 0.1)
        rospy.ServiceProxy(service_name, Empty)()
    except rospy.ROSException:
        pass  # Without move_base, there is nothing to clear.
    except rospy.ServiceException as error:
        rospy.logwarn("sim_bridge: costmaps not cleared: %s", error)


def main() -> int:
    """Run the node until shutdown."""
    init_node("sim_bridge")
    bridge = Bridge()
    gc.collect()
    gc.freeze()  # A garbage collection of all loaded objects would delay the clock by 100 ms.
    # rospy shuts down in the signal handler of the main thread. If the simulation ran there, the
    # handler would wait for the lock of the publish() call that it interrupted.
    spinning = threading.Thread(target=bridge.spin, daemon=True)
    spinning.start()
    while spinning.is_alive():
        # Python handles a signal delivered to another thread only between two calls.
        spinning.join(0.5)
    return 0 if rospy.core.is_shutdown_requested() else 1
