"""Columns of a drive as messages: a row per topic, from which reader and writer of bags follow.

A function `unpack` takes a message of rospy, or of the library rosbags: both name its fields
alike. A function `pack` returns the fields of a message by name. So nothing here needs ROS.
"""

import json
import math
from dataclasses import dataclass
from functools import partial
from typing import Any, Callable, Dict, List, Mapping, NamedTuple

import numpy as np

from applr_ros1.common.angles import quaternion_of
from applr_ros1.common.arrays import Array
from applr_ros1.common.messages import frame_of, pose_of, twist_of
from applr_ros1.common.scan import distances_of
from applr_ros1.drives.drive import ABORTED, CANCELLED, REACHED, DriveError
from applr_ros1.monitor.monitor import action_in, action_text
from applr_ros1.policy.decision import Seen
from applr_ros1.policy.observation import FARTHEST_M, beginning
from applr_ros1.policy.parameter_space import Space, space_of
from applr_ros1.robots import Robot
from applr_ros1.senses.standing import PURSUED

Row = Dict[str, Any]  # values of a row of a column by the names of its fields
Fields = Dict[str, Any]  # fields of a message; times in seconds, inner messages as Fields

SECOND = 1_000_000_000  # one second [ns]
# Status codes of actionlib for the ends of goals
PREEMPTED, SUCCEEDED, GAVE_UP, REJECTED = 2, 3, 4, 5
END_OF_CODE = {SUCCEEDED: REACHED, GAVE_UP: ABORTED, REJECTED: ABORTED}
CODE_OF_END = {REACHED: SUCCEEDED, ABORTED: GAVE_UP}
# Fields of Parameters.msg that hold eight of the values once more, for plots
PLOTTED = (
    "max_vel_x",
    "max_vel_theta",
    "vx_samples",
    "vtheta_samples",
    "occdist_scale",
    "path_distance_bias",
    "goal_distance_bias",
    "inflation_radius",
)


@dataclass(frozen=True)
class TopicNames:
    """Names of the topics of a recorded drive."""

    scan: str = "/front/scan"
    odometry: str = "/odometry/filtered"
    move_base: str = "/move_base"
    collision: str = "/sim_bridge/collision"
    applr: str = "/applr"
    command: str = "/cmd_vel"
    monitor: str = "/collision_monitor"
    demonstration: str = "/demonstration"
    tf: str = "/tf"
    tf_static: str = "/tf_static"

    @classmethod
    def of(cls, robot: Robot) -> "TopicNames":
        """Return the topics of a robot that has no namespace."""
        topics = robot.topics
        return cls(
            scan="/" + topics.scan.lstrip("/"),
            odometry="/" + topics.odometry.lstrip("/"),
            command="/" + topics.cmd_vel.lstrip("/"),
        )


class Stamp(int):
    """Time by the robot's clock [ns], as in a message; 0 if it was not set."""


class Sender(NamedTuple):
    """Properties of a message's sender.

    Attributes:
        robot: Robot whose frames and sizes are used.
        frame: Frame of odometry and plans.
        begin: Time at which the drive begins [s].
        number: Number of the row in its column.
    """

    robot: Robot
    frame: str
    begin: float = 0.0
    number: int = 0

    def header(self, time: float, frame: str) -> Fields:
        """Return a std_msgs/Header with a time of the drive [s]."""
        return {"stamp": self.begin + float(time), "frame_id": frame}


class Column(NamedTuple):
    """Topic with a column of a drive.

    Attributes:
        topic: Name with fields of TopicNames in braces; `*` stands for a planner or a server. It is
            usual: an action of move_base_flex may stand there, too, and nothing for move_base.
        type: Type of the messages that are written.
        unpack: Function that returns the rows in a message. It gives what the column's class in
            drive.py has, except for the time at which the message came. Fields of other names say
            more of the message, such as its `frame`.
        pack: Function that returns the fields of the message with a row.
        part: Name of the row's field with what stands there; "" if nothing does.
        part_of: Name of the column in Drive, if it has several topics; "" if it is the key.
    """

    topic: str
    type: str
    unpack: Callable[[Any], List[Row]]
    pack: Callable[[Mapping[str, Any], Sender], Fields]
    part: str = ""
    part_of: str = ""

    def accepts(self, message_type: str) -> bool:
        """Return whether `unpack` takes messages of a type.

        Twists come with and without a stamp, and tf's messages had a package of their own in older
        versions of ROS 1 (tf/tfMessage).
        """
        type_name = self.type.rpartition("/")[2].lower()
        return message_type.rpartition("/")[2].lower() in (type_name, f"{type_name}stamped")


