"""Planar simulator without a physics engine, KinematicSimulator, for training at high throughput.

Interface, laser, odometry, wheels and tyres are the same as in PybulletSimulator. Contacts are
solved in the plane. Three numbers of the robot's description (wheel_rub, body_rub, undo) are fitted
to PybulletSimulator. They account for three-dimensional effects, such as a wheel that climbs an
obstacle.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, ceil, cos, hypot, inf, sin
from typing import NamedTuple, Tuple

import numpy as np

from applr_ros1.common.angles import Pose, transform_point
from applr_ros1.common.arrays import Array
from applr_ros1.common.kernels import kernel

from . import wheels
from .mechanics import STEP
from .records import Records, record, record_type
from .simulator import SOON_S, Simulator
from .wheels import Vector, Vehicle

_MARGIN_M = 0.02  # distance below which contacts are tracked [m]
_UNDONE_M_S = 1.0  # largest speed at which an overlap is resolved [m/s]
_SWEEPS = 8  # number of solver iterations over all contacts
_MOST_CONTACTS = 24  # largest number of simultaneous contacts
_PUSHED_M_S = 0.5  # largest speed above the robot's own at which a moving obstacle pushes it [m/s]
# Apparent speed above which a moving obstacle has jumped back to the start of its animation [m/s]
JUMP_M_S = 10.0


@dataclass
class BodyState:
    """State of the robot's body."""

    x: float = 0.0  # pose of the centre of mass in the world [m, m, rad]
    y: float = 0.0
    yaw: float = 0.0
    forward: float = 0.0  # velocity of the centre of mass in the body frame [m/s]
    leftward: float = 0.0
    yaw_rate: float = 0.0  # [rad/s]
    rolled: float = 0.0  # mean speed of the rims in the last drive() [m/s]
    touched: float = 0.0  # 1 if there was a contact in the last drive()


@dataclass
class Contact:
    """Contact of a part of the outline with an obstacle, in the body frame."""

    depth: float  # overlap, negative for a gap [m]
    x: float  # contact point [m]
    y: float
    normal_x: float  # direction in which the obstacle pushes the robot
    normal_y: float
    part: float  # index of the part: 0 is the body, or the first part of a round body
    forward: float  # velocity of the obstacle [m/s]
    leftward: float
    push: float  # sum of the normal impulses in the current step [N s]
    rub: float  # sum of the friction impulses in the current step [N s]


CONTACT = record_type(Contact)


class TouchGeometry(NamedTuple):
    """Geometry of a contact, see Contact."""

    depth: float
    x: float
    y: float
    normal_x: float
    normal_y: float


