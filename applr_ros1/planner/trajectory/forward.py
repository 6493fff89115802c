"""Search for the best forward sample of a cycle without rolling out the samples that cannot win.

Called by sampling.py. Samples wait in a heap, ordered by a lower bound of their cost. The sample with the lowest bound
is scored next, and the search ends when no bound beats the best cost. See docs/explanation/planner.md, section 6.4.

Poses for bounds come from closed forms, which differ from the exact poses by rounding errors. A cell is therefore used
only if the pose is far enough from a cell border. A bound never exceeds the exact cost, and no result depends on the
closed forms.
"""

import math
from typing import Tuple

from applr_ros1.common.arrays import Data
from applr_ros1.common.kernels import kernel
from applr_ros1.planner.costmap.footprint_cost import UNSURE, on_border, outline_cost, outline_of
from applr_ros1.planner.costmap.grid import world_to_map
from applr_ros1.planner.distance_grid import at_least, place
from applr_ros1.planner.sampling_planner import LARGEST_TURN, Record, sift_down, small_turn
from applr_ros1.planner.trajectory import scoring
from applr_ros1.planner.trajectory.records import Grids, Scene, Scratch
from applr_ros1.planner.trajectory.scoring import HUGE, NO_CEILING, new_velocity, step_count

Ground = Tuple[
    float, float, float, int, int
]  # the map's origin (x, y) [m], resolution [m] and size [cells]
MARGIN = 1e-6  # smallest distance to a border [cells] at which a cell is certain; closed forms err by 1e-10 cells


@kernel
def ramp(
    p: Record, start: Data, c: float, s: float, vx: float, w: float, dt: float, moves: int
) -> Tuple[int, float, float, float, float]:
    """Return (moves made, x, y, c, s) once the base moves at (vx, w) of the sample, at the latest after `moves` moves.

    c, s: cosine and sine of the heading, as arguments at the start, as results at the end.
    """
    x, y, vx_i, vy_i, w_i = start[0], start[1], start[3], start[4], start[5]
    for i in range(moves):
        if vx_i == vx and w_i == w and vy_i == 0.0:
            return i, x, y, c, s
        vx_i = new_velocity(vx, vx_i, p.acc_lim_x, dt)
        vy_i = new_velocity(0.0, vy_i, p.acc_lim_y, dt)
        w_i = new_velocity(w, w_i, p.acc_lim_theta, dt)
        x += (vx_i * c - vy_i * s) * dt
        y += (vx_i * s + vy_i * c) * dt
        turn = w_i * dt
        if abs(turn) < 0.25:
            dc, ds = small_turn(turn)
        else:
            dc, ds = math.cos(turn), math.sin(turn)
        c, s = c * dc - s * ds, s * dc + c * ds
    return moves, x, y, c, s


@kernel
def along_arc(
    x: float, y: float, c: float, s: float, length: float, turn: float, n: int
) -> Tuple[float, float]:
    """Return the position after n moves of `length` [m] and `turn` [rad] each, by the chord of the polygon of moves.

    x, y: position at the start. c, s: cosine and sine of the heading at the start. |turn| must not exceed LARGEST_TURN.
    """
    half = 0.5 * turn
    dc, ds = small_turn(half)
    mc = math.cos((n - 1) * half)
    ms = math.sin((n - 1) * half)
    ratio = (ms * dc + mc * ds) / ds if half != 0.0 else float(n)
    return x + length * ratio * (c * mc - s * ms), y + length * ratio * (s * mc + c * ms)


@kernel
def exact_end(p: Record, start: Data, vx: float, w: float, steps: int) -> Tuple[float, float]:
    """Return (x, y) of the last scored point, computed step by step as in scoring.score_below."""
    dt = p.sim_time / steps
    x, y, theta, vx_i, vy_i, w_i = start[0], start[1], start[2], start[3], start[4], start[5]
    for _ in range(steps - 1):
        vx_i = new_velocity(vx, vx_i, p.acc_lim_x, dt)
        vy_i = new_velocity(0.0, vy_i, p.acc_lim_y, dt)
        w_i = new_velocity(w, w_i, p.acc_lim_theta, dt)
        x, y = scoring.advance(x, y, theta, vx_i, vy_i, math.cos(theta), math.sin(theta), dt)
        theta = theta + w_i * dt
    return x, y


@kernel(error_model="numpy")
def end_cell(
    p: Record, ground: Ground, start: Data, c: float, s: float, vx: float, w: float
) -> Tuple[int, int]:
    """Return the cell of the sample's last point, (-1, -1) if off the map. c, s: cosine and sine of the heading."""
    ox, oy, resolution, nx, ny = ground
    steps = step_count(p, vx, 0.0, w)
    dt = p.sim_time / steps
    turn = w * dt
    x = y = 0.0
    sure = abs(turn) <= LARGEST_TURN
    if sure:
        moves, x, y, c, s = ramp(p, start, c, s, vx, w, dt, steps - 1)
        x, y = along_arc(x, y, c, s, vx * dt, turn, steps - 1 - moves)
    if (
        not sure
        or on_border((x - ox) / resolution, MARGIN)
        or on_border((y - oy) / resolution, MARGIN)
    ):
        x, y = exact_end(p, start, vx, w, steps)
    return world_to_map(x, y, ox, oy, resolution, nx, ny)


