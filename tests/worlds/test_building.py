"""Maps of buildings as worlds: map_server's format, obstacles, courses, halves, passages,
mistakes.
"""

import itertools
import json
import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
import scipy
from matplotlib.axes import Axes
from PIL import Image

import worlds
from applr_ros1 import robots
from applr_ros1.common.angles import compose, inverse, transform_point
from applr_ros1.common.paths import step_lengths
from applr_ros1.drives.simulate import CourseDrive
from applr_ros1.planner.parameters.trees import merged
from applr_ros1.robots.geometry import radius
from tests.support import scenes
from tests.support.refusals import refused
from training.attempts.verdict import FEWEST_WORLDS, LEVEL, exchanged
from training.env.settings import TrialSettings
from training.evaluate.runner import TrialRunner, at_scale
from training.robot import check as check_robot
from training.tune import __main__ as tune_robot
from training.tune.options import UNSEEN, check_maps, split
from worlds import draw, map_courses, map_reader, sdf_writer, search
from worlds.occupancy import occupancy
from worlds.world import clearance

WAFFLE = robots.load("turtlebot3_waffle_pi")
WAFFLE_RADIUS_M = radius(WAFFLE)
JACKAL_RADIUS_M = radius(robots.JACKAL)


def row_of_rooms(count, first_x, step, y, *, width, depth):
    """Return regions (smallest x, y, largest x, y) [m] side by side, from a plan's lower left."""
    regions = []
    for room in range(count):
        x = first_x + step * room
        regions.append((x, y, x + width, y + depth))
    return regions


ROOMS = {  # regions of a plan in which there are courses
    "office": [
        *row_of_rooms(6, 0.0, 6.0, 0.0, width=6.0, depth=5.8),
        *row_of_rooms(6, 0.0, 6.0, 8.2, width=6.0, depth=5.8),
        # Parts of the corridor
        *row_of_rooms(3, 0.0, 12.0, 6.0, width=12.0, depth=2.0),
    ],
    # The aisles
    "warehouse": [
        *row_of_rooms(9, 3.6, 2.6, 2.5, width=1.6, depth=8.0),
        *row_of_rooms(9, 3.6, 2.6, 13.5, width=1.6, depth=8.0),
    ],
    "house": [
        *row_of_rooms(3, 0.0, 4.0, 0.0, width=4.0, depth=4.2),
        *row_of_rooms(3, 0.0, 4.0, 5.8, width=4.0, depth=4.2),
    ],
}


@lru_cache(maxsize=None)
def worlds_of(path, robot_radius=JACKAL_RADIUS_M):
    """Return the worlds of a map."""
    return tuple(worlds.Worlds(path, robot_radius))


def courses_of(path, robot_radius=JACKAL_RADIUS_M):
    """Return the courses of the worlds of a map."""
    return [world.course for world in worlds_of(path, robot_radius)]


def points_of(path):
    """Return the points (n, 2) [m] of the reference paths of all worlds of a map."""
    return np.vstack([course.path for course in courses_of(path)])


@pytest.fixture(scope="module", params=list(scenes.PLANS))
def plan(request, tmp_path_factory):
    """Provide the name of a plan and the path of its map."""
    folder = tmp_path_factory.mktemp("maps")
    return request.param, scenes.write_plan(folder, request.param)


@pytest.fixture(scope="module")
def office(tmp_path_factory):
    """Return the path of the office's map."""
    return scenes.write_plan(tmp_path_factory.mktemp("office"), "office")


def cells(folder, pixels, **changes):
    """Return the cells of a map with some pixels, as lists with the lowest y first."""
    image = np.array(pixels, np.uint8)
    map_path = scenes.write_plan(folder, "small", image, "png", **changes)
    return map_reader.read_map(map_path).cells.tolist()


# -- map_server's format
def test_the_radius_is_that_of_the_farthest_corner():
    radii = [JACKAL_RADIUS_M, WAFFLE_RADIUS_M]
    assert radii == pytest.approx([np.hypot(0.229, 0.208), 0.249], abs=1e-3)