class KinematicSimulator(Simulator):
    """Planar simulated robot; see Simulator.

    Attributes:
        body: Record (1,) of the present BodyState.
    """

    def _place(self, pose: Pose, new_world: bool) -> None:
        # The arrays of a world are made once, and all drives in it share them.
        if new_world:
            self._circles = np.zeros((len(self.world.cylinders), 5))
            self._circles[:, :3] = self.world.cylinders
            self._boxes = np.ascontiguousarray(self.world.boxes, dtype=np.float64).reshape(-1, 5)
        self._move_to(pose)

    def _move_to(self, pose: Pose) -> None:
        self._reset_wheels()
        x, y = transform_point(pose, *self._mechanics.com)
        self.body = record(BodyState(x, y, pose[2]))

    def _drive(self, steps: int) -> None:
        """Simulate some steps of STEP, and store the state after them."""
        duration = steps * STEP
        shape = (steps, wheels.noises(self._supports))
        noise = np.zeros(shape)  # Gazebo's wheels have no noise.
        if self._surface.ground < 1.0:
            noise = self._noise.standard_normal(shape)
        drive(
            self.body,
            self.vehicle,
            self._supports,
            self._schedule(steps),
            self._circles_during(duration),
            self._boxes,
            self._mechanics.parts,
            self._table,
            noise,
        )
        self._steps += steps

        body = BodyState(*self.body[0].item())
        com_x, com_y = self._mechanics.com
        # base_link moves with the centre of mass, and around it in a turn.
        twist = body.forward + body.yaw_rate * com_y, body.yaw_rate
        # From the centre of mass back to base_link
        x, y = transform_point((body.x, body.y, body.yaw), -com_x, -com_y)
        self._update((x, y, body.yaw), twist, body.rolled, duration, body.touched > 0.0)

    def _circles_during(self, duration: float) -> Array:
        """Return the obstacles that are circles during the next `duration` [s].

        The columns (n, 5) are x, y, radius [m] and velocity x, y [m/s].
        """
        if not self.world.movers:
            return self._circles
        start = self._steps * STEP
        circles = self.passers_by.circles(start)
        later_circles = self.passers_by.circles(start + duration)
        velocity = (later_circles - circles)[:, :2] / duration
        # An obstacle that starts its animation again pushes nothing on the way.
        velocity[np.hypot(*velocity.T) > JUMP_M_S] = 0.0
        return np.concatenate([self._circles, np.hstack([circles, velocity])])

    def _schedule(self, steps: int) -> Array:
        """Return the velocity targets (k, 3): first step, v [m/s] and w [rad/s] of each."""
        start = self._steps
        command = self._command
        targets = [(0, *self._target(start * STEP))]
        step = 0
        last_time = (start + steps - 1) * STEP
        while True:  # There is one iteration per command or time-out.
            change_time = inf
            if command.pending:
                change_time = command.pending[0].time
            if (start + step) * STEP < command.until - SOON_S:
                change_time = min(change_time, command.until)
            if change_time - SOON_S > last_time:
                return np.array(targets)
            # The first step that begins after the change. Rounding must not repeat the last one.
            step = max(step + 1, ceil((change_time - SOON_S) / STEP) - start)
            targets.append((step, *self._target((start + step) * STEP)))


@kernel
def _circle_contact(x: float, y: float, radius: float, part: Array) -> TouchGeometry:
    """Return the contact of a circle at (x, y) in the body frame [m] with one part (4,)."""
    part_x, part_y, half_length, half_width = part[0], part[1], part[2], part[3]
    x -= part_x
    y -= part_y
    nearest_x = min(max(x, -half_length), half_length)
    nearest_y = min(max(y, -half_width), half_width)
    gap = hypot(x - nearest_x, y - nearest_y)
    if gap > 0.0:
        return TouchGeometry(
            radius - gap,
            part_x + nearest_x,
            part_y + nearest_y,
            (nearest_x - x) / gap,
            (nearest_y - y) / gap,
        )
    # The centre is under the robot, so the nearest side pushes.
    if half_length - abs(x) < half_width - abs(y):
        direction = 1.0 if x > 0.0 else -1.0
        depth = radius + half_length - abs(x)
        return TouchGeometry(depth, part_x + direction * half_length, part_y + y, -direction, 0.0)
    direction = 1.0 if y > 0.0 else -1.0
    depth = radius + half_width - abs(y)
    return TouchGeometry(depth, part_x + x, part_y + direction * half_width, 0.0, -direction)


