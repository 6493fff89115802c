"""Scenes for tests: worlds and their files, maps of the planner, floor plans of buildings."""

import os
from types import SimpleNamespace

import numpy as np
from PIL import Image

import worlds
from applr_ros1.common.scan import Source
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.costmap.grid import Geometry
from applr_ros1.planner.costmap.inflation_layer import InflationLayer, InflationParameters
from applr_ros1.planner.costmap.obstacle_layer import ObstacleLayer, ObstacleParameters
from applr_ros1.planner.costmap.static_layer import StaticMap
from tests.support.refusals import refused
from tests.support.robots import JACKAL_FOOTPRINT
from worlds import Course, World

STEP = 0.05  # simulated time between commands [s]


def small_world(cylinders=(), boxes=(), movers=(), start=(0.0, 0.0, 0.0)):
    """Return a world of cylinders (x, y, radius), boxes (x, y, yaw, size_x, size_y) and moving
    obstacles [m, rad].
    """
    # A course needs a path; no test of these worlds follows it.
    start_x, start_y = start[:2]
    reference_path = np.array([(start_x, start_y), (start_x + 1.0, start_y)])
    return World(
        name="scene",
        cylinders=np.array(cylinders, dtype=np.float64).reshape(-1, 3),
        boxes=np.array(boxes, dtype=np.float64).reshape(-1, 5),
        movers=tuple(movers),
        course=Course(
            start=start, goal=start, finish_y=None, goal_tolerance=0.4, path=reference_path
        ),
    )


def drive(simulator, v, w, seconds, step=STEP):
    """Repeat the command (v, w) [m/s, rad/s] for some simulated seconds, and return the last
    state.
    """
    for _ in range(int(round(seconds / step))):
        simulator.command(v, w)
        simulator.advance(step)
    return simulator.state


# Maps of the planner


def inflate(master, window, resolution, inscribed, parameters):
    """Inflate a window of the cells in place, with a new layer."""
    rows, columns = master.shape
    layer = InflationLayer("inflation", parameters)
    layer.match_size(Geometry(columns, rows, resolution, np.zeros(2), False))
    layer.set_inscribed_radius(inscribed)
    layer.inflate(master, master.copy(), window)


def open_map(nx=200, ny=200, resolution=0.05, origin=(-5.0, -5.0), foot=JACKAL_FOOTPRINT):
    """Return an empty map with the costmap attributes that a local planner reads."""
    cells = np.zeros((ny, nx), np.uint8)
    return SimpleNamespace(cells=cells, origin=origin, resolution=resolution, footprint=foot)


def straight(length=3.0, yaw=0.0, step=0.05):
    """Return a plan (n, 3) along x from 0 to `length` that ends with the heading `yaw`."""
    x = np.arange(0.0, length + step / 2, step)
    plan = np.column_stack([x, 0 * x, 0 * x])
    plan[-1, 2] = yaw
    return plan


def wall_with_a_door():
    """Return a map of 10 x 6 m with a wall at x = 2 m, a door of 1.2 m at y = 1.5 m, and unknown
    space far away.
    """
    cells = np.zeros((120, 200), np.int8)
    wall_columns = slice(100, 103)
    door_rows = slice(78, 102)
    cells[:, wall_columns] = 100
    cells[door_rows, wall_columns] = 0
    cells[:10] = -1
    return StaticMap(cells, 0.05, (-3.0, -3.0), "map")


def laser_costmap(
    size_x,
    size_y,
    resolution,
    origin=(0.0, 0.0),
    rolling=False,
    footprint=JACKAL_FOOTPRINT,
    track_unknown=False,
    obstacles=None,
    inflation=None,
):
    """Return a costmap of these sizes [m] with one laser, below an inflation layer."""
    layers = (
        ObstacleLayer(
            "obstacles_layer",
            obstacles or ObstacleParameters(),
            (Source(),),
            255 if track_unknown else 0,
        ),
        InflationLayer("inflater_layer", inflation or InflationParameters()),
    )
    return Costmap(size_x, size_y, resolution, origin, rolling, footprint, track_unknown, layers)


def see(costmap, pose, cloud):
    """Update a costmap at a pose with a new cloud of its first source."""
    costmap.obstacle_layers[0].buffers[0].add_cloud(cloud, cloud.stamp)
    costmap.update_costs(pose)