def test_modes_give_the_values_that_map_server_publishes(tmp_path):
    # The thresholds are between 89 and 90, and between 205 and 206.
    grey = [[0, 89, 90, 128, 204, 205, 206, 254]]
    assert cells(tmp_path, grey) == [[100, 100, -1, -1, -1, -1, 0, 0]]
    assert cells(tmp_path, grey, negate=1) == [[0, -1, -1, -1, 100, 100, 100, 100]]
    assert cells(tmp_path, grey, mode="scale") == [[100, 100, 98, 66, 1, 1, 0, 0]]

    # 204 is a share of 0.2 exactly: neither above the one threshold nor below the other.
    equal_thresholds = {"free_thresh": 0.2, "occupied_thresh": 0.2}
    assert cells(tmp_path, [[204, 203, 205]], **equal_thresholds) == [[-1, 100, 0]]

    # Bytes are taken as signed ones.
    levels = [[0, 37, 100, 127, 128, 255]]
    assert cells(tmp_path, levels, mode="raw") == [[0, 37, 100, 127, -128, -1]]
    raw_cells = np.array([0, 99, 100, 127, -128, -1], np.int8)
    is_occupied = map_reader.is_occupied(raw_cells)
    assert is_occupied.tolist() == [False, False, True, True, True, False]


def test_mode_trinary_averages_the_opacity_and_scale_takes_transparent_pixels_as_unknown(tmp_path):
    # Red, green, blue and opacity: grey and black, each transparent and opaque
    pixels = [
        [
            [100, 100, 100, 0],
            [100, 100, 100, 255],
            [0, 0, 0, 0],
            [0, 0, 0, 255],
        ]
    ]
    assert cells(tmp_path, pixels) == [[100, -1, 100, 100]]
    assert cells(tmp_path, pixels, mode="scale") == [[-1, 89, 100, 100]]
    # Without opacity, blue above white; the lowest row comes first.
    blue_and_white = [[[0, 0, 255]], [[255, 255, 255]]]
    assert cells(tmp_path, blue_and_white) == [[0], [100]]


def test_an_image_of_16_bits_is_read_by_its_upper_8(tmp_path):
    grey = np.array([[0, 40, 89, 90, 205, 206, 254, 255]], np.uint8)
    expected = cells(tmp_path, grey)
    # The lower 8 bits are 7.
    deep_grey = grey.astype(np.uint16) * 256 + 7
    for suffix in ("png", "pgm"):
        map_path = scenes.write_plan(tmp_path, "deep", deep_grey, suffix)
        assert Image.open(tmp_path / f"deep.{suffix}").mode.startswith("I")
        assert map_reader.read_map(map_path).cells.tolist() == expected


def test_an_image_of_one_bit_is_black_and_white(tmp_path):
    map_path = scenes.write_plan(tmp_path, "office", suffix="png")
    black_and_white = Image.fromarray(scenes.office()).point(lambda grey: 255 * (grey > 0))
    black_and_white.convert("1").save(tmp_path / "office.png")
    map_cells = map_reader.read_map(map_path).cells
    # The first row of cells is the lowest one of the image.
    is_occupied = map_reader.is_occupied(map_cells)[::-1]
    is_wall = scenes.office() == scenes.WALL
    assert (is_occupied == is_wall).all()


@pytest.mark.parametrize(
    ("mode", "suffix"),
    [
        ("P", "png"),
        ("P", "bmp"),
        ("1", "pbm"),
        ("1", "bmp"),
    ],
)
def test_an_image_whose_indexes_map_server_would_take_as_grey_is_refused(tmp_path, mode, suffix):
    path = scenes.write_plan(tmp_path, "office", suffix=suffix)
    colours = Image.fromarray(scenes.office()).convert("RGB").quantize(3)
    picture = colours if mode == "P" else colours.convert("1")
    picture.save(tmp_path / f"office.{suffix}")
    problems = (
        f"office.{suffix}: the image has indexed colours",
        "map_server takes the indexes as grey",
        "save it as a grey",
    )
    refused(lambda: map_reader.read_map(path), *problems)


