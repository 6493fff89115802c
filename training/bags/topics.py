"""Topics of a recorded drive: one table of names, types and conversions, to read and to write."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Callable, Dict, NamedTuple, Tuple

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import applr_ros1
from applr_ros1.common.angles import Pose, quaternion_of, yaw_of
from applr_ros1.drives.drive import ABORTED, CANCELLED, REACHED, Decision
from applr_ros1.monitor.motion import Twist
from applr_ros1.policy.decision import Seen
from applr_ros1.policy.observation import FARTHEST_M, beginning
from training.bags import SECOND
from training.common.command_line import AnyRobot
from training.common.options import Options, option

MESSAGES = Path(applr_ros1.__file__).parents[1] / "msg"  # definitions of this package's messages
# Definitions that rosbags lacks.
DEFINITIONS = {
    "move_base_msgs/msg/MoveBaseResult": "",
    "move_base_msgs/msg/MoveBaseActionResult": (
        "std_msgs/Header header\nactionlib_msgs/GoalStatus status\n"
        "move_base_msgs/MoveBaseResult result\n"
    ),
    "move_base_msgs/msg/RecoveryStatus": (
        "geometry_msgs/PoseStamped pose_stamped\nuint16 current_recovery_number\n"
        "uint16 total_number_of_recoveries\nstring recovery_behavior_name\n"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
}
# Status codes of actionlib: of a running goal (active, preempting), and of the ends of goals.
ACTIVE, PREEMPTED, SUCCEEDED, GAVE_UP, REJECTED, PREEMPTING = 1, 2, 3, 4, 5, 6
RUNNING = (ACTIVE, PREEMPTING)
END_OF_CODE = {SUCCEEDED: REACHED, GAVE_UP: ABORTED, REJECTED: ABORTED}
CODE_OF_END = {REACHED: SUCCEEDED, ABORTED: GAVE_UP}
# Fields of Parameters.msg beside names, values and multipliers: values for plots.
PLOTTED = 8


@dataclass(frozen=True)
class TopicNames:
    """Names of the topics of a recorded drive."""

    scan: str = "/front/scan"
    odometry: str = "/odometry/filtered"
    move_base: str = "/move_base"
    collision: str = "/sim_bridge/collision"
    applr: str = "/applr"
    command: str = "/cmd_vel"
    demonstration: str = "/demonstration"
    tf: str = "/tf"
    tf_static: str = "/tf_static"

    @classmethod
    def of(cls, robot: Any) -> TopicNames:
        """Return the topics of a robot (robots.Robot) that has no namespace."""
        topics = robot.topics
        return cls(
            scan="/" + topics.scan.lstrip("/"),
            odometry="/" + topics.odometry.lstrip("/"),
            command="/" + topics.cmd_vel.lstrip("/"),
        )


class BagOptions(Options):
    """Robot that recorded the bags, and topics of its recordings."""

    robot: AnyRobot
    scan: str = option("", "Topic of the laser scans in the bags. Default: the robot's.")
    odometry: str = option("", "Topic of the odometry in the bags. Default: the robot's.")
    command: str = option("", "Topic of the velocity commands in the bags. Default: the robot's.")

    def topics(self) -> TopicNames:
        """Return the robot's topics, replaced by those that are given as options."""
        return replace(TopicNames.of(self.robot), **self.given_topics())

    def given_topics(self) -> Dict[str, str]:
        """Return the fields of TopicNames that are given as options."""
        given_topics = {}
        for option_name, option_value in self:
            if option_value and hasattr(TopicNames, option_name):
                given_topics[option_name] = option_value
        return given_topics