def paint(costmap, cells):
    """Write the non-zero cells (ny, nx) into a costmap's master grid, and inflate the whole map."""
    origin, master, *layer_cells = costmap.snapshot()
    base = np.where(np.asarray(cells) != 0, cells, master)
    for layer in costmap.inflation_layers:
        layer.inflate(master, base, (0, 0) + costmap.size)
    costmap.restore((origin, master, *layer_cells))


# World files of Gazebo; the repository has none of BARN's or DynaBARN's


def refused_world(path, *words):
    """Return the one-line error about a world file."""
    return refused(lambda: worlds.load(str(path)), *words)


def model(name, pose, shape):
    """Return a model of one shape; `pose` is six numbers as text. The attribute `frame` is as in
    DynaBARN's files.
    """
    collision = f"<collision name='c'><geometry>{shape}</geometry></collision>"
    link = f"<link name='link'>{collision}</link>"
    return f"<model name='{name}'><static>1</static><pose frame=>{pose}</pose>{link}</model>"


def box(name, x, y, z, *size, yaw=0):
    """Return a box (size along x, y, z) centred at (x, y, z)."""
    return model(name, f"{x} {y} {z} 0 0 {yaw}", "<box><size>%s %s %s</size></box>" % size)


COURSE = """
<applr:course xmlns:applr='applr'>
  <applr:start>0 -9 1.57</applr:start>
  <applr:goal>0 9 1.57</applr:goal>
  <applr:goal_tolerance>0.4</applr:goal_tolerance>
  <applr:path>0 -9 0 9</applr:path>
</applr:course>"""


def sdf(body, course=COURSE):
    """Return the text of a world file; `course` is this package's element, or "" for none."""
    ground = model(
        "ground_plane", "0 0 0 0 0 0", "<plane><normal>0 0 1</normal><size>100 100</size></plane>"
    )
    light = "<light name='sun' type='directional'/>"
    return f"<sdf version='1.6'><world name='default'>{light}{ground}{body}{course}</world></sdf>"


def cylinder(x, y, radius=0.075, name="unit_cylinder_0", z=0.0):
    shape = f"<cylinder><radius>{radius}</radius><length>1</length></cylinder>"
    return model(name, "%f %f %f 0.000000 0.000000 0.000000" % (x, y, z), shape)


def moving(name, x=0.0, y=0.0, filename=None):
    """Return a cylinder of radius .5 m with the Gazebo plugin `filename`, by default NAME.so, as in
    DynaBARN.
    """
    return cylinder(x, y, radius=0.5, name=name).replace(
        "</model>", "<plugin name='%s' filename='%s'/></model>" % (name, filename or name + ".so")
    )


def as_barn(world):
    """Return the text of a BARN-style file for a world of cylinders: models, then their poses as a
    saved state.
    """
    models = ""
    states = ""
    for number, (x, y) in enumerate(world.cylinders[:, :2]):
        model_name = "unit_cylinder_%d" % number
        models += cylinder(x, y, name=model_name)
        saved_pose = "<pose frame=''>%f %f 0 0 0 0</pose>" % (x, y)
        saved_link = f"<link name='link'>{saved_pose}</link>"
        # Gazebo saves a scale with each model.
        scale = "<scale>1 1 1</scale>"
        states += f"<model name='{model_name}'>{saved_pose}{scale}{saved_link}</model>"
    return sdf(models + f"<state world_name='default'>{states}</state>", "")


def write_world(folder, text, name="world_7.world", cells=None):
    """Write a world file, and a path file beside it if cells are given. Return the path of the
    world file.
    """
    world_path = os.path.join(str(folder), name)
    with open(world_path, "wb" if isinstance(text, bytes) else "w") as world_file:
        world_file.write(text)
    if cells is not None:
        # BARN's path of world_7 is path_files/path_7.npy.
        path_folder = os.path.join(str(folder), "path_files")
        os.makedirs(path_folder, exist_ok=True)
        # Pickled cells serve the tests of files that must be refused.
        np.save(os.path.join(path_folder, "path_7.npy"), cells, allow_pickle=True)
    return world_path


# Floor plans of buildings, as maps in map_server's format

RESOLUTION = 0.05  # [m]
FREE, WALL, UNKNOWN = 254, 0, 205  # brightness of a cell, as map_saver writes it