def stamp_of(time: Any) -> Stamp:
    """Return a time of a message."""
    # rosbags gives ROS 1's times the names of ROS 2.
    if hasattr(time, "nanosec"):
        return Stamp(time.sec * SECOND + time.nanosec)
    return Stamp(time.secs * SECOND + time.nsecs)


def _pose(pose: Any) -> Fields:
    """Return a geometry_msgs/Pose of (x, y, yaw) [m, m, rad]."""
    x, y, yaw = map(float, pose)
    return {
        "position": {"x": x, "y": y},
        "orientation": dict(zip("xyzw", quaternion_of(yaw))),
    }


def _twist(row: Mapping[str, Any]) -> Fields:
    """Return the geometry_msgs/Twist of a row, whose velocity to the left may be left out."""
    v, w = map(float, row["twist"])
    return {"linear": {"x": v, "y": float(row.get("sideways", 0.0))}, "angular": {"z": w}}


# -- sensors and commands --------------------------------------------------------------------------
def _unpack_scan(message: Any) -> List[Row]:
    """Return the row of a sensor_msgs/LaserScan."""
    fan = message.angle_min, message.angle_increment, message.range_min, message.range_max
    row = {
        "stamp": stamp_of(message.header.stamp),
        "frame": frame_of(message),
        "fan": fan,
        "ranges": np.array(message.ranges, np.float32),
    }
    return [row]


def _pack_scan(row: Mapping[str, Any], sender: Sender) -> Fields:
    first_angle, increment, range_min, range_max = map(float, row["fan"])
    ranges = row["ranges"]
    return {
        "header": sender.header(row["stamp"], sender.robot.laser.frame),
        "angle_min": first_angle,
        "angle_max": first_angle + increment * (len(ranges) - 1),
        "angle_increment": increment,
        "range_min": range_min,
        "range_max": range_max,
        "ranges": ranges,
    }


def _unpack_odometry(message: Any) -> List[Row]:
    """Return the row of a nav_msgs/Odometry, or none if a number is not finite.

    Neither tf nor move_base takes such a number.
    """
    pose = pose_of(message.pose.pose)
    twist = twist_of(message.twist.twist)
    sideways = message.twist.twist.linear.y
    if not all(map(math.isfinite, (*pose, *twist, sideways))):
        return []
    row = {
        "stamp": stamp_of(message.header.stamp),
        "frame": frame_of(message),
        "pose": pose,
        "twist": twist,
        "sideways": sideways,
    }
    return [row]


def _pack_odometry(row: Mapping[str, Any], sender: Sender) -> Fields:
    return {
        "header": sender.header(row["stamp"], sender.frame),
        "child_frame_id": sender.robot.frames.base,
        "pose": {"pose": _pose(row["pose"])},
        "twist": {"twist": _twist(row)},
    }


def _unpack_transforms(message: Any, is_static: bool) -> List[Row]:
    """Return the places of frames in a tf2_msgs/TFMessage, without rotations of no length."""
    rows = []
    for link in message.transforms:
        position = link.transform.translation
        rotation = link.transform.rotation
        x, y, z, w = rotation.x, rotation.y, rotation.z, rotation.w
        place = (position.x, position.y, position.z, x, y, z, w)
        # Plain numbers: a bag has thousands of transforms, on which numpy would take far longer.
        squared_length = x * x + y * y + z * z + w * w
        if squared_length > 0.0 and all(map(math.isfinite, place)):
            row = {
                "stamp": stamp_of(link.header.stamp),
                "parent": frame_of(link),
                "child": str(link.child_frame_id.lstrip("/")),
                "place": place,
                "is_static": is_static,
            }
            rows.append(row)
    return rows


def _pack_transform(row: Mapping[str, Any], sender: Sender) -> Fields:
    """Return a tf2_msgs/TFMessage with the place of one frame."""
    numbers = list(map(float, row["place"]))
    transform = {
        "translation": dict(zip("xyz", numbers[:3])),
        "rotation": dict(zip("xyzw", numbers[3:])),
    }
    link = {
        "header": sender.header(row["stamp"], row["parent"]),
        "child_frame_id": row["child"],
        "transform": transform,
    }
    return {"transforms": [link]}