@kernel
def _box_contact(
    x: float, y: float, axis: Tuple[float, float], half_x: float, half_y: float, part: Array
) -> TouchGeometry:
    """Return the contact of a box with one part (4,): the smallest overlap along four axes.

    The box at (x, y) in the body frame has the half sizes half_x along `axis`, a unit vector, and
    half_y across [m].
    """
    part_x, part_y, half_length, half_width = part[0], part[1], part[2], part[3]
    axis_x, axis_y = axis
    x -= part_x
    y -= part_y
    depth = np.inf
    normal_x = 0.0
    normal_y = 0.0
    own_side = True  # whether the smallest overlap is along an axis of the part, not of the box
    directions = ((1.0, 0.0), (0.0, 1.0), (axis_x, axis_y), (-axis_y, axis_x))
    for number, (direction_x, direction_y) in enumerate(directions):
        distance = x * direction_x + y * direction_y
        if distance < 0.0:  # The direction points from the part to the box.
            direction_x = -direction_x
            direction_y = -direction_y
            distance = -distance
        along_share = abs(axis_x * direction_x + axis_y * direction_y)
        across_share = abs(axis_x * direction_y - axis_y * direction_x)
        part_reach = half_length * abs(direction_x) + half_width * abs(direction_y)
        reach = part_reach + half_x * along_share + half_y * across_share
        # Of equal overlaps the first counts, so that rounding does not choose the direction.
        if reach - distance < depth - 1e-9:
            depth = reach - distance
            normal_x = -direction_x
            normal_y = -direction_y
            own_side = number < 2
    if own_side:
        # A corner of the box touches a side of the part: the corner farthest along the normal.
        sign_x = 1.0 if normal_x * axis_x + normal_y * axis_y > 0.0 else -1.0
        sign_y = 1.0 if normal_y * axis_x - normal_x * axis_y > 0.0 else -1.0
        corner_x = x + sign_x * half_x * axis_x - sign_y * half_y * axis_y
        corner_y = y + sign_x * half_x * axis_y + sign_y * half_y * axis_x
        touch_x = min(max(corner_x, -half_length), half_length)
        touch_y = min(max(corner_y, -half_width), half_width)
    else:
        # A corner of the part touches a side of the box: the corner farthest against the normal.
        touch_x = -half_length if normal_x > 0.0 else half_length
        touch_y = -half_width if normal_y > 0.0 else half_width
    return TouchGeometry(depth, part_x + touch_x, part_y + touch_y, normal_x, normal_y)


@kernel
def _add_contact(
    contacts: Records, count: int, touch: TouchGeometry, part: int, velocity: Tuple[float, float]
) -> int:
    """Write the contact of one part as number `count`, and return the number of contacts.

    A contact with a gap above _MARGIN_M is omitted. `velocity` is that of the obstacle in the body
    frame [m/s].
    """
    if touch.depth <= -_MARGIN_M or count >= _MOST_CONTACTS:
        return count
    contact = contacts[count]
    contact.depth = touch.depth
    contact.x = touch.x
    contact.y = touch.y
    contact.normal_x = touch.normal_x
    contact.normal_y = touch.normal_y
    contact.part = part
    contact.forward = velocity[0]
    contact.leftward = velocity[1]
    contact.push = 0.0
    contact.rub = 0.0
    return count + 1


@kernel
def _find_contacts(
    x: float,
    y: float,
    cos_yaw: float,
    sin_yaw: float,
    parts: Array,
    reach: float,
    circles: Array,
    boxes: Array,
    contacts: Records,
) -> int:
    """Write the contacts of a robot at (x, y) [m] among obstacles, and return their number.

    `reach` [m] is the radius of a circle around all `parts` (k, 4) of Mechanics. `contacts` has
    room for _MOST_CONTACTS.
    """
    count = 0
    reach = reach + _MARGIN_M
    for row in range(circles.shape[0]):
        offset_x = circles[row, 0] - x
        offset_y = circles[row, 1] - y
        radius = circles[row, 2]
        distance = radius + reach
        if offset_x * offset_x + offset_y * offset_y >= distance * distance:
            continue
        # Place and velocity in the body frame
        body_x = cos_yaw * offset_x + sin_yaw * offset_y
        body_y = cos_yaw * offset_y - sin_yaw * offset_x
        velocity_x = circles[row, 3]
        velocity_y = circles[row, 4]
        forward = cos_yaw * velocity_x + sin_yaw * velocity_y
        leftward = cos_yaw * velocity_y - sin_yaw * velocity_x
        for part in range(parts.shape[0]):
            touch = _circle_contact(body_x, body_y, radius, parts[part])
            count = _add_contact(contacts, count, touch, part, (forward, leftward))
    for row in range(boxes.shape[0]):
        offset_x = boxes[row, 0] - x
        offset_y = boxes[row, 1] - y
        half_x = 0.5 * boxes[row, 3]
        half_y = 0.5 * boxes[row, 4]
        cos_box = cos(boxes[row, 2])
        sin_box = sin(boxes[row, 2])
        # Distance beyond the sides of the box, along its axes
        gap_along = abs(cos_box * offset_x + sin_box * offset_y) - half_x
        gap_across = abs(cos_box * offset_y - sin_box * offset_x) - half_y
        if gap_along > reach or gap_across > reach:
            continue
        body_x = cos_yaw * offset_x + sin_yaw * offset_y
        body_y = cos_yaw * offset_y - sin_yaw * offset_x
        axis_x = cos_yaw * cos_box + sin_yaw * sin_box
        axis_y = cos_yaw * sin_box - sin_yaw * cos_box
        axis = axis_x, axis_y
        for part in range(parts.shape[0]):
            touch = _box_contact(body_x, body_y, axis, half_x, half_y, parts[part])
            count = _add_contact(contacts, count, touch, part, (0.0, 0.0))
    return count