@kernel(error_model="numpy")
def probe(
    p: Record,
    scene: Scene,
    start: Data,
    c: float,
    s: float,
    vx: float,
    w: float,
    occupied: int,
    allowed: int,
) -> int:
    """Return a lower bound of the sample's obstacle cost from a few of its poses, or -1 if one of them is illegal.

    The bound starts from `occupied`. The probe ends once the bound exceeds `allowed`. It tests the last pose, then the
    poses at halves, quarters and eighths of the way. c, s: cosine and sine of the heading at the start.
    """
    steps = step_count(p, vx, 0.0, w)
    dt = p.sim_time / steps
    turn = w * dt
    if abs(turn) > LARGEST_TURN or scene.footprint.shape[0] < 3:
        return occupied
    moves, x0, y0, c, s = ramp(p, start, c, s, vx, w, dt, steps - 1)
    outline = outline_of(scene, scene.footprint)
    left = steps - 1 - moves
    parts = 1
    while parts <= 8 and left // parts >= 8:
        for i in range(1, parts + 1, 2):
            n = left * i // parts
            x, y = along_arc(x0, y0, c, s, vx * dt, turn, n)
            dc = math.cos(n * turn)
            ds = math.sin(n * turn)
            cost = outline_cost(outline, x, y, c * dc - s * ds, s * dc + c * ds, 0, 0, MARGIN)
            if cost == UNSURE:
                continue
            if cost < 0:
                return -1
            occupied = max(occupied, cost)
            if occupied > allowed:
                return occupied
        parts *= 2
    return occupied


@kernel(error_model="numpy")
def best_forward(
    p: Record,
    scene: Scene,
    grids: Grids,
    scratch: Scratch,
    start: Data,
    vs: Data,
    ws: Data,
    occupied: int,
) -> Tuple[float, float, float, int]:
    """Return (cost, vx, w, number of points) of the best forward sample, or HUGE and no points if none is legal.

    Each speed in `vs` is combined first with w = 0, then with all values of `ws` but the last. Among equal costs, the
    first sample wins. occupied: cost at the first pose, which all samples share.
    """
    _, _, bases, keys, heap, probed, _ = scratch
    nw = ws.shape[0]
    c = math.cos(start[2])
    s = math.sin(start[2])
    count = _bound(p, scene, grids, scratch, start, vs, ws, occupied)
    best = HUGE
    best_sample = best_points = 0
    best_vx = best_w = 0.0
    while count > 0:
        sample = heap[0]
        if keys[sample] > best or (keys[sample] == best and sample > best_sample):
            break
        vx = vs[sample // nw]
        w = ws[sample % nw - 1] if sample % nw > 0 else 0.0
        hopeless = False
        if not probed[sample]:
            probed[sample] = 1
            allowed = NO_CEILING if best == HUGE else (best - bases[sample]) / p.occdist_scale + 1.0
            met = probe(p, scene, start, c, s, vx, w, occupied, allowed)
            hopeless = met < 0
            if met > occupied:
                keys[sample] = bases[sample] + p.occdist_scale * met
                sift_down(heap, keys, count, 0)
                continue
        if not hopeless:
            cost, n, _, _, _ = scoring.score_below(
                p, scene, grids, start, (vx, 0.0, w), NO_CEILING, bases[sample], best
            )
            if cost >= 0 and (cost < best or (cost == best and sample < best_sample)):
                best, best_sample, best_points, best_vx, best_w = cost, sample, n, vx, w
        count -= 1
        heap[0] = heap[count]
        sift_down(heap, keys, count, 0)
    return best, best_vx, best_w, best_points


@kernel(error_model="numpy")
def _bound(
    p: Record,
    scene: Scene,
    grids: Grids,
    scratch: Scratch,
    start: Data,
    vs: Data,
    ws: Data,
    occupied: int,
) -> int:
    """Fill bases (lower bounds of path and goal terms), keys (lower bounds of costs) and heap; return the heap's size.

    The heap holds the samples that may win. The floods continue until they reach the samples' last cells, but only
    little beyond the robot's range, because cells behind walls might require a flood of the whole map.
    """
    _, _, bases, keys, heap, probed, _ = scratch
    cells, ox, oy, resolution, _, _, _ = scene
    path, goal, _ = grids
    path_distances, goal_distances = path.distance, goal.distance
    ny, nx = cells.shape
    n = nx * ny
    ground = ox, oy, resolution, nx, ny
    exact = (
        not p.simple_attractor and not p.heading_scoring
    )  # With these options only the obstacle term is known here.
    c = math.cos(start[2])
    s = math.sin(start[2])
    travel = (max(abs(start[3]), abs(vs[0]), abs(vs[-1])) + abs(start[4])) * p.sim_time / resolution
    reach = int(min(3.0 * travel, float(n))) + 8
    k = place(path, int((start[0] - ox) / resolution), int((start[1] - oy) / resolution))
    path_limit = min(int(path_distances[k]), n) + reach
    goal_limit = min(int(goal_distances[k]), n) + reach
    count = 0
    for i in range(vs.shape[0]):
        for j in range(ws.shape[0]):
            base = 0.0
            if exact:
                cx, cy = end_cell(p, ground, start, c, s, vs[i], ws[j - 1] if j > 0 else 0.0)
                if cx < 0:
                    continue
                k = place(path, cx, cy)
                path_distance = int(path_distances[k])
                goal_distance = int(goal_distances[k])
                if path_distance > n:
                    path_distance = at_least(path, k, path_limit)
                if goal_distance > n:
                    goal_distance = at_least(goal, k, goal_limit)
                if path_distance >= n or goal_distance >= n:
                    continue
                base = scoring.terms(p, float(path_distance), float(goal_distance))
            sample = i * ws.shape[0] + j
            bases[sample] = base
            keys[sample] = base + p.occdist_scale * occupied
            probed[sample] = 0
            heap[count] = sample
            count += 1
    for i in range(count // 2 - 1, -1, -1):
        sift_down(heap, keys, count, i)
    return count