def test_an_image_of_more_than_16_bits_is_refused(tmp_path):
    for name, pixels in (
        ("long", np.full((4, 4), 70_000, np.int32)),
        ("real", np.ones((4, 4), np.float32)),
    ):
        path = scenes.write_plan(tmp_path, name, pixels, "tiff")
        line = f"{name}.tiff: the image has more than 16 bits per pixel: save it with 8"
        refused(lambda path=path: map_reader.read_map(path), line)


@pytest.mark.parametrize(
    ("field", "value", "line"),
    [
        (
            "origin",
            "[-12.0, -10.0, -nan]",
            "origin.2 is '-nan': give a finite number",
        ),
        ("origin", "[-12.0, -10.0]", "origin.2 is .*: give it"),
        ("origin", "[.inf, 0, 0]", "origin.0 is inf: give a finite number"),
        ("origin", "0", "origin is 0: give a list"),
        ("resolution", "0.0", "resolution is 0.0: give more than 0"),
        ("resolution", "5", "resolution is 5: give at most 1"),
        ("occupied_thresh", "dark", "occupied_thresh is 'dark': give a number"),
        ("free_thresh", ".nan", "free_thresh is nan: give a finite number"),
        ("occupied_thresh", 65, "occupied_thresh is 65: give at most 1"),
        (
            "free_thresh",
            0.9,
            r"free_thresh is 0.9, above occupied_thresh \(0.65\): no cell .*lower",
        ),
        ("negate", "white", "negate is 'white': give true or false"),
        ("image", "''", "image is '': give a longer text"),
        ("mode", "ternary", "mode is 'ternary': give 'trinary', 'scale' or 'raw'"),
    ],
)
def test_each_field_of_a_map_is_checked(tmp_path, field, value, line):
    path = scenes.write_plan(tmp_path, "office", **{field: value})
    refused(lambda: map_reader.read_map(path), f"office.yaml: {line}")


def test_rows_go_up_and_the_origin_turns_the_map(tmp_path):
    # Given: an image whose lowest row has two occupied cells on the right
    pixels = np.array(
        [
            [254, 254, 254],
            [254, 0, 0],
        ],
        np.uint8,
    )
    origin = (1.0, 2.0, 0.5)
    path = scenes.write_plan(tmp_path, "small", pixels, origin=list(origin))

    # Then: they are in the first row of the grid, and one box of 0.1 x 0.05 m
    grid = map_reader.read_map(path)
    assert grid.cells.tolist() == [[0, 100, 100], [0, 0, 0]]
    (box,) = map_reader.boxes(grid)
    # The box's centre in the map
    x, y = transform_point(origin, 0.1, 0.025)
    assert box == pytest.approx([x, y, 0.5, 0.1, 0.05])


# -- obstacles
@pytest.mark.parametrize("occupied_share", [0.3, 0.0])
def test_boxes_cover_the_occupied_cells_and_nothing_else(occupied_share):
    # Given: random occupied cells of 1 m among unknown ones
    rng = np.random.default_rng(0)
    is_occupied = rng.random((40, 50)) < occupied_share
    map_cells = np.where(is_occupied, 100, -1).astype(np.int8)
    grid = worlds.world.Grid(map_cells, 1.0, (0.0, 0.0, 0.0))

    # When: the boxes are drawn into another grid
    box_counts = np.zeros(is_occupied.shape, int)
    for x, y, _, size_x, size_y in map_reader.boxes(grid):
        rows = slice(round(y - size_y / 2), round(y + size_y / 2))
        columns = slice(round(x - size_x / 2), round(x + size_x / 2))
        box_counts[rows, columns] += 1

    # Then: each occupied cell is covered once
    assert (box_counts == is_occupied).all()


def test_walls_are_few_boxes_and_a_course_keeps_those_within_12_m(plan):
    _, path = plan
    all_boxes = map_reader.boxes(map_reader.read_map(path))
    assert len(all_boxes) < 60
    world = worlds.load(f"{path}:3", JACKAL_RADIUS_M)
    for box in all_boxes:
        only_box = replace(world, boxes=box[None], map=None)
        distance = clearance(only_box, world.course.path).min()
        is_kept = (box == world.boxes).all(axis=1).any()
        # The distance is taken from every tenth point of the path.
        assert distance <= 12.0 if is_kept else distance > 11.5