def _unpack_command(message: Any) -> List[Row]:
    """Return the row of a geometry_msgs/Twist or TwistStamped."""
    twist = getattr(message, "twist", message)
    return [{"twist": twist_of(twist), "sideways": twist.linear.y}]


def _pack_command(row: Mapping[str, Any], sender: Sender) -> Fields:
    return _twist(row)


# -- planner ---------------------------------------------------------------------------------------
def _unpack_plan(message: Any) -> List[Row]:
    """Return the row of a nav_msgs/Path."""
    poses = [pose_of(stamped.pose) for stamped in message.poses]
    # A path without poses also has three columns.
    path = np.array(poses).reshape(-1, 3)
    return [path_row(stamp_of(message.header.stamp), frame_of(message), path)]


def path_row(stamp: Stamp, frame: str, path: Array) -> Row:
    """Return the row of a nav_msgs/Path with poses (n, 3)."""
    return {"stamp": stamp, "frame": frame, "path": path}


def _pack_plan(row: Mapping[str, Any], sender: Sender) -> Fields:
    header = sender.header(row["time"], sender.frame)
    poses = [{"header": header, "pose": _pose(pose)} for pose in row["path"]]
    return {"header": header, "poses": poses}


def _unpack_change(message: Any) -> List[Row]:
    """Return the row of a dynamic_reconfigure/Config."""
    values = {}
    for field in (*message.bools, *message.ints, *message.strs, *message.doubles):
        values[field.name] = field.value
    return [{"values": values}]


def _pack_change(row: Mapping[str, Any], sender: Sender) -> Fields:
    """Return a dynamic_reconfigure/Config, with numbers as doubles."""
    flags = []
    texts = []
    numbers = []
    for parameter_name, parameter_value in row["values"].items():
        # A bool is a number to Python, so that it is asked first.
        if isinstance(parameter_value, bool):
            flags.append({"name": parameter_name, "value": parameter_value})
        elif isinstance(parameter_value, str):
            texts.append({"name": parameter_name, "value": parameter_value})
        else:
            numbers.append({"name": parameter_name, "value": float(parameter_value)})
    # Whole numbers and groups of parameters are left empty.
    return {"bools": flags, "strs": texts, "doubles": numbers}


def _unpack_recovery(message: Any) -> List[Row]:
    """Return a row for each move_base_msgs/RecoveryStatus: it has a time alone."""
    return [{}]


def _pack_recovery(row: Mapping[str, Any], sender: Sender) -> Fields:
    header = sender.header(row["time"], sender.frame)
    return {"pose_stamped": {"header": header, "pose": _pose((0.0, 0.0, 0.0))}}


# -- goals -----------------------------------------------------------------------------------------
def _unpack_status(message: Any) -> List[Row]:
    """Return the id of the running goal of an actionlib_msgs/GoalStatusArray, or ""."""
    running = ""
    for status in message.status_list:
        # A goal that replaces another one comes after it.
        if status.status in PURSUED:
            running = status.goal_id.id
    return [{"running": running}]


def _pack_status(row: Mapping[str, Any], sender: Sender) -> Fields:
    """Return an actionlib_msgs/GoalStatusArray with the status `code` of the goal `id`."""
    return {"header": sender.header(row["time"], ""), "status_list": [_goal_status(row)]}


def _goal_status(row: Mapping[str, Any]) -> Fields:
    """Return an actionlib_msgs/GoalStatus."""
    return {"goal_id": {"id": row["id"]}, "status": row["code"]}


def _unpack_result(message: Any) -> List[Row]:
    """Return goal and how it ended of a MoveBaseActionResult."""
    end_status = END_OF_CODE.get(int(message.status.status), CANCELLED)
    return [{"id": message.status.goal_id.id, "status": end_status}]


def _pack_result(row: Mapping[str, Any], sender: Sender) -> Fields:
    return {"header": sender.header(row["time"], ""), "status": _goal_status(row)}


def _unpack_goal(message: Any) -> List[Row]:
    """Return pose and frame of a geometry_msgs/PoseStamped."""
    return [{"pose": pose_of(message.pose), "frame": frame_of(message)}]


def _pack_goal(row: Mapping[str, Any], sender: Sender) -> Fields:
    return {"header": sender.header(row["time"], row["frame"]), "pose": _pose(row["pose"])}