@kernel
def _press(velocity: Vector, contacts: Records, vehicle: Vehicle) -> Vector:
    """Return the velocity (forward, leftward, yaw_rate) after the impulses of `contacts` (n,).

    Stores the impulses in the contacts.
    Normal impulses limit the approach to the gap and resolve a share `undo` of an overlap. Coulomb
    friction acts with coefficient `wheel_rub` at wheels and `body_rub` at the body. The front or
    back of a wheel also rubs up or down the obstacle, which leaves less friction against lateral
    motion.
    """
    constants = vehicle.constants
    drivetrain = vehicle.drivetrain
    forward, leftward, yaw_rate = velocity
    mass = constants.mass
    inertia = constants.yaw_inertia
    # Sequential impulses: each contact corrects the velocity that the contacts before it have left.
    # The sums of the impulses stay non-negative and within friction, single impulses need not.
    for _ in range(_SWEEPS):
        for row in range(contacts.shape[0]):
            contact = contacts[row]
            x = contact.x
            y = contact.y

            # Normal impulse: the approach ends at the obstacle, and an overlap is resolved step by
            # step.
            normal_x = contact.normal_x
            normal_y = contact.normal_y
            lever = x * normal_y - y * normal_x
            softness = 1.0 / mass + lever * lever / inertia  # change of the speed per impulse
            slip_x = forward - yaw_rate * y - contact.forward
            slip_y = leftward + yaw_rate * x - contact.leftward
            speed = slip_x * normal_x + slip_y * normal_y
            if contact.depth < 0.0:
                wanted_speed = contact.depth / STEP
            else:
                wanted_speed = min(constants.undo * contact.depth / STEP, _UNDONE_M_S)
            push = max(0.0, contact.push + (wanted_speed - speed) / softness)
            impulse = push - contact.push
            contact.push = push
            forward += impulse * normal_x / mass
            leftward += impulse * normal_y / mass
            yaw_rate += impulse * lever / inertia
            if push <= 0.0:
                continue

            # Friction impulse along the obstacle, at most the coefficient times the normal impulse
            tangent_x = -normal_y
            tangent_y = normal_x
            lever = x * tangent_y - y * tangent_x
            softness = 1.0 / mass + lever * lever / inertia
            slip_x = forward - yaw_rate * y - contact.forward
            slip_y = leftward + yaw_rate * x - contact.leftward
            speed = slip_x * tangent_x + slip_y * tangent_y
            limit = constants.body_rub * push
            if contact.part > 0.0:
                rim = drivetrain.left_rim
                if int(contact.part) % 2 == 0:  # The wheels follow the body, left before right.
                    rim = drivetrain.right_rim
                # The friction points against the sum of the lateral slip and the rim's rise.
                upwards = rim * abs(normal_x)
                limit = constants.wheel_rub * push * abs(speed) / (hypot(speed, upwards) + 1e-6)
            rub = min(max(contact.rub - speed / softness, -limit), limit)
            impulse = rub - contact.rub
            contact.rub = rub
            forward += impulse * tangent_x / mass
            leftward += impulse * tangent_y / mass
            yaw_rate += impulse * lever / inertia
    return forward, leftward, yaw_rate