class Maker:
    """Makes ROS 1 messages of the types that a drive has."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS1_NOETIC)
        for message_type, definition in DEFINITIONS.items():
            self.store.register(get_types_from_msg(definition, message_type))

    def make(self, message_type: str, *fields: Any) -> Any:
        """Return a message of a type with its fields in order."""
        if message_type.startswith("applr_ros1/") and message_type not in self.store.types:
            self._register_own()
        return self.store.types[message_type](*fields)

    def _register_own(self) -> None:
        for message_name in ("Parameters", "Movers", "Decision"):
            definition = (MESSAGES / f"{message_name}.msg").read_text(encoding="utf-8")
            self.store.register(get_types_from_msg(definition, f"applr_ros1/msg/{message_name}"))

    def time(self, seconds: float) -> Any:
        """Return a builtin time."""
        return self.make("builtin_interfaces/msg/Time", *divmod(nanoseconds(seconds), SECOND))

    def header(self, seconds: float, frame: str) -> Any:
        """Return a std_msgs/Header."""
        return self.make("std_msgs/msg/Header", 0, self.time(seconds), frame)

    def twist(self, command: Twist) -> Any:
        """Return a geometry_msgs/Twist of (v [m/s], w [rad/s])."""
        v, w = map(float, command)
        linear = self.make("geometry_msgs/msg/Vector3", v, 0.0, 0.0)
        angular = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, w)
        return self.make("geometry_msgs/msg/Twist", linear, angular)

    def pose(self, pose: Pose) -> Any:
        """Return a geometry_msgs/Pose of (x, y, yaw) [m, m, rad]."""
        x, y, yaw = map(float, pose)
        position = self.make("geometry_msgs/msg/Point", x, y, 0.0)
        orientation = self.make("geometry_msgs/msg/Quaternion", *quaternion_of(yaw))
        return self.make("geometry_msgs/msg/Pose", position, orientation)

    def stamped_pose(self, seconds: float, frame: str, pose: Pose) -> Any:
        """Return a geometry_msgs/PoseStamped."""
        return self.make(
            "geometry_msgs/msg/PoseStamped", self.header(seconds, frame), self.pose(pose)
        )

    def goal_status(self, goal: str, code: int) -> Any:
        """Return an actionlib_msgs/GoalStatus."""
        identity = self.make("actionlib_msgs/msg/GoalID", self.time(0.0), goal)
        return self.make("actionlib_msgs/msg/GoalStatus", identity, code, "")


class Channel(NamedTuple):
    """One topic of a drive.

    Attributes:
        topic: Name with fields of TopicNames in braces; `*` stands for a planner or a server.
        type: Type of the messages that are written.
        unpack: Function that returns the fields of a row from a message.
        pack: Function (maker, time [s], *fields) that returns a message.
    """

    topic: str
    type: str
    unpack: Callable[[Any], Tuple[Any, ...]]
    pack: Callable[..., Any]

    def accepts(self, message_type: str) -> bool:
        """Return whether `unpack` takes messages of a type.

        Twists come with and without a stamp, and tf's messages had a package of their own in older
        versions of ROS 1 (tf/tfMessage).
        """
        type_name = self.type.rpartition("/")[2].lower()
        return message_type.rpartition("/")[2].lower() in (type_name, f"{type_name}stamped")


def nanoseconds(seconds: float) -> int:
    """Return a time [s] in whole nanoseconds."""
    return int(round(seconds * SECOND))


def nanoseconds_of(time: Any) -> int:
    """Return a time of a message [ns]."""
    return int(time.sec) * SECOND + int(time.nanosec)


def frame_of(message: Any) -> str:
    """Return the frame of a message."""
    return str(message.header.frame_id.lstrip("/"))


def pose_of(message: Any) -> Pose:
    """Return (x, y, yaw) of a geometry_msgs/Pose."""
    return message.position.x, message.position.y, yaw_of(message.orientation)


# -- sensors and commands --------------------------------------------------------------------------
def _unpack_scan(message: Any) -> Tuple[Any, ...]:
    """Return stamp [ns], frame, fan and ranges of a sensor_msgs/LaserScan."""
    stamp = nanoseconds_of(message.header.stamp)
    fan = message.angle_min, message.angle_increment, message.range_min, message.range_max
    return stamp, frame_of(message), fan, np.array(message.ranges, np.float32)


def _pack_scan(maker: Maker, time: float, frame: str, fan: Any, ranges: Any) -> Any:
    angle_min, increment, range_min, range_max = map(float, fan)
    angle_max = angle_min + increment * (len(ranges) - 1)
    time_increment = 0.0
    scan_time = 0.0
    intensities = np.empty(0, np.float32)
    return maker.make(
        "sensor_msgs/msg/LaserScan",
        maker.header(time, frame),
        angle_min,
        angle_max,
        increment,
        time_increment,
        scan_time,
        range_min,
        range_max,
        np.ascontiguousarray(ranges, np.float32),
        intensities,
    )


def _unpack_odometry(message: Any) -> Tuple[Any, ...]:
    """Return stamp [ns], frame, pose (x, y, yaw) and twist (v, w) of a nav_msgs/Odometry."""
    stamp = nanoseconds_of(message.header.stamp)
    pose = pose_of(message.pose.pose)
    velocity = message.twist.twist
    twist = velocity.linear.x, velocity.angular.z
    return stamp, frame_of(message), pose, twist


def _pack_odometry(
    maker: Maker, time: float, frame: str, base_frame: str, pose: Pose, twist: Twist
) -> Any:
    unknown = np.zeros(36)  # a covariance (6, 6), row by row
    return maker.make(
        "nav_msgs/msg/Odometry",
        maker.header(time, frame),
        base_frame,
        maker.make("geometry_msgs/msg/PoseWithCovariance", maker.pose(pose), unknown),
        maker.make("geometry_msgs/msg/TwistWithCovariance", maker.twist(twist), unknown),
    )


def _unpack_transforms(message: Any) -> Tuple[Any, ...]:
    """Return a list of (stamp [ns], parent, child, place) of a tf2_msgs/TFMessage."""
    placed_frames = []
    for link in message.transforms:
        position = link.transform.translation
        rotation = link.transform.rotation
        quaternion = rotation.x, rotation.y, rotation.z, rotation.w
        frame_place = (position.x, position.y, position.z, *quaternion)
        stamp = nanoseconds_of(link.header.stamp)
        child = str(link.child_frame_id.lstrip("/"))
        placed_frames.append((stamp, frame_of(link), child, frame_place))
    return (placed_frames,)


def _pack_transform(maker: Maker, time: float, parent: str, child: str, place: Any) -> Any:
    """Return a tf2_msgs/TFMessage with the place (7,) of one frame."""
    numbers = [float(number) for number in place]
    translation = maker.make("geometry_msgs/msg/Vector3", *numbers[:3])
    rotation = maker.make("geometry_msgs/msg/Quaternion", *numbers[3:])
    transform = maker.make("geometry_msgs/msg/Transform", translation, rotation)
    header = maker.header(time, parent)
    link = maker.make("geometry_msgs/msg/TransformStamped", header, child, transform)
    return maker.make("tf2_msgs/msg/TFMessage", [link])


def _unpack_command(message: Any) -> Tuple[Any, ...]:
    """Return (v, w) of a geometry_msgs/Twist or TwistStamped."""
    twist = getattr(message, "twist", message)
    return ((twist.linear.x, twist.angular.z),)


def _pack_command(maker: Maker, time: float, command: Twist) -> Any:
    return maker.twist(command)


# -- planner ---------------------------------------------------------------------------------------
def _unpack_plan(message: Any) -> Tuple[Any, ...]:
    """Return stamp [ns], frame and poses (n, 3) of a nav_msgs/Path."""
    poses = [pose_of(stamped.pose) for stamped in message.poses]
    # A path without poses also has three columns.
    path = np.array(poses).reshape(-1, 3)
    return nanoseconds_of(message.header.stamp), frame_of(message), path


def _pack_plan(maker: Maker, time: float, frame: str, path: Any) -> Any:
    poses = [maker.stamped_pose(time, frame, pose) for pose in path]
    return maker.make("nav_msgs/msg/Path", maker.header(time, frame), poses)


def _unpack_change(message: Any) -> Tuple[Any, ...]:
    """Return {name: value} of a dynamic_reconfigure/Config."""
    values = {}
    for field in (*message.bools, *message.ints, *message.strs, *message.doubles):
        values[field.name] = field.value
    return (values,)


def _pack_change(maker: Maker, time: float, values: Dict[str, Any]) -> Any:
    """Return a dynamic_reconfigure/Config, with numbers as doubles."""
    package = "dynamic_reconfigure/msg"
    flags = []
    texts = []
    numbers = []
    for parameter_name, parameter_value in values.items():
        # A bool is a number to Python, so that it is asked first.
        if isinstance(parameter_value, bool):
            flags.append(maker.make(f"{package}/BoolParameter", parameter_name, parameter_value))
        elif isinstance(parameter_value, str):
            texts.append(maker.make(f"{package}/StrParameter", parameter_name, parameter_value))
        else:
            number = float(parameter_value)
            numbers.append(maker.make(f"{package}/DoubleParameter", parameter_name, number))
    # Whole numbers and groups of parameters are left empty.
    return maker.make(f"{package}/Config", flags, [], texts, numbers, [])


def _unpack_nothing(message: Any) -> Tuple[Any, ...]:
    return ()


def _pack_recovery(maker: Maker, time: float, frame: str) -> Any:
    pose = maker.stamped_pose(time, frame, (0.0, 0.0, 0.0))
    return maker.make("move_base_msgs/msg/RecoveryStatus", pose, 0, 0, "")


def _unpack_status(message: Any) -> Tuple[Any, ...]:
    """Return the id of the running goal of an actionlib_msgs/GoalStatusArray, or ""."""
    running = ""
    for status in message.status_list:
        # A goal that replaces another one comes after it.
        if status.status in RUNNING:
            running = status.goal_id.id
    return (running,)


def _pack_status(maker: Maker, time: float, goal: str, code: int = ACTIVE) -> Any:
    statuses = [maker.goal_status(goal, code)] if goal else []
    return maker.make("actionlib_msgs/msg/GoalStatusArray", maker.header(time, ""), statuses)


def _unpack_result(message: Any) -> Tuple[Any, ...]:
    """Return goal and how it ended of a MoveBaseActionResult."""
    return message.status.goal_id.id, END_OF_CODE.get(int(message.status.status), CANCELLED)


def _pack_result(maker: Maker, time: float, goal: str, code: int) -> Any:
    # rosbags gives an empty type one field.
    nothing = maker.make("move_base_msgs/msg/MoveBaseResult", 0)
    status = maker.goal_status(goal, code)
    return maker.make(
        "move_base_msgs/msg/MoveBaseActionResult", maker.header(time, ""), status, nothing
    )


def _unpack_goal(message: Any) -> Tuple[Any, ...]:
    """Return pose and frame of a geometry_msgs/PoseStamped."""
    return pose_of(message.pose), frame_of(message)


def _pack_goal(maker: Maker, time: float, pose: Pose, frame: str) -> Any:
    return maker.stamped_pose(time, frame, pose)


# -- decisions and contacts ------------------------------------------------------------------------
def _unpack_decision(message: Any) -> Tuple[Any, ...]:
    """Return the fields of a Decision: goal, stamps [ns], parameters, inputs, cleared.

    The stamps are those of the decision and of its scan. The parameters are those before and after.
    """
    before = dict(zip(message.before.names, message.before.values.tolist()))
    after = dict(zip(message.after.names, message.after.values.tolist()))
    # Decisions of older versions had a finished observation instead of its inputs, and did not tell
    # whether the costmaps were cleared.
    seen = _unpack_seen(message) if hasattr(message, "ranges") else None
    stamp = nanoseconds_of(message.header.stamp)
    scan_stamp = nanoseconds_of(message.scan)
    cleared = bool(getattr(message, "cleared", False))
    return message.goal, stamp, scan_stamp, before, after, seen, cleared


def _unpack_seen(message: Any) -> Seen:
    """Return the inputs of a decision."""
    tracked = message.movers
    movers = np.column_stack([tracked.x, tracked.y, tracked.vx, tracked.vy])
    return Seen(
        scan=(message.ranges.astype(np.float32), message.angle_min, message.angle_increment),
        time=message.elapsed,
        pose=(message.x, message.y, message.yaw),
        twist=(message.v, message.w),
        goal=(message.goal_x, message.goal_y, message.goal_yaw),
        plan=np.column_stack([message.plan_x, message.plan_y]),
        movers=movers.astype(np.float64),
    )


def _pack_decision(
    maker: Maker, time: float, frame: str, number: int, decision: Decision, scale: float
) -> Any:
    """Return msg/Decision.msg. `scale` is the robot's size relative to the Jackal's."""
    header = maker.header(time, frame)
    seen = decision.seen
    assert seen is not None
    # A policy looks along the plan for a distance in its robot's size.
    plan_x, plan_y = beginning(seen.plan, seen.pose, FARTHEST_M * scale).T.copy()
    x, y, vx, vy = seen.movers.T.copy()
    radii = np.zeros(len(seen.movers))
    movers = maker.make("applr_ros1/msg/Movers", header, x, y, vx, vy, radii)
    ranges, first_angle, increment = seen.scan
    stamp = maker.time(time)
    refused = ""  # reason why the node would not apply the decision
    return maker.make(
        "applr_ros1/msg/Decision",
        header,
        number,
        decision.goal,
        float(seen.time),
        stamp,  # scan
        stamp,  # odometry
        stamp,  # plan
        *map(float, (*seen.pose, *seen.twist, *seen.goal)),
        float(first_angle),
        float(increment),
        np.asarray(ranges, np.float32),
        plan_x,
        plan_y,
        movers,
        _pack_parameters(maker, header, decision.before),
        _pack_parameters(maker, header, decision.after),
        refused,
        decision.cleared,
    )


def _pack_parameters(maker: Maker, header: Any, values: Dict[str, float]) -> Any:
    multipliers = np.ones(len(values))
    numbers = np.array(list(values.values()), np.float64)
    plotted = [np.nan] * PLOTTED
    return maker.make(
        "applr_ros1/msg/Parameters", header, list(values), numbers, multipliers, *plotted
    )


def _unpack_contact(message: Any) -> Tuple[Any, ...]:
    return (bool(message.data),)


def _pack_contact(maker: Maker, time: float, touches: bool) -> Any:
    return maker.make("std_msgs/msg/Bool", touches)


def _unpack_source(message: Any) -> Tuple[Any, ...]:
    return (json.loads(message.data),)


def _pack_source(maker: Maker, time: float, source: Dict[str, Any]) -> Any:
    return maker.make("std_msgs/msg/String", json.dumps(source))


CHANNELS: Dict[str, Channel] = {
    "scans": Channel("{scan}", "sensor_msgs/msg/LaserScan", _unpack_scan, _pack_scan),
    "odometry": Channel("{odometry}", "nav_msgs/msg/Odometry", _unpack_odometry, _pack_odometry),
    "transforms": Channel("{tf}", "tf2_msgs/msg/TFMessage", _unpack_transforms, _pack_transform),
    "static_transforms": Channel(
        "{tf_static}", "tf2_msgs/msg/TFMessage", _unpack_transforms, _pack_transform
    ),
    "commands": Channel("{command}", "geometry_msgs/msg/Twist", _unpack_command, _pack_command),
    "planned": Channel(
        "{move_base}/cmd_vel", "geometry_msgs/msg/Twist", _unpack_command, _pack_command
    ),
    "plans": Channel("{move_base}/*/global_plan", "nav_msgs/msg/Path", _unpack_plan, _pack_plan),
    "routes": Channel("{move_base}/*/plan", "nav_msgs/msg/Path", _unpack_plan, _pack_plan),
    "changes": Channel(
        "{move_base}/*/parameter_updates",
        "dynamic_reconfigure/msg/Config",
        _unpack_change,
        _pack_change,
    ),
    "recoveries": Channel(
        "{move_base}/recovery_status",
        "move_base_msgs/msg/RecoveryStatus",
        _unpack_nothing,
        _pack_recovery,
    ),
    "status": Channel(
        "{move_base}/status", "actionlib_msgs/msg/GoalStatusArray", _unpack_status, _pack_status
    ),
    "results": Channel(
        "{move_base}/result",
        "move_base_msgs/msg/MoveBaseActionResult",
        _unpack_result,
        _pack_result,
    ),
    "sent": Channel(
        "{move_base}/current_goal", "geometry_msgs/msg/PoseStamped", _unpack_goal, _pack_goal
    ),
    "decisions": Channel(
        "{applr}/decision", "applr_ros1/msg/Decision", _unpack_decision, _pack_decision
    ),
    "ends": Channel(
        "{applr}/course_end", "applr_ros1/msg/Decision", _unpack_decision, _pack_decision
    ),
    "contacts": Channel("{collision}", "std_msgs/msg/Bool", _unpack_contact, _pack_contact),
    "source": Channel("{demonstration}", "std_msgs/msg/String", _unpack_source, _pack_source),
}


def topic_of(channel: str, names: TopicNames, part: str = "*") -> str:
    """Return the topic of a channel. `part` replaces `*`: the name of a planner or of a server."""
    return CHANNELS[channel].topic.format(**vars(names)).replace("*", part)
