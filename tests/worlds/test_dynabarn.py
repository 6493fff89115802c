"""DynaBARN's moving obstacles: key frames out of compiled plugins, the table beside the worlds, places over time."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import worlds
from tests.support import ROOT
from tests.support.worlds_sdf import moving, put, sdf
from worlds import dynabarn, dynabarn_table
from worlds.world import WorldError

FRAMES = [(0.0, 9.0, 10.0), (3.87, 7.78, 4.32), (5.5, 0.0, 0.0), (8.0, -7.0, -10.0)]

# What a plugin's source amounts to, with the few declarations that it needs of Gazebo and Ignition Math.
HEAD = """
#include <string>
namespace boost {
template <class T> struct shared_ptr { T *p; shared_ptr(T *q); ~shared_ptr(); T *operator->() const; };
}
namespace gazebo { namespace physics { struct Model; } }
namespace sdf { struct Element; }
namespace ignition { namespace math { inline namespace v4 {
template <class T> struct Vector3 { T d[3]; Vector3(const T &x, const T &y, const T &z); virtual ~Vector3(); };
template <class T> struct Quaternion { T q[4]; Quaternion(const T &r, const T &p, const T &y); };
} } }
namespace gazebo {
namespace common {
struct PoseKeyFrame {
    void Translation(const ignition::math::Vector3<double> &);
    void Rotation(const ignition::math::Quaternion<double> &);
};
struct PoseAnimation {
    char data[80];
    PoseAnimation(const std::string &name, double length, bool repeat);
    PoseKeyFrame *CreateKeyFrame(double time);
};
}
void set_animation(boost::shared_ptr<common::PoseAnimation> a);
struct obs { virtual void Load(boost::shared_ptr<physics::Model>, boost::shared_ptr<sdf::Element>); };
void obs::Load(boost::shared_ptr<physics::Model>, boost::shared_ptr<sdf::Element>) {
"""
ANIMATION = '    boost::shared_ptr<common::PoseAnimation> a(new common::PoseAnimation("o", %s, true));\n'
FRAME = """    {
        common::PoseKeyFrame *key = a->CreateKeyFrame(%r);
        key->Translation(ignition::math::Vector3<double>(%r, %r, 0));
        key->Rotation(ignition::math::Quaternion<double>(0, 0, 0));
    }
"""
TAIL = "    set_animation(a);\n}\n}\n"


def source(body=None, length="8.0"):
    return HEAD + ANIMATION % length + ("".join(FRAME % frame for frame in FRAMES) if body is None else body) + TAIL


def build(folder, text, name="easylibobs_3"):
    """A plugin compiled as DynaBARN's are, without optimisation."""
    path = folder / (name + ".so")
    subprocess.run(["g++", "-shared", "-fPIC", "-x", "c++", "-", "-o", path], input=text, encoding="utf-8", check=True)
    return str(path)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (source(body="for (int i = 0; i < 40; i++) {%s}" % (FRAME % (1.0, 2.0, 3.0))), "in a loop"),
        (
            source(body=(FRAME % (1.0, 2.0, 3.0)).replace("2.0", "(double)(long)a.p")),
            "computes an argument of ig",
        ),
        (source(body=""), "are 0; there must be 2"),
        (source(body=ANIMATION.replace(" a(", " b(") % "5.0"), "2 animations"),
        (source(body=(FRAME % FRAMES[0]).replace(", 0))", ", 4))")), "a place on the ground"),
    ],
)
def test_a_plugin_that_is_not_understood_is_refused_in_a_line(tmp_path, text, words):
    path = build(tmp_path, text)
    with pytest.raises(WorldError, match=words) as caught:
        dynabarn_table.read(path)
    assert path in str(caught.value)
    assert "\n" not in str(caught.value)