# -- monitor ---------------------------------------------------------------------------------------
def _unpack_verdict(message: Any) -> List[Row]:
    """Return action and reason of the collision monitor, which publishes each change."""
    action, reason = action_in(message.data)
    return [{"action": action, "reason": reason}]


def _pack_verdict(row: Mapping[str, Any], sender: Sender) -> Fields:
    """Return a std_msgs/String."""
    return {"data": action_text(row["action"], row["reason"])}


# -- decisions and contacts ------------------------------------------------------------------------
def _unpack_decision(message: Any) -> List[Row]:
    """Return the row of a decision, or of the end of a course (msg/Decision.msg)."""
    row = {
        "goal": message.goal,
        "time": stamp_of(message.header.stamp),
        "scan_time": stamp_of(message.scan),
        "before": _unpack_parameters(message.before),
        "after": _unpack_parameters(message.after),
        # Decisions of older versions had a finished observation instead of its inputs, and did not
        # tell whether the costmaps were cleared.
        "seen": _unpack_seen(message) if hasattr(message, "ranges") else None,
        "cleared": bool(getattr(message, "cleared", False)),
    }
    return [row]


def _unpack_parameters(message: Any) -> Dict[str, float]:
    return dict(zip(message.names, np.asarray(message.values).tolist()))


def _unpack_seen(message: Any) -> Seen:
    """Return the inputs of a decision."""
    tracked = message.movers
    movers = np.column_stack([tracked.x, tracked.y, tracked.vx, tracked.vy])
    # The node records what the beams have shown.
    distances = distances_of(message.ranges, 0.0, math.inf)
    return Seen(
        scan=(distances, message.angle_min, message.angle_increment),
        time=message.elapsed,
        pose=(message.x, message.y, message.yaw),
        twist=(message.v, message.w),
        goal=(message.goal_x, message.goal_y, message.goal_yaw),
        plan=np.column_stack([message.plan_x, message.plan_y]),
        movers=movers.astype(np.float64),
    )


def _pack_decision(row: Mapping[str, Any], sender: Sender) -> Fields:
    """Return msg/Decision.msg.

    Raises:
        DriveError: The inputs of the decision were not recorded.
    """
    seen = row["seen"]
    if seen is None:
        raise DriveError("a decision without its inputs cannot be written: record them")
    header = sender.header(row["time"], sender.frame)
    seen_fields = fields_of_seen(seen, sender.robot)
    return {
        **seen_fields,
        "header": header,
        "number": sender.number,
        "goal": row["goal"],
        "scan": sender.begin + row["scan_time"],
        "odometry": header["stamp"],
        "plan": header["stamp"],
        "movers": {"header": header, **seen_fields["movers"]},
        "before": _pack_parameters(header, row["before"], sender),
        "after": _pack_parameters(header, row["after"], sender),
        "cleared": row["cleared"],
    }


def fields_of_seen(seen: Seen, robot: Robot) -> Fields:
    """Return the fields of msg/Decision.msg with the inputs of a decision, without their stamps."""
    x, y, yaw = map(float, seen.pose)
    v, w = map(float, seen.twist)
    goal_x, goal_y, goal_yaw = map(float, seen.goal)
    ranges, first_angle, increment = seen.scan
    # A whole plan would make a bag large. A policy looks along it for a distance in its robot's
    # size.
    plan_x, plan_y = beginning(seen.plan, seen.pose, FARTHEST_M * robot.world_scale).T
    mover_x, mover_y, mover_vx, mover_vy = seen.movers.T
    movers = {
        "x": mover_x,
        "y": mover_y,
        "vx": mover_vx,
        "vy": mover_vy,
        "radius": np.full(len(seen.movers), np.nan),  # Methods get no radius.
    }
    return {
        "elapsed": float(seen.time),
        "x": x,
        "y": y,
        "yaw": yaw,
        "v": v,
        "w": w,
        "goal_x": goal_x,
        "goal_y": goal_y,
        "goal_yaw": goal_yaw,
        "angle_min": float(first_angle),
        "angle_increment": float(increment),
        "ranges": ranges,
        "plan_x": plan_x,
        "plan_y": plan_y,
        "movers": movers,
    }


def _pack_parameters(header: Fields, values: Mapping[str, float], sender: Sender) -> Fields:
    return {"header": header, **fields_of_parameters(values, space_of(sender.robot))}