@kernel
def _near(obstacles: Array, radii: Array, x: float, y: float, distance: float) -> Array:
    """Return a copy of the obstacles (n, 5) within `distance` [m] of (x, y).

    `radii` (n,) are those of circles around the obstacles [m].
    """
    offset_x = obstacles[:, 0] - x
    offset_y = obstacles[:, 1] - y
    limit = radii + distance
    return obstacles[offset_x * offset_x + offset_y * offset_y < limit * limit]


@kernel
def drive(
    bodies: Records,
    vehicles: Records,
    supports: Records,
    targets: Array,
    circles: Array,
    boxes: Array,
    parts: Array,
    table: Array,
    noise: Array,
) -> None:
    """Advance a robot by one step of STEP for each row of `noise`.

    Args:
        bodies: Record (1,) of BodyState, which is updated.
        vehicles: Record (1,) of wheels.Vehicle, which is updated.
        supports: Records (n,) of Support, which are updated.
        targets: Velocity targets (k, 3): first step, v [m/s] and w [rad/s] of each.
        circles: Obstacles (n, 5): x, y, radius [m], velocity x, y [m/s].
        boxes: Obstacles (m, 5): x, y, yaw, size_x, size_y [m, rad].
        parts: Rectangles (k, 4) of Mechanics.
        table: wheels.rim_table().
        noise: Standard normal random numbers (steps, wheels.noises()).
    """
    body: BodyState = bodies[0]
    vehicle: Vehicle = vehicles[0]
    constants = vehicle.constants
    drivetrain = vehicle.drivetrain
    steps = len(noise)

    # Only obstacles that the robot can reach in this drive are tested in each step.
    distance = constants.reach + _MARGIN_M + steps * STEP * (constants.max_speed + _PUSHED_M_S)
    circles = _near(circles, circles[:, 2], body.x, body.y, distance)
    box_radii = 0.5 * np.hypot(boxes[:, 3], boxes[:, 4])
    boxes = _near(boxes, box_radii, body.x, body.y, distance)
    contacts = np.empty(_MOST_CONTACTS, CONTACT)

    # Local variables, because the compiler keeps them in registers
    x = body.x
    y = body.y
    yaw = body.yaw
    forward = body.forward
    leftward = body.leftward
    yaw_rate = body.yaw_rate
    touched = False
    rolled = 0.0
    target = 0
    for step in range(steps):
        while target + 1 < targets.shape[0] and targets[target + 1, 0] <= step:
            target += 1
        command = targets[target, 1], targets[target, 2]
        wheels.turn_wheels(vehicle, supports, command, table, noise[step])
        rolled += 0.5 * (drivetrain.left_rim + drivetrain.right_rim)
        change = wheels.tyres(vehicle, supports, (forward, leftward, yaw_rate))
        forward += change[0]
        leftward += change[1]
        yaw_rate += change[2]

        cos_yaw = cos(yaw)
        sin_yaw = sin(yaw)
        count = _find_contacts(
            x, y, cos_yaw, sin_yaw, parts, constants.reach, circles, boxes, contacts
        )
        if count > 0:
            velocity = (forward, leftward, yaw_rate)
            forward, leftward, yaw_rate = _press(velocity, contacts[:count], vehicle)
            for row in range(count):
                touched |= contacts[row].push > 0.0
        for row in range(circles.shape[0]):
            circles[row, 0] += STEP * circles[row, 3]
            circles[row, 1] += STEP * circles[row, 4]

        x += STEP * (cos_yaw * forward - sin_yaw * leftward)
        y += STEP * (sin_yaw * forward + cos_yaw * leftward)
        yaw += STEP * yaw_rate
        # The velocity stays the same in the world, and the axes of the body turn.
        cos_turn = cos(STEP * yaw_rate)
        sin_turn = sin(STEP * yaw_rate)
        ahead = cos_turn * forward + sin_turn * leftward
        leftward = cos_turn * leftward - sin_turn * forward
        forward = ahead
    body.x = x
    body.y = y
    body.yaw = atan2(sin(yaw), cos(yaw))
    body.forward = forward
    body.leftward = leftward
    body.yaw_rate = yaw_rate
    body.rolled = rolled / steps
    body.touched = 1.0 if touched else 0.0