def test_command_makes_the_table_and_names_what_it_does_not_understand(tmp_path):
    plugins, folder = tmp_path / "plugins", tmp_path / "worlds"
    plugins.mkdir()
    folder.mkdir()
    build(plugins, source())
    (plugins / "hardlibobs_5.so").write_bytes(b"not a plugin")
    path = put(folder, sdf(moving("easylibobs_3") + moving("o", filename="/opt/lib/easylibobs_3.so")), "world_0.world")
    other = put(folder, sdf(moving("easylibobs_3") + moving("hardlibobs_5") + moving("lamp")), "world_1.world")
    command = [sys.executable, "-m", "worlds.dynabarn_table", str(folder), str(plugins)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 2
    assert "hardlibobs_5.so" in done.stderr
    assert "lamp.so" in done.stderr
    assert "1 plugins with 4 key frames" in done.stdout
    assert worlds.load(path).movers == (worlds.Mover(0.5, tuple(FRAMES), 8.0),) * 2
    with pytest.raises(WorldError, match="'hardlibobs_5' of model .* has no rows in movers.csv"):
        worlds.load(other)


def table(folder, *rows):
    path = folder / dynabarn.NAME
    path.write_text("\n".join((",".join(dynabarn.COLUMNS),) + rows) + "\n")
    return str(path)


def test_places_over_time_are_gazebos(tmp_path):
    """By hand: Catmull-Rom tangents, tension 0, between key frames; repeated every 10 s."""
    rows = ["hardlibobs_7,10,1,%s" % row for row in ("0,0,0", "2,4,0", "4,4,4", "8,0,8")]
    table(tmp_path, *rows)
    (mover,) = worlds.load(put(tmp_path, sdf(moving("hardlibobs_7")), "world_0.world")).movers
    assert mover.position(0.0) == (0.0, 0.0)
    assert mover.position(2.0) == (4.0, 0.0)
    # half way: mean of the ends + 1/8 of the difference of their tangents, (2, 0) at the start and (2, 2) after it
    assert mover.position(1.0) == pytest.approx((2.0 + (2.0 - 2.0) / 8, 0.0 + (0.0 - 2.0) / 8))
    assert mover.position(3.0) == pytest.approx((4.0 + (2.0 - -2.0) / 8, 2.0 + (2.0 - 4.0) / 8))
    assert mover.position(6.0) == pytest.approx((2.0 + (-2.0 - -2.0) / 8, 6.0 + (4.0 - 2.0) / 8))
    assert mover.position(9.0) == (0.0, 8.0)
    assert mover.position(13.0) == pytest.approx(mover.position(3.0))


def test_closed_paths_equal_times_and_animations_that_do_not_repeat():
    closed = worlds.Mover(0.5, ((0.0, 0.0, 0.0), (1.0, 2.0, 0.0), (2.0, 2.0, 2.0), (3.0, 0.0, 0.0)))
    # tangents at the first point: half the chord from the last but one to the second
    assert closed.position(0.5) == pytest.approx((1.0 + (0.0 - 1.0) / 8, 0.0 + (-1.0 - 1.0) / 8))
    jump = worlds.Mover(0.5, ((0.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 5.0, 5.0), (2.0, 6.0, 5.0)))
    assert jump.position(1.0) == (1.0, 0.0)
    assert jump.position(1.0 + 1e-9) == pytest.approx((5.0, 5.0))
    once = worlds.Mover(0.5, ((1.0, 0.0, 1.0), (2.0, 4.0, 1.0)), 3.0, False)
    assert [once.position(t) for t in (0.0, 2.0, 50.0)] == [(0.0, 1.0), (4.0, 1.0), (4.0, 1.0)]


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (("a,10,1,0,0,0", "a,10,1,nan,0,0"), "line 3"),
        (("a,10,1,0,0,0", "a,11,1,1,0,0"), "length and repeat differ"),
        (("a,10,1,2,0,0", "a,10,1,1,0,0"), "rise from 0"),
        (("a,10,yes,2,0,0",), "repeat 0 or 1"),
        (("a,0,1,0,0,0", "a,0,1,1,0,0"), "length above 0"),
    ],
)
def test_wrong_tables_are_refused_in_a_line(tmp_path, rows, words):
    path = table(tmp_path, *rows)
    with pytest.raises(WorldError, match=words) as caught:
        worlds.load(put(tmp_path, sdf(moving("easylibobs_1")), "world_0.world"))
    assert path in str(caught.value)
    Path(path).write_text("plugin;time\n")
    with pytest.raises(WorldError, match="must begin with the line plugin,length"):
        dynabarn.read_table(path)


def test_course_is_the_challenges_whatever_lies_beside(tmp_path):
    table(tmp_path, "easylibobs_1,4,1,0,0,0", "easylibobs_1,4,1,4,1,1")
    cells = np.column_stack([np.full(66, 15), np.arange(66)])  # of BARN's world of the same number
    course = worlds.load(put(tmp_path, sdf(moving("easylibobs_1")), "world_7.world", cells=cells)).course
    assert course.start == (11.0, 0.0, math.pi)
    assert course.goal == (-9.0, 0.0, math.pi)
    assert (course.goal_tolerance, course.length_m) == (1.0, 19.0)
    assert not course.done(-7.9, 0.0)
    assert course.done(-8.1, 0.0)
    assert course.sent_goal == pytest.approx((-8.7, 0.0, math.pi))  # on a map that ends 20 m from the start
