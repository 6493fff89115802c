"""A slow, direct navfn in float32 after docs/explanation/planner.md, section 5, to compare the fast one with."""

import math

import numpy as np

f32 = np.float32
FAR = f32(1e10)


def convert(cells, allow_unknown):
    ny, nx = cells.shape
    costs = np.full((ny, nx), 254, np.uint8)
    for y in range(1, ny - 1):
        for x in range(1, nx - 1):
            v = int(cells[y, x])
            if v < 253:
                costs[y, x] = int(50 + 0.8 * v)
            elif v == 255 and allow_unknown:
                costs[y, x] = 253
    return costs


def flood(costs, nx, ny, robot, goal, list_size):
    ns = nx * ny
    cost = [int(c) for c in costs.reshape(-1)]
    potential = [FAR] * ns
    pending = [False] * ns
    current, following, over = [], [], []

    def push(target, n):
        if 0 <= n < ns and not pending[n] and cost[n] < 254 and len(target) < list_size:
            target.append(n)
            pending[n] = True

    potential[robot] = f32(0)
    for n in (robot + 1, robot - 1, robot - nx, robot + nx):
        push(current, n)
    threshold = f32(254)
    for _ in range(max(ns // 20, nx + ny)):
        if not current and not following:
            break
        for n in current:
            pending[n] = False
        for n in current:
            if cost[n] >= 254:
                continue
            left, right, up, down = potential[n - 1], potential[n + 1], potential[n - nx], potential[n + nx]
            tc, ta, h = min(left, right), min(up, down), f32(cost[n])
            dc = tc - ta
            if dc < 0:
                dc, ta = -dc, tc
            if dc >= h:
                new = ta + h
            else:
                q = float(dc / h)
                new = ta + h * f32(-0.2301 * q * q + 0.5307 * q + 0.7040)
            if new < potential[n]:
                potential[n] = new
                for k, old in ((n - 1, left), (n + 1, right), (n - nx, up), (n + nx, down)):
                    if old > new + f32(0.707106781 * cost[k]):
                        push(following if new < threshold else over, k)
        current, following = following, []
        if not current:
            threshold = threshold + f32(100)
            current, over = over, []
        if potential[goal] < FAR:
            break
    return potential


def half_away(v):
    return int(math.copysign(math.floor(abs(float(v)) + 0.5), v))


def truncate(v):
    return -2147483648 if v >= f32(2**31) else int(v)


def hypot32(x, y):
    return f32(math.sqrt(float(x) * float(x) + float(y) * float(y)))


def trace(potential, nx, ny, goal, robot):
    ns = nx * ny

    def at(n):
        return potential[n] if 0 <= n < ns else FAR

    def gradient(n):
        if n < nx or n > ns - nx:
            return f32(0), f32(0)
        out = []
        for low, high in ((at(n - 1), at(n + 1)), (at(n - nx), at(n + nx))):
            g, v = f32(0), at(n)
            if v >= FAR:
                g = f32(-254) if low < FAR else f32(254) if high < FAR else f32(0)
            else:
                g = g + (low - v) if low < FAR else g
                g = g + (v - high) if high < FAR else g
            out.append(g)
        norm = hypot32(*out)
        if norm > 0:
            norm = f32(1.0 / float(norm))
            out = [g * norm for g in out]
        return tuple(out)

    def blend(g, dx, dy):
        p = f32((1.0 - float(dx)) * float(g[0]) + float(dx * g[1]))
        q = f32((1.0 - float(dx)) * float(g[2]) + float(dx * g[3]))
        return f32((1.0 - float(dy)) * float(p) + float(dy * q))

    c, dx, dy, path = goal, f32(0), f32(0), []
    for _ in range(4 * nx):
        near = min(max(c + half_away(dx) + int(f32(nx * half_away(dy))), 0), ns - 1)
        if potential[near] < f32(50):
            return path + [(f32(robot % nx), f32(robot // nx))]
        if c < nx or c > ns - nx:
            return []
        path.append((f32(c % nx) + dx, f32(c // nx) + dy))
        around = [c - nx - 1, c - nx, c - nx + 1, c - 1, c + 1, c + nx - 1, c + nx, c + nx + 1]
        if any(at(n) >= FAR for n in around + [c]) or (len(path) > 2 and path[-1] == path[-3]):
            lowest, best = truncate(at(c)), c
            for n in around:
                if at(n) < f32(lowest):
                    lowest, best = truncate(at(n)), n
            c, dx, dy = best, f32(0), f32(0)
            if at(c) >= FAR:
                return []
            continue
        corners = [gradient(n) for n in (c, c + 1, c + nx, c + nx + 1)]
        x, y = (blend([g[i] for g in corners], dx, dy) for i in (0, 1))
        if x == 0 and y == 0:
            return []
        ss = f32(0.5 / float(hypot32(x, y)))
        dx, dy = dx + x * ss, dy + y * ss
        if dx > 1:
            c, dx = c + 1, dx - f32(1)
        if dx < -1:
            c, dx = c - 1, dx + f32(1)
        if dy > 1:
            c, dy = c + nx, dy - f32(1)
        if dy < -1:
            c, dy = c - nx, dy + f32(1)
    return []


def plain_plan(costmap, start, goal, tolerance, allow_unknown, list_size=10000):
    """(plan (n, 3), potential (ny, nx), costs (ny, nx)); the last two are None where nothing is flooded."""
    nothing = np.zeros((0, 3))
    nx, ny = costmap.size
    robot, target = costmap.world_to_map(*start), costmap.world_to_map(*goal[:2])
    if robot[0] < 0 or (target[0] < 0 and tolerance <= 0):
        return nothing, None, None
    target = target if target[0] >= 0 else (0, 0)
    cells = costmap.cells.copy()
    cells[robot[1], robot[0]] = 0
    costs = convert(cells, allow_unknown)
    robot = robot[1] * nx + robot[0]
    potential = flood(costs, nx, ny, robot, target[1] * nx + target[0], list_size)
    best, found, y = math.inf, None, goal[1] - tolerance
    while y <= goal[1] + tolerance:
        x = goal[0] - tolerance
        while x <= goal[0] + tolerance:
            mx, my = costmap.world_to_map(x, y)
            d = (x - goal[0]) * (x - goal[0]) + (y - goal[1]) * (y - goal[1])
            if mx >= 0 and potential[my * nx + mx] < FAR and d < best:
                best, found = d, (x, y, my * nx + mx)
            x += costmap.resolution
        y += costmap.resolution
    path = trace(potential, nx, ny, found[2], robot) if found else []
    grid = np.array(potential, np.float32).reshape(ny, nx)
    if not path:
        return nothing, grid, costs
    ox, oy = (float(v) for v in costmap.origin)
    plan = [(ox + float(x) * costmap.resolution, oy + float(y) * costmap.resolution, 0.0) for x, y in path[::-1]]
    return np.array(plan + [(found[0], found[1], goal[2])]), grid, costs