def blank(width, height):
    """Return a floor with outer walls [m] within unknown cells, and functions that draw walls and
    clear doors.
    """
    margin = 10  # unknown cells around the building, as in maps of gmapping
    row_count = round(height / RESOLUTION) + 2 * margin
    column_count = round(width / RESOLUTION) + 2 * margin
    pixels = np.full((row_count, column_count), UNKNOWN, np.uint8)

    def cells(begin, size):
        """Return the cells between two coordinates [m]."""
        first_cell = margin + round(begin / RESOLUTION)
        end_cell = margin + round((begin + size) / RESOLUTION)
        return slice(first_cell, end_cell)

    def fill(x, y, size_x, size_y, value=WALL):
        """Fill a rectangle with a corner at (x, y) [m]."""
        pixels[cells(y, size_y), cells(x, size_x)] = value

    fill(0, 0, width, height)
    fill(0.2, 0.2, width - 0.4, height - 0.4, FREE)
    return pixels, fill


def office():
    """Return rooms with doors of .9 m along both sides of a corridor of 2 m, with desks, 36 x
    14 m.
    """
    pixels, fill = blank(36.0, 14.0)
    # Both walls of the corridor
    for corridor_y in (6.0, 8.1):
        fill(0.0, corridor_y - 0.1, 36.0, 0.1)
    for room_number in range(6):
        room_x = 6.0 * room_number
        # On each side: the wall to the room before, and two desks
        for room_y, desk_y in ((0.2, 1.0), (8.1, 11.6)):
            if room_number:
                fill(room_x, room_y, 0.1, 5.7)
            fill(room_x + 1.2, desk_y, 1.6, 0.8)
            fill(room_x + 4.0, desk_y + 0.6, 0.6, 0.6)
        # Doors to the corridor, not opposite each other
        fill(room_x + 2.6, 5.9, 0.9, 0.1, FREE)
        fill(room_x + 3.6, 8.0, 0.9, 0.1, FREE)
    # A door between two rooms, which makes a loop
    fill(12.0, 3.0, 0.1, 0.9, FREE)
    return pixels


def warehouse():
    """Return shelves of 1 x 8 m with aisles of 1.6 m, 30 x 24 m."""
    pixels, fill = blank(30.0, 24.0)
    for column in range(10):
        # Two shelves in a line, with a crossing aisle between them
        for shelf_y in (2.5, 13.5):
            fill(2.6 + 2.6 * column, shelf_y, 1.0, 8.0)
    return pixels


def house():
    """Return six rooms with doors of .85 m and furniture, 12 x 10 m."""
    pixels, fill = blank(12.0, 10.0)
    # Walls of the hall, and between the rooms on both sides of it
    fill(0.0, 4.2, 12.0, 0.1)
    fill(0.0, 5.7, 12.0, 0.1)
    for wall_x in (4.0, 8.0):
        fill(wall_x, 0.2, 0.1, 4.0)
        fill(wall_x, 5.8, 0.1, 4.0)
    # A door of each room
    for door_x in (1.5, 5.5, 9.5):
        fill(door_x, 4.2, 0.85, 0.1, FREE)
        fill(door_x + 0.6, 5.7, 0.85, 0.1, FREE)
    # Furniture
    fill(0.2, 0.2, 1.6, 2.0)
    fill(5.2, 1.2, 1.2, 0.8)
    fill(9.0, 8.0, 2.0, 0.9)
    fill(0.6, 8.6, 2.4, 0.8)
    return pixels


PLANS = {"office": office, "warehouse": warehouse, "house": house}


def write_plan(folder, name, pixels=None, suffix="pgm", **changes):
    """Write a plan, or other pixels, as NAME.yaml with its image, and return the path of the file
    as text.
    """
    if pixels is None:
        pixels = PLANS[name]()
    image_name = f"{name}.{suffix}"
    Image.fromarray(pixels).save(folder / image_name)
    # map_server's default thresholds, as map_saver writes them
    values = {
        "image": image_name,
        "resolution": RESOLUTION,
        "origin": [-5.0, -3.0, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
        **changes,
    }
    map_file = folder / f"{name}.yaml"
    # A change to None leaves a value out.
    lines = [f"{field}: {value}\n" for field, value in values.items() if value is not None]
    map_file.write_text("".join(lines))
    return str(map_file)
