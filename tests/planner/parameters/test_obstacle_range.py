"""Tests of the ranges up to which lasers mark and clear obstacles in the costmaps."""

import copy

import pytest

from applr_ros1.planner.move_base import MoveBase
from applr_ros1.planner.parameters.check import check, complete, remarks
from applr_ros1.planner.parameters.layers import section_in_files
from applr_ros1.planner.parameters.obstacle_range import laser_sources, mismatch, seeing
from applr_ros1.planner.parameters.trees import merged
from applr_ros1.robots import NAMES, load

JACKAL_FILES = load("jackal").parameters()
JACKAL_SOURCES = [
    "global_costmap/obstacles_layer/scan",
    "local_costmap/obstacles_layer/scan",
]


@pytest.mark.parametrize("name", NAMES)
def test_both_costmaps_of_any_robot_mark_as_far_as_is_asked_and_clear_half_a_metre_farther(name):
    files = load(name).parameters()
    tree = merged(files, seeing(files, 4.0))
    assert check(tree) == []
    assert remarks(tree) == []
    move_base = MoveBase(tree)
    for costmap in (move_base.global_costmap, move_base.local_costmap):
        (buffer,) = costmap.obstacle_layers[0].buffers
        assert (buffer.source.obstacle_range, buffer.source.raytrace_range) == (4.0, 4.5)


def test_the_range_in_force_is_that_of_the_source_else_of_the_sections_above_it_as_in_cpp():
    tree = copy.deepcopy(JACKAL_FILES)
    tree["obstacle_range"] = 2.0
    for costmap, layer_range in (("global_costmap", 3.0), ("local_costmap", None)):
        layer = tree[costmap]["obstacles_layer"]
        del layer["scan"]["obstacle_range"], layer["obstacle_range"]
        if layer_range is not None:
            layer["obstacle_range"] = layer_range
    ranges = [source.obstacle_range for source in laser_sources(tree)]
    assert ranges == [3.0, 2.0]
    # A tree of a parameter server is complete.
    assert laser_sources(complete(tree)) == laser_sources(tree)


@pytest.mark.parametrize("unreadable", ["far", None, True])
def test_an_unreadable_range_is_the_default_as_in_cpp(unreadable):
    tree = copy.deepcopy(JACKAL_FILES)
    for costmap in ("global_costmap", "local_costmap"):
        tree[costmap]["obstacles_layer"]["scan"]["obstacle_range"] = unreadable
    assert [source.obstacle_range for source in laser_sources(tree)] == [2.5, 2.5]


LASER = {"data_type": "LaserScan", "clearing": True, "obstacle_range": 2.5}


@pytest.mark.parametrize(
    "costmap",
    [
        {"observation_sources": "scan", "scan": LASER},
        {"obstacle_layer": {"observation_sources": "scan", "scan": LASER}},
        {"observation_sources": "scan", "obstacle_layer": {"scan": LASER}},
        # The costmap's section replaces that of the layer.
        {"observation_sources": "scan", "scan": LASER, "obstacle_layer": {"scan": LASER}},
    ],
)
def test_without_plugins_a_range_is_given_to_the_section_that_counts(costmap):
    tree = {"local_costmap": costmap}
    (source,) = laser_sources(merged(tree, seeing(tree, 4.0)))
    assert source.obstacle_range == 4.0


def test_without_plugins_the_value_of_a_layer_is_given_to_its_costmap():
    """A value of the costmap replaces that of the layer."""
    costmap = {"inflation_radius": 0.5, "inflation_layer": {"cost_scaling_factor": 3.0}}
    section = section_in_files({"local_costmap": costmap}, "local_costmap/inflation_layer")
    assert section == "local_costmap"


def test_only_lasers_that_mark_and_clear_get_a_range():
    tree = copy.deepcopy(JACKAL_FILES)
    layer = tree["local_costmap"]["obstacles_layer"]
    layer["observation_sources"] = "scan bump predicted"
    layer["bump"] = {"data_type": "LaserScan", "marking": True}
    layer["predicted"] = {"data_type": "PointCloud2", "marking": True, "clearing": True}
    assert [source.path for source in laser_sources(tree)] == JACKAL_SOURCES


def test_a_range_that_differs_from_the_needed_one_is_one_line_with_both_lines_for_the_file():
    assert mismatch(JACKAL_FILES, 2.5, "the set was made for 2.5 m") == ""
    line = mismatch(JACKAL_FILES, 5.0, "method applr was made for 5 m")
    assert "\n" not in line
    for source_path in JACKAL_SOURCES:
        assert f"{source_path}/obstacle_range" in line
    assert "up to 2.5 m, but method applr was made for 5 m;" in line
    assert line.endswith("give obstacle_range: 5, raytrace_range: 5.5")

    # Only the costmap that differs is named. Values of 5.0000001 come from a parameter server.
    local = seeing(JACKAL_FILES, 5.0000001)["local_costmap"]
    line = mismatch(merged(JACKAL_FILES, {"local_costmap": local}), 5.0, "method x needs 5 m")
    assert line.startswith("global_costmap/obstacles_layer/scan/obstacle_range: ")


@pytest.mark.parametrize(("obstacle_range", "differs"), [(5.004, False), (5.006, True)])
def test_a_range_within_a_thousandth_of_the_needed_one_is_no_mismatch(obstacle_range, differs):
    tree = merged(JACKAL_FILES, seeing(JACKAL_FILES, obstacle_range))
    line = mismatch(tree, 5.0, "method x needs 5 m")
    assert (line != "") is differs
