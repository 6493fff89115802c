"""Tests of the reader of Gazebo worlds, which composes poses like Gazebo, and of the round trip
with the writer.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

import worlds
from tests.support.refusals import refused
from tests.support.scenes import as_barn, box, cylinder, model, refused_world, sdf, write_world
from worlds import barn, course_files, sdf_writer


def world_of(folder, body):
    """Return the world that is read from an SDF file with these elements."""
    return worlds.load(write_world(folder, sdf(body), "w.world"))


def test_barn_file_with_its_path_file(tmp_path):
    world = worlds.load("generated:7")
    _, path = barn.fields()[7]
    # The first point occurs twice.
    cells = np.concatenate([path[:1], path])
    read_world = worlds.load(write_world(tmp_path, as_barn(world), cells=cells))
    assert read_world.name == "world_7"
    assert np.allclose(read_world.cylinders, world.cylinders, atol=1e-6)
    assert read_world.course.start == world.course.start
    assert read_world.course.goal == world.course.goal
    assert np.array_equal(read_world.course.path, world.course.path)


def test_poses_of_model_link_and_collision_are_composed(tmp_path):
    body = """
        <model name='m'>
          <pose>1 2 0 0 0 1.5707963267948966</pose>
          <link name='l'>
            <pose>1 0 0.5 0 0 0</pose>
            <collision name='c'>
              <pose>0 1 0 0 0 0.5</pose>
              <geometry><box><size>2 1 1</size></box></geometry>
            </collision>
            <visual name='v'>
              <geometry><mesh><uri>model://x.dae</uri></mesh></geometry>
            </visual>
          </link>
        </model>"""
    world = world_of(tmp_path, body)
    # The model is rotated by 90 degrees, so the link is at (1, 3) and the collision at (0, 3).
    assert np.allclose(world.boxes, [[0.0, 3.0, math.pi / 2 + 0.5, 2.0, 1.0]])


def test_a_slab_under_the_start_is_floor_and_the_foot_of_a_barrier_is_an_obstacle(tmp_path):
    barrier = box("barrier", 0, 0, 0.15, 4, 0.65, 0.3) + box("foot", 0, 0, 0.03, 4, 0.81, 0.06)
    # The slab's top is 5 cm above the ground.
    slab = box("slab", 0, 0, 0.0, 20, 20, 0.1)
    world = world_of(tmp_path, barrier + slab)
    assert world.boxes.tolist() == [
        [0.0, 0.0, 0.0, 4.0, 0.65],
        [0.0, 0.0, 0.0, 4.0, 0.81],
    ]


def test_a_saved_state_determines_the_poses_of_its_models(tmp_path, caplog):
    body = (
        cylinder(1, 1, name="a")
        + cylinder(2, 2, name="b")
        + """<state world_name='default'>
          <model name='a'>
            <pose>5 5 0 0 0 0</pose>
            <link name='link'><pose>5 5 0 0 0 0</pose></link>
          </model>
          <model name='b'><pose>2 2 0 0 0 0</pose><scale>2 2 1</scale></model>
        </state>"""
    )
    # Gazebo saves the poses of a running simulation beside those of its start.
    cylinders = world_of(tmp_path, body).cylinders
    assert np.allclose(cylinders, [(5, 5, 0.075), (2, 2, 0.075)])
    assert "not supported: the scale of model 'b'; ignored" in caplog.text


def test_lying_shapes_are_read_and_shapes_overhead_are_not(tmp_path):
    roller = "<cylinder><radius>0.2</radius><length>2</length></cylinder>"
    body = (
        model("lying", "0 0 0.2 1.5707963267948966 0 0", roller)
        + box("bridge", 0, 5, 3, 4, 1, 0.2)
        + model("ball", "3 3 0.3 0 0 0", "<sphere><radius>0.3</radius></sphere>")
        + model("on its side", "6 0 0.5 0 1.5707963267948966 0", "<box><size>1 2 0.5</size></box>")
    )
    world = world_of(tmp_path, body)
    assert np.allclose(world.cylinders, [[3, 3, 0.3]])
    # The roller, 2 m long and 0.4 m thick, and the box, 0.5 m by 2 m on its side. A box may be
    # turned by a quarter, so that only its longer edge has a direction.
    lying_roller, box_on_its_side = world.boxes
    _, _, yaw, size_x, size_y = lying_roller
    assert sorted((size_x, size_y)) == pytest.approx([0.4, 2.0])
    assert abs(math.sin(yaw)) * size_x == pytest.approx(2.0)
    assert sorted(box_on_its_side[3:]) == pytest.approx([0.5, 2.0])


def test_a_leaning_cylinder_covers_its_side_and_the_discs_at_its_ends(tmp_path):
    post = "<cylinder><radius>0.2</radius><length>2</length></cylinder>"
    # It leans by 60 degrees: 2 m of side, of which 1.73 m are horizontal, and half of each disc.
    world = world_of(tmp_path, model("leaning", f"0 0 0.5 0 {math.radians(60)} 0", post))
    assert np.allclose(world.boxes, [[0.0, 0.0, 0.0, math.sqrt(3.0) + 0.2, 0.4]])


def test_poses_in_degrees_empty_and_of_five_numbers_are_read(tmp_path):
    body = (
        "<model name='m'><pose/><link name='l'><pose>0 0 0 0 0</pose>"
        "<collision name='c'><pose degrees='true'>1 1 0 0 0 90</pose>"
        "<geometry><box><size>2 1 1</size></box></geometry></collision></link></model>"
    )
    world = world_of(tmp_path, body)
    assert np.allclose(world.boxes, [[1, 1, math.pi / 2, 2, 1]])


# Its last coordinate has no finite decimal fraction.
MOVER = worlds.Mover(
    0.5,
    (
        (0.0, 1.0, 2.0),
        (1.5, 2.0, 2.5),
        (3.25, 3.0, 1.0 / 3.0),
    ),
)


@pytest.mark.parametrize("spec", ["generated:7", "physical_course"])
@pytest.mark.parametrize(
    "movers",
    [
        (),
        (MOVER, replace(MOVER, length=9.0, repeat=False), replace(MOVER, looks=True)),
    ],
)
def test_written_and_read_back_is_the_same_world(tmp_path, spec, movers):
    world = replace(worlds.load(spec), movers=movers)
    world = replace(world, course=replace(world.course, planner_ends=bool(movers)))
    world_file = str(tmp_path / "copy.world")
    sdf_writer.write(world, world_file)
    read_back = worlds.load(world_file)
    assert np.array_equal(world.cylinders, read_back.cylinders)
    assert np.allclose(world.boxes, read_back.boxes, rtol=0, atol=1e-12)
    assert world.movers == read_back.movers
    assert np.array_equal(world.course.path, read_back.course.path)
    assert {**vars(world.course), "path": None} == {**vars(read_back.course), "path": None}
    # A world from a file keeps its size.
    assert worlds.scaled(read_back, 0.5) is read_back


def test_folder_in_the_order_of_numbers(tmp_path):
    for number in (10, 9, 2):
        write_world(tmp_path, sdf(cylinder(0, 0)), "world_%d.world" % number)
    names = [world.name for world in worlds.Worlds(str(tmp_path))]
    assert names == ["world_2", "world_9", "world_10"]


def named(tag, name, frame="", inside="", x=0):
    """Return an element with a pose x [m] ahead in a frame, by default that of its parent."""
    relative_to = f" relative_to='{frame}'" if frame else ""
    pose = f"<pose{relative_to}>{x} 0 0 0 0 0</pose>"
    return f"<{tag} name='{name}'>{pose}{inside}</{tag}>"


DISC = named("collision", "c", inside="<geometry><sphere><radius>0.3</radius></sphere></geometry>")


@pytest.mark.parametrize(
    ("model", "link", "inner"),
    [
        ("", "", ""),
        ("world", "__model__", "__model__"),
    ],
)
def test_a_pose_may_name_the_frame_that_it_is_in(tmp_path, model, link, inner):
    nested = named("model", "inner", inner, named("link", "l", link, DISC, 1), 2)
    outer = named("model", "m", model, nested, 4)
    (disc,) = world_of(tmp_path, outer).cylinders
    # 4 m, 2 m and 1 m ahead of each other
    assert np.allclose(disc, (7, 0, 0.3))


LINK = named("link", "l", "", DISC)
OTHER = named("model", "other", "", LINK, 9)


@pytest.mark.parametrize(
    ("body", "unread"),
    [
        (
            named("model", "m", "other", LINK),
            "model 'm' (its pose is relative to 'other')",
        ),
        (
            named("model", "m", "", named("link", "l", "joint", DISC)),
            "link 'l' of model 'm' (its pose",
        ),
        (
            named("model", "m", "", LINK.replace("<pose>", "<pose frame='x'>", 1)),
            "link 'l' of model 'm' (its pose",
        ),
        (
            LINK.replace("sphere", "mesh").join(("<model name='m'>", "</model>")),
            "collision 'c' of model 'm' (a mesh)",
        ),
        ("<include><uri>model://house</uri></include>", "the include 'model://house'"),
        ("<actor name='a'/>", "not supported: <actor>; ignored"),
        ("<population name='p'/>" * 7, "<population>, <population> and 2 more"),
    ],
)
def test_unsupported_elements_are_named_in_one_line_and_the_rest_is_read(
    tmp_path, caplog, body, unread
):
    (disc,) = world_of(tmp_path, body + OTHER).cylinders
    # The other model is read.
    assert np.allclose(disc, (9, 0, 0.3))
    (record,) = caplog.records
    assert unread in record.getMessage()
    assert "\n" not in record.getMessage()


def test_a_course_can_be_given_for_a_file(tmp_path, monkeypatch, capsys):
    hall = write_world(tmp_path, sdf(cylinder(0, 0) + cylinder(60, 0), ""), "hall.world")
    refused_world(hall, "has no course; give one: python -m worlds.sdf_writer .* --course X Y X Y")
    out = str(tmp_path / "out.world")
    points = ["0", "2", "30", "3", "60", "2"]
    monkeypatch.setattr("sys.argv", ["sdf_writer", hall, out, "--course", *points])
    assert sdf_writer.main() == 0, capsys.readouterr()
    course = worlds.load(out).course
    assert course.path.tolist() == [
        [0.0, 2.0],
        [30.0, 3.0],
        [60.0, 2.0],
    ]


def test_the_length_of_a_course_is_the_distance_of_its_ends():
    course = course_files.along(np.array([(0.0, 0.0), (0.2, 0.0), (5.0, 0.0)]))
    assert course.goal == (5.0, 0.0, 0.0)
    # A robot at its start would be at its goal.
    round_course = np.array([(0.0, 0.0), (5.0, 0.0), (0.2, 0.0)])
    refused(lambda: course_files.along(round_course), "the course has no length")


def test_a_world_of_stage_is_refused(tmp_path):
    stage = write_world(tmp_path, "define block model\n(\n  size [0.5 0.5 0.5]\n)\n", "stage.world")
    refused_world(stage, "give a Gazebo world file")