# -- courses
@pytest.mark.heavy
def test_courses_keep_their_distances(plan):
    name, path = plan
    map_worlds = worlds_of(path)
    for number, world in enumerate(map_worlds):
        assert world.name == f"{name}.yaml:{number}"
    starts = np.array([world.course.start[:2] for world in map_worlds])
    assert scipy.spatial.distance.pdist(starts).min() >= 1.0

    floor = occupancy(map_worlds[0], 0.05)
    lengths = []
    for world in map_worlds:
        points = world.course.path
        steps = step_lengths(points)
        assert 5.0 <= steps.sum() <= 15.0
        assert steps.max() < 0.08
        lengths.append(world.course.route_m)

        # Half a cell's diagonal less half its side.
        assert clearance(world, points).min() >= JACKAL_RADIUS_M + 0.05 - 0.0104
        indices = (points - floor.origin[:2]) / 0.05
        columns, rows = indices.astype(int).T
        assert (floor.cells[rows, columns] == 0).all()
    assert np.ptp(lengths) > 8.0


@pytest.mark.heavy
def test_start_and_goal_lie_on_the_path_and_point_along_it(plan):
    _, path = plan
    for course in courses_of(path):
        points = course.path
        # The heading is that of the first or last ten steps.
        for pose, end_point, along in (
            (course.start, points[0], points[10] - points[0]),
            (course.goal, points[-1], points[-1] - points[-11]),
        ):
            x, y, yaw = pose
            dx, dy = along
            assert (x, y) == pytest.approx(end_point)
            assert yaw == pytest.approx(np.arctan2(dy, dx))


def test_there_are_courses_in_all_rooms(plan):
    name, path = plan
    # The map's origin is (-5, -3), and 10 unknown cells surround the plan.
    corner = np.array([5.0, 3.0]) - 10 * 0.05
    points = points_of(path) + corner
    for region in ROOMS[name]:
        is_inside = (points > region[:2]) & (points < region[2:])
        assert is_inside.all(axis=1).any(), region


def test_courses_stay_as_they_were_drawn(office):
    """Policies and sets were chosen and judged on these courses."""
    for number, start, goal in (
        (0, (8.175, 5.075), (15.525, 8.125)),
        (7, (-3.275, 2.375), (2.375, 1.775)),
    ):
        course = worlds.load(f"{office}:{number}", JACKAL_RADIUS_M).course
        assert course.start[:2] == pytest.approx(start)
        assert course.goal[:2] == pytest.approx(goal)


def test_courses_of_a_wide_robot_lead_through_no_door(office):
    """Doors of .9 m are too narrow for a robot with a radius of .6 m."""
    for course in courses_of(office, robot_radius=0.6):
        y = course.path[:, 1] + 3.0 - 10 * 0.05
        # 0, 1 or 2: below, in or above the corridor
        sides = (y > 5.5).astype(int) + (y > 7.5)
        assert len(set(sides)) == 1


