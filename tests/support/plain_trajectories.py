"""A slow, direct trajectory planner after docs/explanation/planner.md, section 6: what the fast one is compared with.

Used by test_trajectory_planner.py. Every sample is rolled out and scored in order; the grids are given.
"""

import math

from applr_ros1.planner.costmap.footprint import footprint_cost, line_cost
from applr_ros1.planner.costmap.grid import map_to_world, world_to_map
from applr_ros1.planner.sampling_planner import angle_difference

HUGE = 1.7976931348623157e308


def ramp(target, velocity, acceleration, dt):
    if target - velocity >= 0:
        return min(target, velocity + acceleration * dt)
    return max(target, velocity - acceleration * dt)


def difference(a, b):
    r = math.fmod(b - a + math.pi, 2 * math.pi)
    return r + math.pi if r <= 0 else r - math.pi


class Plain:
    """costmap, footprint (n, 2), effective parameters by name, plan (k, 2), path and goal grids (ny, nx)."""

    def __init__(self, costmap, footprint, p, plan, path, goal):
        self.cells, self.resolution = costmap.cells, costmap.resolution
        self.ox, self.oy = (float(v) for v in costmap.origin)
        self.footprint, self.p, self.plan, self.path, self.goal = footprint, p, plan, path, goal

    def cell(self, x, y):
        ny, nx = self.cells.shape
        return world_to_map(x, y, self.ox, self.oy, self.resolution, nx, ny)

    def score(self, start, vx_s, vy_s, w_s):
        """(cost, points) of one sample. docs/explanation/planner.md, section 6.2."""
        p = self.p
        if p["heading_scoring"]:
            steps = int(p["sim_time"] / p["sim_granularity"] + 0.5)
        else:
            steps = int(
                max(
                    math.hypot(vx_s, vy_s) * p["sim_time"] / p["sim_granularity"],
                    abs(w_s) / p["angular_sim_granularity"],
                )
                + 0.5
            )
        steps = max(steps, 1)
        dt = p["sim_time"] / steps
        x, y, theta, vx, vy, w = start
        points, occupied, path, goal, heading, time = [], 0.0, 0.0, 0.0, 0.0, 0.0
        for _ in range(steps):
            cx, cy = self.cell(x, y)
            if cx < 0:
                return -1.0, points
            cost = footprint_cost(self.cells, self.ox, self.oy, self.resolution, self.footprint, x, y, theta)
            if cost < 0:
                return -1.0, points
            occupied = max(occupied, cost, float(self.cells[cy, cx]))
            if p["simple_attractor"]:
                dx, dy = x - self.plan[-1][0], y - self.plan[-1][1]
                goal = dx * dx + dy * dy
            elif not p["heading_scoring"] or p["heading_scoring_timestep"] <= time < p["heading_scoring_timestep"] + dt:
                path, goal = float(self.path[cy, cx]), float(self.goal[cy, cx])
                if max(path, goal) >= self.cells.size:
                    return -2.0, points
                if p["heading_scoring"]:
                    heading = self.heading_difference(cx, cy, x, y, theta)
            points.append((x, y, theta))
            vx, vy, w = (
                ramp(vx_s, vx, p["acc_lim_x"], dt),
                ramp(vy_s, vy, p["acc_lim_y"], dt),
                ramp(w_s, w, p["acc_lim_theta"], dt),
            )
            x, y = (
                x + (vx * math.cos(theta) + vy * math.cos(math.pi / 2 + theta)) * dt,
                y + (vx * math.sin(theta) + vy * math.sin(math.pi / 2 + theta)) * dt,
            )
            theta += w * dt
            time += dt
        if p["heading_scoring"]:
            return (
                p["occdist_scale"] * occupied
                + p["path_distance_bias"] * path
                + 0.3 * heading
                + goal * p["goal_distance_bias"]
            ), points
        return (p["path_distance_bias"] * path + goal * p["goal_distance_bias"] + p["occdist_scale"] * occupied), points

    def heading_difference(self, cx, cy, x, y, theta):
        for px, py in self.plan[::-1]:
            mx, my = self.cell(px, py)
            if mx >= 0 and 0 <= line_cost(self.cells, cx, cy, mx, my) < 253:
                gx, gy = map_to_world(mx, my, self.ox, self.oy, self.resolution)
                return abs(angle_difference(theta, math.atan2(gy - y, gx - x)))
        return HUGE

    def choose(self, start, window, state):
        """((cost, vx, w, points), state after). docs/explanation/planner.md, sections 6.3 to 6.6."""
        p = self.p
        x, y, theta = start[:3]
        best = (-1.0, 0.0, 0.0, [])
        turns = [window["min_vel_theta"]]
        for _ in range(p["vtheta_samples"] - 1):
            turns.append(turns[-1] + window["dvtheta"])
        if not state["escaping"]:
            vx = window["min_vel_x"]
            for _ in range(p["vx_samples"]):
                for w in [0.0] + turns[:-1]:
                    cost, points = self.score(start, vx, 0.0, w)
                    if cost >= 0 and (cost < best[0] or best[0] < 0):
                        best = cost, vx, w, points
                vx += window["dvx"]
        nearest = HUGE
        for w in turns:
            slowest = p["min_in_place_vel_theta"]
            limited = max(w, slowest) if w > 0 else min(w, -slowest)
            cost, points = self.score(start, 0.0, 0.0, limited)
            if cost < 0 or (0 <= best[0] < cost) or not (w > window["dvtheta"] or w < -window["dvtheta"]):
                continue
            ex, ey, eth = points[-1]
            cx, cy = self.cell(ex + p["heading_lookahead"] * math.cos(eth), ey + p["heading_lookahead"] * math.sin(eth))
            if (
                cx >= 0
                and self.goal[cy, cx] < nearest
                and ((w < 0 and not state["stuck_left"]) or (w > 0 and not state["stuck_right"]))
            ):
                best, nearest = (cost, 0.0, limited, points), self.goal[cy, cx]
        return self.flags(start, best, state)

    def flags(self, start, best, state):
        p, state = self.p, dict(state)
        x, y, theta = start[:3]
        legal = best[0] >= 0
        if legal and not best[1] > 0:
            side = "right" if best[2] < 0 else "left"
            if best[2] != 0:
                state["stuck_" + side] = int(state["stuck_" + side] or state["rotating_" + side])
                state["rotating_" + side] = 1
            state["prev_x"], state["prev_y"] = x, y
        if not legal:
            cost, points = self.score(start, p["escape_vel"], 0.0, 0.0)
            best = cost, p["escape_vel"], 0.0, points
        if math.hypot(x - state["prev_x"], y - state["prev_y"]) > p["oscillation_reset_dist"]:
            state.update(stuck_left=0, stuck_right=0, rotating_left=0, rotating_right=0)
        if not legal and not state["escaping"] and best[0] > -2:
            state.update(escape_x=x, escape_y=y, escape_theta=theta, escaping=1)
        if (
            math.hypot(x - state["escape_x"], y - state["escape_y"]) > p["escape_reset_dist"]
            or abs(difference(state["escape_theta"], theta)) > p["escape_reset_theta"]
        ):
            state["escaping"] = 0
        return (1.0 if best[0] == -1.0 else best[0],) + best[1:], state