def fields_of_parameters(values: Mapping[str, float], space: Space) -> Fields:
    """Return the fields of msg/Parameters.msg, without its header, of values not scaled."""
    return {
        "names": list(values),
        "values": list(values.values()),
        "multipliers": [1.0] * len(values),
        **plotted(values, space),
    }


def plotted(values: Mapping[str, float], space: Space) -> Dict[str, float]:
    """Return the fields of Parameters.msg that hold some of the values once more, for plots.

    They are NaN unless a value has their name, or that of its parameter of move_base.
    """
    fields = dict.fromkeys(PLOTTED, np.nan)
    for name, value in values.items():
        names = [name]
        for target in space.targets.get(name, ())[:1]:
            names += target.names
        for plotted_name in names:
            if plotted_name in fields:
                fields[plotted_name] = value
                break
    return fields


def _unpack_contact(message: Any) -> List[Row]:
    """Return a row if the robot touches something: it has a time alone."""
    return [{}] if message.data else []


def _pack_contact(row: Mapping[str, Any], sender: Sender) -> Fields:
    return {"data": True}


def _unpack_source(message: Any) -> List[Row]:
    return [{"source": json.loads(message.data)}]


def _pack_source(row: Mapping[str, Any], sender: Sender) -> Fields:
    return {"data": json.dumps(row["source"])}


# Messages of one time are written in this order, that of a stack.
COLUMNS: Dict[str, Column] = {
    "source": Column("{demonstration}", "std_msgs/msg/String", _unpack_source, _pack_source),
    "sent": Column(
        "{move_base}/current_goal", "geometry_msgs/msg/PoseStamped", _unpack_goal, _pack_goal
    ),
    "goals": Column(
        "{move_base}/status",
        "actionlib_msgs/msg/GoalStatusArray",
        _unpack_status,
        _pack_status,
        part="action",
    ),
    "odometry": Column("{odometry}", "nav_msgs/msg/Odometry", _unpack_odometry, _pack_odometry),
    "transforms": Column(
        "{tf}",
        "tf2_msgs/msg/TFMessage",
        partial(_unpack_transforms, is_static=False),
        _pack_transform,
    ),
    "static_transforms": Column(
        "{tf_static}",
        "tf2_msgs/msg/TFMessage",
        partial(_unpack_transforms, is_static=True),
        _pack_transform,
        part_of="transforms",
    ),
    "scans": Column("{scan}", "sensor_msgs/msg/LaserScan", _unpack_scan, _pack_scan),
    "changes": Column(
        "{move_base}/*/parameter_updates",
        "dynamic_reconfigure/msg/Config",
        _unpack_change,
        _pack_change,
        part="server",
    ),
    "decisions": Column(
        "{applr}/decision", "applr_ros1/msg/Decision", _unpack_decision, _pack_decision
    ),
    "plans": Column(
        "{move_base}/*/global_plan", "nav_msgs/msg/Path", _unpack_plan, _pack_plan, part="planner"
    ),
    "routes": Column(
        "{move_base}/*/plan", "nav_msgs/msg/Path", _unpack_plan, _pack_plan, part="planner"
    ),
    "planned": Column(
        "{move_base}/cmd_vel", "geometry_msgs/msg/Twist", _unpack_command, _pack_command
    ),
    "commands": Column("{command}", "geometry_msgs/msg/Twist", _unpack_command, _pack_command),
    "verdicts": Column("{monitor}/action", "std_msgs/msg/String", _unpack_verdict, _pack_verdict),
    "contacts": Column("{collision}", "std_msgs/msg/Bool", _unpack_contact, _pack_contact),
    "recoveries": Column(
        "{move_base}/recovery_status",
        "move_base_msgs/msg/RecoveryStatus",
        _unpack_recovery,
        _pack_recovery,
    ),
    "ends": Column(
        "{applr}/course_end", "applr_ros1/msg/Decision", _unpack_decision, _pack_decision
    ),
    "results": Column(
        "{move_base}/result",
        "move_base_msgs/msg/MoveBaseActionResult",
        _unpack_result,
        _pack_result,
        part="action",
        part_of="goals",
    ),
}


def column_of(key: str) -> str:
    """Return the column of Drive of a topic of COLUMNS."""
    return COLUMNS[key].part_of or key


def topic_of(key: str, names: TopicNames, part: str = "*") -> str:
    """Return a topic of COLUMNS. `part` replaces `*`: the name of a planner or server, or ""."""
    return COLUMNS[key].topic.format(**vars(names)).replace("*/", f"{part}/" if part else "")
