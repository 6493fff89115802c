"""Largest safe scale of a command: the swept-body geometry of the collision monitor, in numba.

The model of the base has three phases. First the base keeps its measured velocity for as long as
its pose is old. Then it follows the command for the reaction time. Its turn rate may be as
commanded, higher, as measured, or zero. Last, it brakes along the same arc, more gently below .3
m/s. A stop brakes at once along the current arc. The body is a convex outline widened by a margin,
and must not touch any obstacle point, nor what moves, where it may be at the same time (moving.py).
The outline itself must not enter unobserved cells. At the end the base may turn by its yaw swing,
because nearly stopped wheels have unequal friction.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import scipy

from applr_ros1.common.angles import Pose, Twist
from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel
from applr_ros1.monitor.known_space import CELL_M, cell_of
from applr_ros1.monitor.moving import BodyPose, Discs, may_meet, will_meet

CHECK_STEP_S = 0.02  # interval between two checked poses [s]
# The friction limit falls at low speed, and the braking that was measured from full speed does not
# include this. Below LAST_SPEED_M_S [m/s] the Jackal on Gazebo's ground decelerates by .3 to .6
# m/s^2, depending on the wheels' angles.
LAST_SPEED_M_S = 0.3
LAST_DECELERATION_M_S2 = 0.6
# Yaw swing of a base that brakes below LAST_SPEED_M_S [rad]: not exceeded in 98 of 100 simulated
# stops.
SWING_RAD = 0.15
# WAYs of a base to respond to the commanded turn rate: at once, faster, as measured before, as
# measured and without gaining speed, not at all
AT_ONCE, FASTER, AS_BEFORE, LATE, NOT_AT_ALL = range(5)
WAY_COUNT = 5
NO_WAY = -1
AS_MEASURED = -1.0  # value of `turn_share` for a base that continues to turn at its measured rate
# Largest allowed increase of the depth of a point that starts inside the margin [m].
DEEPER_M = 1e-3
HALVINGS = 5  # number of bisections in the search for the largest safe scale
# Distance past the stopping point that must be observed [m]. Partly observed cells count as
# observed, hence 1.5 cells.
BEYOND_M = 1.5 * CELL_M


class BodyOutline(NamedTuple):
    """Outline of the robot's body, for contacts and for unobserved space.

    planes: (k, 3) half_planes() of its outline. edge: (n, 2) edge_points() of its outline [m].
    margin: distance by which the outline is widened where it must not touch obstacle points [m].
    radius: distance of the farthest corner of the widened outline from the origin [m].
    """

    planes: Array
    edge: Array
    margin: float
    radius: float

    @classmethod
    def of(cls, outline: Any, margin: float) -> "BodyOutline":
        """Return an outline (n, 2) [m] that is widened by a margin [m]."""
        planes = half_planes(outline)
        return cls(planes, edge_points(outline), margin, widened_radius(outline, margin))


class Braking(NamedTuple):
    """How the base brakes and turns.

    deceleration: down to LAST_SPEED_M_S [m/s^2]. yaw_deceleration: of the turn rate [rad/s^2].
    turn_gain: largest ratio of actual to commanded turn rate. turn_ahead: distance from the origin
    forward to the centre of rotation [m].
    """

    deceleration: float
    yaw_deceleration: float
    turn_gain: float = 1.0
    turn_ahead: float = 0.0


class BaseMotion(NamedTuple):
    """Motion of the base when a command arrives.

    v, w: velocity [m/s, rad/s]. slip: lateral slip to the left [m/s]. commanded_w: turn rate of the
    previous command [rad/s].
    """

    v: float
    w: float
    slip: float = 0.0
    commanded_w: float = 0.0


class Delay(NamedTuple):
    """Times before the base brakes.

    pose_age: age of the robot's pose, during which it has kept its velocity [s]. reaction: time for
    which it follows the command [s].
    """

    pose_age: float
    reaction: float


class SeenCells(NamedTuple):
    """Observed cells around the robot, with its pose among them.

    cells: as in SeenSpace; without cells, all space counts as observed. corner_i, corner_j: corner
    of SeenSpace. robot: pose of the robot in the frame of the cells.
    """

    cells: np.ndarray
    corner_i: int
    corner_j: int
    robot: BodyPose


# Value if all space is known
EVERYTHING = SeenCells(np.empty((0, 0), np.uint8), 0, 0, BodyPose(0.0, 0.0, 1.0, 0.0))


class SafeScale(NamedTuple):
    """Largest safe factor of a command.

    scale: the factor, 0 to 1. can_stop: False if even braking at once leads to contact.
    """

    scale: float
    can_stop: bool


class Obstacles(NamedTuple):
    """Obstacle points in the robot's frame.

    All are arrays (n,) of contiguous memory, for vector instructions. x, y: positions [m].
    margin_limit, outline_limit: largest allowed depth in the widened body and in the outline [m].
    forward, leftward, depth: scratch memory of is_deeper.
    """

    x: Array
    y: Array
    margin_limit: Array
    outline_limit: Array
    forward: Array
    leftward: Array
    depth: Array


class Check(NamedTuple):
    """All that decides whether a command is safe, except its scale and the turn rate.

    keeps_clear: whether the base must also come to rest out of the way of what moves.
    """

    obstacles: Obstacles
    body: BodyOutline
    motion: BaseMotion
    command: Twist
    delay: Delay
    braking: Braking
    seen: SeenCells
    discs: Discs
    keeps_clear: bool


def half_planes(outline: Any) -> np.ndarray:
    """Return the hull of an outline (n, 2) [m] as half planes (k, 3).

    A point is inside if a x + b y <= c for all rows (a, b, c), where (a, b) has length one.
    """
    equations = scipy.spatial.ConvexHull(outline).equations
    return np.ascontiguousarray(np.column_stack((equations[:, :2], -equations[:, 2])))


def _hull(outline: Any) -> np.ndarray:
    """Return the corners (n, 2) [m] of the hull of an outline, counterclockwise."""
    points = np.asarray(outline, dtype=np.float64)
    corners: np.ndarray = points[scipy.spatial.ConvexHull(points).vertices]
    return corners


def widened_radius(outline: Any, margin: float) -> float:
    """Return the distance from the origin to the farthest corner of a widened outline [m].

    The sides of its hull move outwards by the margin [m], so that sharp corners move farther.
    """
    corners = _hull(outline)
    sides = np.roll(corners, -1, axis=0) - corners
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.hypot(*sides.T)[:, None]
    normals_before = np.roll(normals, 1, axis=0)
    cosines = np.einsum("ij,ij->i", normals, normals_before)
    moved = corners + margin * (normals + normals_before) / (1.0 + cosines)[:, None]
    return float(np.hypot(*moved.T).max())


def edge_points(outline: Any) -> np.ndarray:
    """Return points (n, 2) [m] along the convex hull of an outline.

    They are spaced closer than the cells of SeenSpace.
    """
    corners = _hull(outline)
    edges = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0)):
        count = 2 + int(np.hypot(*(end - start)) / CELL_M)
        edges.append(np.linspace(start, end, count)[1:])
    return np.concatenate(edges)


@kernel
def penetration(planes: Array, margin: float, x: float, y: float) -> float:
    """Return the depth of a point inside the widened body [m]; negative outside."""
    depth = np.inf
    for plane in range(planes.shape[0]):
        depth = min(depth, planes[plane, 2] + margin - planes[plane, 0] * x - planes[plane, 1] * y)
    return depth


@kernel
def safe_scale(
    points: Array,
    body: BodyOutline,
    motions: Array,
    command: Twist,
    delay: Delay,
    braking: Braking,
    seen: SeenCells,
    discs: Discs,
) -> SafeScale:
    """Return the largest scale of a command after which the base can still stop without contact.

    Args:
        points: (n, 2) obstacle points in the robot's frame [m].
        body: body of the robot.
        motions: (m, 4) possible Motions of the base. The scale is safe for all of them.
        command: requested (v, w) [m/s, rad/s].
        delay: times before the base brakes.
        braking: how it brakes and turns.
        seen: observed space, or EVERYTHING.
        discs: (k,) DISCs of what moves.
    """
    obstacles = obstacles_of(points, body)
    smallest = SafeScale(scale=1.0, can_stop=True)
    for number in range(motions.shape[0]):
        motion = BaseMotion(
            motions[number, 0], motions[number, 1], motions[number, 2], motions[number, 3]
        )
        is_among_movers = discs.shape[0] > 0
        check = Check(
            obstacles, body, motion, command, delay, braking, seen, discs, is_among_movers
        )
        if is_among_movers and not _is_free(check, 0.0, AS_MEASURED):
            # Even a base that brakes at once stands in the way of something: rather drive on.
            check = Check(obstacles, body, motion, command, delay, braking, seen, discs, False)
        safe = _safe_scale(check, smallest.scale)
        # If a base that brakes at once stops for one motion and not for another, the worse one
        # counts.
        smallest = SafeScale(safe.scale, smallest.can_stop and safe.can_stop)
    return smallest


@kernel
def _safe_scale(check: Check, largest: float) -> SafeScale:
    """Return the largest safe scale for one motion, at most `largest`."""
    way = AT_ONCE
    if largest > 0.0:
        way = _unsafe_way(check, largest, AT_ONCE)
        if way == NO_WAY:
            return SafeScale(scale=largest, can_stop=True)
    can_stop = _is_free(check, 0.0, AS_MEASURED)
    if largest == 0.0 or not can_stop:
        return SafeScale(scale=0.0, can_stop=can_stop)
    low = 0.0
    high = 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if middle >= largest:
            high = middle
            continue
        # The way that is unsafe at one scale is probably unsafe at the next one.
        unsafe_way = _unsafe_way(check, middle, way)
        if unsafe_way == NO_WAY:
            low = middle
        else:
            high = middle
            way = unsafe_way
    return SafeScale(scale=low, can_stop=True)


@kernel
def obstacles_of(points: Array, body: BodyOutline) -> Obstacles:
    """Return the Obstacles of points (n, 2) [m].

    A point that is inside the body may not get deeper.
    """
    rows = np.empty((7, points.shape[0]))
    obstacles = Obstacles(rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6])
    for point in range(points.shape[0]):
        x = points[point, 0]
        y = points[point, 1]
        depth = penetration(body.planes, 0.0, x, y)
        obstacles.x[point] = x
        obstacles.y[point] = y
        obstacles.margin_limit[point] = max(0.0, depth + body.margin) + DEEPER_M
        obstacles.outline_limit[point] = max(0.0, depth) + DEEPER_M
    return obstacles


def deceleration_at(speed: float, deceleration: float) -> float:
    """Return how fast the base brakes at a speed [m/s^2], from its measured `deceleration`."""
    if speed <= LAST_SPEED_M_S:
        return min(deceleration, LAST_DECELERATION_M_S2)
    return deceleration


def braking_time(speed: float, deceleration: float) -> float:
    """Return the time [s] to brake from a speed >= 0 [m/s].

    The deceleration [m/s^2] is gentler below LAST_SPEED_M_S.
    """
    last_speed = min(speed, LAST_SPEED_M_S)
    last_deceleration = deceleration_at(last_speed, deceleration)
    return (speed - last_speed) / deceleration + last_speed / last_deceleration


@kernel
def on_arc(v: float, command_v: float, command_w: float, previous_w: float) -> float:
    """Return the turn rate [rad/s] at which a base at speed v [m/s] stays on its arc.

    command_v is not 0. The magnitude is at most the larger of command_w and the previous turn rate
    previous_w.
    """
    largest_rate = max(abs(command_w), abs(previous_w))
    return math.copysign(min(abs(command_w * v / command_v), largest_rate), command_w)


@kernel
def _unsafe_way(check: Check, scale: float, likely_way: int) -> int:
    """Return a WAY of the base to respond to a command that is not collision-free, or NO_WAY.

    The base may turn as commanded at once, faster, still as measured, or not at all, and thus leave
    the arc. `likely_way` is tried first.
    """
    turn_gain = check.braking.turn_gain
    _, command_w = check.command
    for number in range(WAY_COUNT):
        way = (number + likely_way) % WAY_COUNT
        turn_share = 1.0
        gains_speed = True
        if way == FASTER:
            if turn_gain == 1.0:
                continue
            turn_share = turn_gain
        elif way == AS_BEFORE:
            turn_share = AS_MEASURED
        elif way == LATE:
            # A base that gains speed late meets what moves at other places.
            if check.discs.shape[0] == 0:
                continue
            turn_share = AS_MEASURED
            gains_speed = False
        elif way == NOT_AT_ALL:
            # Without a commanded turn, the base already goes straight on in the first way.
            if command_w == 0.0:
                continue
            turn_share = 0.0
        if not _is_free(check, scale, turn_share, gains_speed):
            return way
    return NO_WAY


@kernel
def _is_free(check: Check, scale: float, turn_share: float, gains_speed: bool = True) -> bool:
    """Return whether the body touches nothing until the base stands.

    The base keeps its velocity, follows scale * command, and then brakes. turn_share is the ratio
    of actual to commanded turn rate during the reaction time, or AS_MEASURED. A scale of 0 brakes
    at once. Without `gains_speed` it follows only a slower command. The lateral velocity is that of
    a turn about the centre of rotation plus the measured lateral slip. If the base turns faster
    than commanded its tyres must be gripping, so no slip is added.
    """
    body = check.body
    braking = check.braking
    command_v, command_w = check.command
    target_v = scale * command_v
    target_w = scale * command_w
    v = check.motion.v
    w = check.motion.w
    slip = 0.0 if turn_share > 1.0 else check.motion.slip
    # Remaining times of the first and the second phase [s], and largest speed of the third [m/s].
    keeping_left = check.delay.pose_age
    following_left = check.delay.reaction if scale > 0.0 else 0.0
    fastest_braking = 0.0
    time = 0.0
    x = 0.0
    y = 0.0
    yaw = 0.0
    clear_way = 0.0  # length of the way on which the body comes to no point [m]
    place = BodyPose(x, y, 1.0, 0.0)
    while True:
        step = CHECK_STEP_S
        if keeping_left > 0.0:
            step = min(keeping_left, CHECK_STEP_S)
            keeping_left -= CHECK_STEP_S
        elif following_left > 0.0:
            if gains_speed or abs(target_v) < abs(v):
                v = _followed_speed(v, target_v, braking.deceleration * CHECK_STEP_S)
            if turn_share != AS_MEASURED:
                # A base that is still too fast turns as much as keeps it on the arc of the command.
                is_too_fast = target_v * v > 0.0 and abs(v) > abs(target_v)
                w = target_w
                if is_too_fast:
                    w = on_arc(v, target_v, target_w, check.motion.commanded_w)
                w = turn_share * w
            following_left -= CHECK_STEP_S
        else:
            # The deceleration is limited so that no step ends far below LAST_SPEED_M_S.
            down_to_last_speed = (abs(v) - LAST_SPEED_M_S) / CHECK_STEP_S
            largest_deceleration = max(LAST_DECELERATION_M_S2, down_to_last_speed)
            deceleration = min(braking.deceleration, largest_deceleration)
            stop_time = max(abs(v) / deceleration, abs(w) / braking.yaw_deceleration)
            steps_left = stop_time / CHECK_STEP_S
            if steps_left <= 1.0:
                break
            # All velocities reach zero together, so that the base stays on its arc.
            fastest_braking = max(fastest_braking, abs(v))
            v -= v / steps_left
            w -= w / steps_left
            slip -= slip / steps_left

        # The step goes along the heading halfway.
        leftward = slip - braking.turn_ahead * w
        cos_half = math.cos(yaw + 0.5 * w * step)
        sin_half = math.sin(yaw + 0.5 * w * step)
        x += (v * cos_half - leftward * sin_half) * step
        y += (v * sin_half + leftward * cos_half) * step
        yaw += w * step
        time += step
        place = BodyPose(x, y, math.cos(yaw), math.sin(yaw))
        clear_way -= math.hypot(v, leftward) * step
        if clear_way <= 0.0:
            clear_way = _nearest(check.obstacles, x, y) - body.radius
        limits = check.obstacles.margin_limit
        if clear_way <= 0.0 and is_deeper(check.obstacles, limits, body.planes, body.margin, place):
            return False
        if not is_seen(check.seen, body.edge, place):
            return False
        if may_meet(check.discs, body.planes, body.edge, body.margin, place, time):
            return False

    swing = SWING_RAD * min(fastest_braking / LAST_SPEED_M_S, 1.0)
    if not _is_seen_beyond(check.seen, body.edge, (x, y, yaw), target_v, target_w):
        return False
    if check.keeps_clear and will_meet(
        check.discs, body.planes, body.edge, body.margin, place, time
    ):
        return False
    return _may_swing(check.obstacles, body.planes, braking.turn_ahead, (x, y, yaw), swing)


@kernel
def _followed_speed(v: float, target_v: float, largest_change: float) -> float:
    """Return the speed [m/s] after a step in which a base at speed v follows a command.

    Worst case: the base gains speed at once, and loses speed only as fast as it can brake.
    """
    if abs(target_v) >= abs(v) and target_v * v >= 0.0:
        return target_v
    return min(max(target_v, v - largest_change), v + largest_change)


@kernel
def _nearest(obstacles: Obstacles, x: float, y: float) -> float:
    """Return the distance from a place to the nearest obstacle point [m]."""
    nearest_square = np.inf
    for point in range(obstacles.x.shape[0]):
        apart_x = obstacles.x[point] - x
        apart_y = obstacles.y[point] - y
        nearest_square = min(nearest_square, apart_x * apart_x + apart_y * apart_y)
    return math.sqrt(nearest_square)


@kernel
def is_deeper(
    obstacles: Obstacles, limits: Array, planes: Array, margin: float, place: BodyPose
) -> bool:
    """Return whether any point's penetration() is above its limit (n,) with the body at `place`.

    The loops run over all points, plane by plane, without an early exit, so that they compile to
    vector instructions.
    """
    forward = obstacles.forward
    leftward = obstacles.leftward
    depth = obstacles.depth
    count = limits.shape[0]
    for point in range(count):
        offset_x = obstacles.x[point] - place.x
        offset_y = obstacles.y[point] - place.y
        forward[point] = place.cos_yaw * offset_x + place.sin_yaw * offset_y
        leftward[point] = place.cos_yaw * offset_y - place.sin_yaw * offset_x
        depth[point] = np.inf
    for plane in range(planes.shape[0]):
        a = planes[plane, 0]
        b = planes[plane, 1]
        extent = planes[plane, 2] + margin
        for point in range(count):
            depth[point] = min(depth[point], extent - a * forward[point] - b * leftward[point])
    is_deeper = False
    for point in range(count):
        is_deeper |= depth[point] > limits[point]
    return is_deeper


@kernel
def _may_swing(
    obstacles: Obstacles, planes: Array, turn_ahead: float, pose: Pose, swing: float
) -> bool:
    """Return whether the outline at a pose may turn by `swing` [rad] to both sides.

    It turns about the centre of rotation. In Gazebo, a base that braked in a turn swung into a post
    beside its arc. The margin is left out, because few stops swing by as much as SWING_RAD.
    """
    if swing == 0.0:
        return True
    x, y, yaw = pose
    centre_x = x + turn_ahead * math.cos(yaw)
    centre_y = y + turn_ahead * math.sin(yaw)
    # Angles between these two need no test of their own: what the included robots would meet only
    # there is at most 2.5 cm deep in their outline, less than the margin.
    for swung_yaw in (yaw - swing, yaw + swing):
        cos_yaw = math.cos(swung_yaw)
        sin_yaw = math.sin(swung_yaw)
        swung_x = centre_x - turn_ahead * cos_yaw
        swung_y = centre_y - turn_ahead * sin_yaw
        place = BodyPose(swung_x, swung_y, cos_yaw, sin_yaw)
        if is_deeper(obstacles, obstacles.outline_limit, planes, 0.0, place):
            return False
    return True


@kernel
def is_seen(seen: SeenCells, edge: Array, place: BodyPose) -> bool:
    """Return whether the body's whole edge lies in observed cells with the body at `place`."""
    side_cells = seen.cells.shape[0]
    if side_cells == 0:
        return True
    robot = seen.robot
    first_i = seen.corner_i % side_cells
    first_j = seen.corner_j % side_cells
    for number in range(edge.shape[0]):
        # From the body's frame to that of the robot, and on to that of the cells.
        robot_x = place.x + place.cos_yaw * edge[number, 0] - place.sin_yaw * edge[number, 1]
        robot_y = place.y + place.sin_yaw * edge[number, 0] + place.cos_yaw * edge[number, 1]
        i = cell_of(robot.x + robot.cos_yaw * robot_x - robot.sin_yaw * robot_y) - seen.corner_i
        j = cell_of(robot.y + robot.sin_yaw * robot_x + robot.cos_yaw * robot_y) - seen.corner_j
        if not (0 <= i < side_cells and 0 <= j < side_cells):
            return False
        # Both are below 2 side_cells, so a comparison replaces the slow modulo.
        row = i + first_i
        column = j + first_j
        if row >= side_cells:
            row -= side_cells
        if column >= side_cells:
            column -= side_cells
        if not seen.cells[row, column]:
            return False
    return True


@kernel
def fastest_of(edge: Array, v: float, w: float) -> float:
    """Return the speed of the fastest point of a body's edge (n, 2) [m/s]."""
    fastest = 0.0
    for number in range(edge.shape[0]):
        fastest = max(fastest, math.hypot(v - w * edge[number, 1], w * edge[number, 0]))
    return fastest


@kernel
def _is_seen_beyond(seen: SeenCells, edge: Array, pose: Pose, v: float, w: float) -> bool:
    """Return whether the space BEYOND_M past the stopping pose is observed.

    True if the command is a stop. The robot is assumed to go on as commanded, v [m/s] and w
    [rad/s], without slip to the side: it is not about to brake there.
    """
    fastest = fastest_of(edge, v, w)
    if fastest == 0.0:
        return True
    x, y, yaw = pose
    time = BEYOND_M / fastest
    x += v * time * math.cos(yaw + 0.5 * w * time)
    y += v * time * math.sin(yaw + 0.5 * w * time)
    yaw += w * time
    return is_seen(seen, edge, BodyPose(x, y, math.cos(yaw), math.sin(yaw)))