def test_no_course_runs_where_the_map_is_unknown(tmp_path):
    pixels = scenes.office()
    pixels[: len(pixels) // 2] = scenes.UNKNOWN
    path = scenes.write_plan(tmp_path, "office", pixels)
    assert points_of(path)[:, 1].max() < 7.5 - 3.0 - JACKAL_RADIUS_M


def ros2_house(folder, outer_door=False):
    """Write the house within 22 x 20 m, as ROS 2's map_saver does: its free_thresh makes unknown
    cells free.
    """
    pixels = np.pad(scenes.house(), 100, constant_values=scenes.UNKNOWN)
    if outer_door:
        pixels[105:116, 154:178] = scenes.FREE
    return scenes.write_plan(folder, "house", pixels, free_thresh=0.25)


@pytest.mark.heavy
def test_courses_lie_inside_where_unknown_cells_are_free(tmp_path):
    path = ros2_house(tmp_path)
    assert (map_reader.read_map(path).cells[0] == map_reader.FREE).all()
    (tmp_path / "known").mkdir()
    known_path = scenes.write_plan(tmp_path / "known", "house")
    both_worlds = zip(
        worlds_of(path),
        worlds_of(known_path),
        strict=True,
    )
    margin_m = 100 * scenes.RESOLUTION
    for world, known_world in both_worlds:
        np.testing.assert_allclose(
            world.course.path - margin_m,
            known_world.course.path,
            atol=1e-9,
        )
    report = check_robot.doors(robots.JACKAL, path)
    assert report.startswith(f"narrowest passage of {path}: 0.80 m; ")


def test_a_building_that_is_open_to_the_edge_of_the_image_has_no_courses(tmp_path):
    path = ros2_house(tmp_path, outer_door=True)
    problems = (
        "no closed room with a path of 5 m",
        "if it is unknown space, give free_thresh 0.196, otherwise close",
    )
    refused(lambda: worlds.load(f"{path}:0", JACKAL_RADIUS_M), *problems)


@pytest.mark.heavy
@pytest.mark.parametrize(
    "size",
    [
        (4.4, 4.4),
        (5.4, 4.4),
        (10.4, 2.4),
        (12.4, 6.4),
    ],
)
def test_a_small_room_has_shorter_courses_and_enough_in_each_half(tmp_path, size):
    pixels, _ = scenes.blank(*size)
    path = scenes.write_plan(tmp_path, "room", pixels)
    building = map_courses.Building(path, JACKAL_RADIUS_M)
    lower_numbers = building.numbers("choose")
    upper_numbers = building.numbers("report")
    assert min(len(lower_numbers), len(upper_numbers)) >= FEWEST_WORLDS
    assert not set(lower_numbers) & set(upper_numbers)
    lengths = []
    for number in {*range(building.count), *lower_numbers, *upper_numbers}:
        world = building.course(number)
        lengths.append(world.course.route_m)
        assert clearance(world, world.course.path).min() >= JACKAL_RADIUS_M
    assert 2.0 <= min(lengths) < 5.0

    # A worker loads a course by its number alone.
    last_number = max(*lower_numbers, *upper_numbers)
    reloaded = worlds.load(f"{path}:{last_number}", JACKAL_RADIUS_M)
    last_world = building.course(last_number)
    assert np.array_equal(reloaded.course.path, last_world.course.path)
    unknown_number = last_number + len(upper_numbers) + 1
    refused(lambda: worlds.load(f"{path}:{unknown_number}", JACKAL_RADIUS_M), "no worlds")


@pytest.mark.heavy
def test_paths_are_shortest(tmp_path):
    """In an empty hall, a shortest path has diagonal moves along the shorter side."""
    pixels, _ = scenes.blank(20.0, 6.0)
    for course in courses_of(scenes.write_plan(tmp_path, "hall", pixels)):
        shorter_side, longer_side = sorted(np.abs(course.path[-1] - course.path[0]))
        # A diagonal move of sqrt(2) replaces a straight one along the longer side.
        expected_m = longer_side + (np.sqrt(2.0) - 1.0) * shorter_side
        assert course.route_m == pytest.approx(expected_m)


def test_the_graph_has_all_moves_that_pass_no_blocked_corner():
    # Given: random cells within a blocked border
    rng = np.random.default_rng(1)
    is_free = np.pad(rng.random((30, 30)) < 0.7, 1)
    side = len(is_free)

    graph = search.grid_graph(is_free).toarray()

    # Then: the length of each move, 0 if it does not pass
    for row, column in np.argwhere(is_free):
        cell = side * row + column
        for row_step, column_step in itertools.product((-1, 0, 1), repeat=2):
            beside_row = row + row_step
            beside_column = column + column_step
            neighbour = side * beside_row + beside_column
            passes_corner = is_free[row, beside_column] or is_free[beside_row, column]
            passes = is_free[beside_row, beside_column] and passes_corner
            length = np.hypot(row_step, column_step) if passes else 0.0
            assert graph[cell, neighbour] == pytest.approx(length)

    # No move begins or ends elsewhere.
    free_cells = is_free.ravel()
    between_free_cells = graph[free_cells][:, free_cells]
    assert np.count_nonzero(graph) == np.count_nonzero(between_free_cells)


def test_maps_are_not_scaled_and_are_served_listed_and_drawn(office, tmp_path, monkeypatch):
    world = worlds.load(f"{office}:3", JACKAL_RADIUS_M)
    assert worlds.scaled(world, 0.5) is world
    assert occupancy(world, 0.2) is world.map
    assert worlds.specs(f"{office}:2-4") == [f"{office}:2", f"{office}:3", f"{office}:4"]
    picture = tmp_path / "office.png"
    monkeypatch.setattr("sys.argv", ["draw", f"{office}:3", str(picture)])
    assert draw.main() == 0
    assert picture.stat().st_size > 10_000


def test_a_picture_of_an_unknown_ending_is_refused_with_those_that_are_known(
    tmp_path, monkeypatch, capsys
):
    picture = tmp_path / "x.txt"
    monkeypatch.setattr("sys.argv", ["draw", "generated:3", str(picture)])
    assert draw.main() == 1
    printed = capsys.readouterr().err
    assert ", png, " in printed
    assert printed.count("\n") == 1
    assert not picture.exists()


@pytest.mark.parametrize(
    ("robot", "name"),
    [
        ("turtlebot3_burger", "office.yaml:7"),
        ("husky", "generated:7"),
    ],
)
def test_a_course_is_drawn_and_written_as_the_robot_drives_it(
    office, tmp_path, monkeypatch, robot, name
):
    spec = name.replace("office.yaml", office)
    driven_path = at_scale("paper", spec, robots.load(robot)).course.path

    # When: it is drawn
    drawn_worlds = []
    monkeypatch.setattr(draw, "draw", lambda axes, world: drawn_worlds.append(world))
    # Nothing is drawn that needs a legend.
    monkeypatch.setattr(Axes, "legend", lambda *args, **options: None)
    picture = str(tmp_path / "course.png")
    monkeypatch.setattr("sys.argv", ["draw", spec, picture, "--robot", robot])
    assert draw.main() == 0

    # When: it is written
    world_file = str(tmp_path / "course.world")
    monkeypatch.setattr("sys.argv", ["sdf_writer", spec, world_file, "--robot", robot])
    assert sdf_writer.main() == 0

    # Then: the path is the robot's, not the Jackal's
    (drawn_world,) = drawn_worlds
    for world in (drawn_world, worlds.load(world_file)):
        assert np.array_equal(world.course.path, driven_path)
    jackal_path = worlds.load(spec, JACKAL_RADIUS_M).course.path
    assert not np.array_equal(jackal_path, driven_path)


# -- search and verdict
def test_halves_share_no_place(plan):
    _, path = plan
    longer_axis = np.argmax(np.ptp(points_of(path), axis=0))
    lower_half = points_of(f"{path}:choose")[:, longer_axis]
    upper_half = points_of(f"{path}:report")[:, longer_axis]
    assert lower_half.max() < upper_half.min()
    for half in map_courses.HALVES:
        assert len(courses_of(f"{path}:{half}")) >= 5


def test_tune_judges_on_the_other_half():
    assert split("office.yaml") == ("office.yaml:choose", "office.yaml:report")
    assert split("a.yaml, generated:learn") == ("a.yaml:choose,generated:learn", "a.yaml:report")
    assert split("office.yaml:0-9,generated:learn") == ("office.yaml:0-9,generated:learn", UNSEEN)


def test_tune_refuses_a_map_with_too_few_courses_before_it_drives(tmp_path, capsys, monkeypatch):
    def refuse(robot):
        raise AssertionError("the robot drives before the arguments are checked")

    monkeypatch.setattr(tune_robot.open_floor, "try_out", refuse)
    pixels, _ = scenes.blank(3.4, 2.4)
    path = scenes.write_plan(tmp_path, "small", pixels)
    counts = "has 0 courses in the half of the floor for the search and 0 in the half for the"
    for specification, problem in (
        (path, f"small.yaml {counts} verdict"),
        (str(tmp_path / "gone.yaml"), "gone.yaml: cannot be read"),
        ("generated:400", "no worlds 'generated:400'"),
    ):
        arguments = ["jackal", "--worlds", specification, "--out", str(tmp_path / "out")]
        assert tune_robot.main(arguments) == 1
        error = capsys.readouterr().err
        assert problem in error
        assert error.count("\n") == 1
        # The person gave a map, not one of its halves.
        assert ":choose" not in error.partition("; give")[0]

    needs = "a radius of 0.31 m; each needs 6, because"
    line = refused(lambda: check_maps(path, robots.JACKAL), needs)
    assert "choose" not in line
    none_in_half = "small.yaml: none of its 15 courses stays in one half"
    refused(lambda: worlds.specs(f"{path}:report", JACKAL_RADIUS_M), none_in_half)


def test_six_courses_are_the_fewest_that_can_be_significant():
    # All differences have one sign: two of 64 sign patterns are so clear, with five courses of 32.
    differences = np.full(FEWEST_WORLDS, -1.0)
    assert FEWEST_WORLDS == 6
    assert exchanged(differences) < LEVEL <= exchanged(differences[1:])


# -- drives
@pytest.mark.heavy
@pytest.mark.parametrize("yaw", [0.0, 0.5])
def test_the_simulated_robot_knows_the_map_and_its_place(tmp_path, yaw):
    path = scenes.write_plan(tmp_path, "office", origin=[-5.0, -3.0, yaw])
    runner = TrialRunner(TrialSettings(robot="turtlebot3_waffle_pi", loaded=True))
    world = at_scale("paper", f"{path}:0", runner.robot)
    # The planner's tolerance ends the course.
    world = replace(world, course=replace(world.course, goal_tolerance=0.0))
    simulated = runner.simulated
    course_drive = CourseDrive(simulated, world, seed=0, theta=runner.space.theta0)

    # The first plan avoids walls that no scan has shown.
    is_free = map_reader.read_map(path).cells == map_reader.FREE
    plan = course_drive.seen.plan[:, :2]
    columns, rows = (plan / 0.05).astype(int).T
    assert is_free[rows, columns].all()
    assert plan[0] == pytest.approx(simulated.place[:2], abs=0.1)

    # On its way it knows its true place in the map, as localisation would tell it.
    for _ in course_drive.legs():
        pose_in_map = compose(inverse(world.map.origin), simulated.state.pose)
        assert course_drive.seen.pose == pose_in_map
        global_plan = simulated.stack.move_base.global_plan
        assert math.dist(global_plan[0, :2], simulated.place[:2]) < 1.0
    outcome = course_drive.outcome
    assert outcome.reason == "finished"
    assert not outcome.collided
    assert outcome.time_s < 60.0
    # The robot has still to stop.
    distance = math.dist(simulated.goal[:2], simulated.place[:2])
    assert distance == pytest.approx(runner.robot.goal_tolerance, abs=0.02)

    # In a world without a map it drives by odometry again; another parameter set has the map, too.
    simulated.reset(worlds.load("generated:3"), 0)
    assert simulated.place == simulated.state.odom_pose
    changed = runner.starting_with(runner.space.theta0 * 0.9)
    changed.reset(world, 5)
    assert changed.stack.move_base.map_topics == {"map": False}


def test_a_robot_without_simulated_sensors_for_its_map_explores():
    camera = {
        "data_type": "PointCloud2",
        "topic": "camera",
        "marking": True,
        "clearing": True,
    }
    obstacles = {"observation_sources": "scan camera", "camera": camera}
    settings = TrialSettings(period=2.0)
    with_camera = {"local_costmap": {"obstacle_layer": obstacles, **obstacles}}
    files = merged(WAFFLE.move_base.with_map, with_camera)
    waffle_with_camera = replace(WAFFLE, move_base=WAFFLE.move_base._replace(with_map=files))
    # The simulation has no camera, and the Jackal no files for a map.
    for robot, knows_map in (
        (WAFFLE, True),
        (waffle_with_camera, False),
        (robots.JACKAL, False),
    ):
        without_map, *with_map = settings.planners(robot)
        assert not without_map.map_topics
        assert len(with_map) == knows_map


def test_a_parameter_set_changes_both_setups():
    changes = {"DWAPlannerROS": {"sim_time": 2.7}}
    waffle = WAFFLE.with_parameters(changes, "other")
    for setup in (waffle, waffle.on_map()):
        assert setup.parameters()["DWAPlannerROS"]["sim_time"] == 2.7


# -- doors
def hall_with_a_door(folder, width):
    """Write a hall of 10 x 5 m that a wall with a door divides, and return the path of its map."""
    pixels, fill = scenes.blank(10.0, 5.0)
    fill(5.0, 0.0, 0.1, 5.0)
    fill(5.0, 2.0, 0.1, width, scenes.FREE)
    return scenes.write_plan(folder, "door", pixels)


@pytest.mark.parametrize("width", [0.8, 1.1])
def test_the_narrowest_passage_is_the_door(tmp_path, width):
    path = hall_with_a_door(tmp_path, width)
    building = map_courses.Building(path, JACKAL_RADIUS_M)
    passages = []
    for number in range(building.count):
        # x in the plan's frame, without 1 m at both ends of the course
        x = building.course(number).course.path[25:-25, 0] + 4.5
        if x.min() < 5.0 < x.max():
            passages.append(building.passage(number))
    assert len(passages) > 3
    assert passages == pytest.approx([width] * len(passages))


def test_check_robot_reports_the_narrowest_passage(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(check_robot.open_floor, "try_out", lambda robot: (True, []))
    path = hall_with_a_door(tmp_path, 0.9)
    line = f"narrowest passage of {path}: 0.90 m; the padded footprint of "
    assert check_robot.main(["jackal", "--map", path]) == 0
    assert f"\n{line}0.53 m passes with 0.18 m on each side" in capsys.readouterr().out

    changes = {"local_costmap": {"footprint_padding": 0.35}}
    wide_robot = robots.JACKAL.with_parameters(changes, "wide")
    expected = f"{line}1.03 m does not pass: reduce footprint_padding"
    assert expected in check_robot.doors(wide_robot, path)


# -- mistakes
def test_mistakes_are_one_line(office, tmp_path):
    def refusal(spec, *words):
        return refused(lambda: worlds.load(spec), *words)

    refusal(str(tmp_path / "none.yaml"), "none.yaml", "give an existing file")
    known = "office.yaml:0 to .*office.yaml:99; give"
    for part in ("100", "1-100", "-1", "x", "choose:3"):
        refused(lambda part=part: worlds.specs(f"{office}:{part}"), "no worlds", known)
    refusal(office, "names 100 worlds, but one is needed; give one of them: .*office.yaml:0")
    no_resolution = scenes.write_plan(tmp_path, "office", resolution=None)
    refusal(no_resolution, "office.yaml: the file is no map: give one with .*resolution")

    # Maps on which no robot finds a course
    no_room = "no closed room with a path of 2 m .* radius of 0.31 m"
    no_room += ": check resolution, thresholds and negate"
    negative_map = scenes.write_plan(tmp_path, "office", negate=1)
    refusal(negative_map, no_room)
    black_pixels = np.zeros((50, 50), np.uint8)
    refusal(scenes.write_plan(tmp_path, "shut", black_pixels), no_room)
    white_pixels = np.full((200, 200), 254, np.uint8)
    white_map = scenes.write_plan(tmp_path, "white", white_pixels)
    refusal(white_map, "white.yaml has no occupied cell: check its thresholds and negate")

    # Files that are no maps
    (tmp_path / "text.yaml").write_text("office")
    refusal(str(tmp_path / "text.yaml"), "text.yaml: the file is no map")
    no_image = scenes.write_plan(tmp_path, "office", image="gone.pgm")
    refusal(no_image, "office.yaml: its line image: names gone.pgm, but .*; correct the line")


def test_nothing_in_a_map_is_executed(tmp_path):
    map_file = tmp_path / "office.yaml"
    made_folder = tmp_path / "made"
    argument = json.dumps(str(made_folder))
    map_file.write_text("image: !!python/object/apply:os.mkdir [%s]\n" % argument)
    refused(lambda: worlds.load(str(map_file)), "office.yaml: cannot be read")
    assert not made_folder.exists()
