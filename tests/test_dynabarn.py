"""DynaBARN's moving obstacles: key frames out of compiled plugins, the table beside the worlds, places over time."""

import logging
import math
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from worlds_sdf import moving, put, sdf

import worlds
from worlds import movers_table
from worlds.world import WorldError

ROOT = Path(__file__).resolve().parents[1]
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
template <class T> struct Vector3 {
%s
};
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
INLINED_WITH_VTABLE = (
    "T d[3]; Vector3(const T &x, const T &y, const T &z) { d[0] = x; d[1] = y; d[2] = z; } virtual ~Vector3() {}"
)
INLINED_PLAIN = "T d[3]; Vector3(const T &x, const T &y, const T &z) { d[0] = x; d[1] = y; d[2] = z; }"
OUTSIDE = "T d[3]; Vector3(const T &x, const T &y, const T &z); virtual ~Vector3();"

ANIMATION = '    boost::shared_ptr<common::PoseAnimation> a(new common::PoseAnimation("o", %s, true));\n'
FRAME = """    {
        common::PoseKeyFrame *key = a->CreateKeyFrame(%r);
        key->Translation(ignition::math::Vector3<double>(%r, %r, 0));
        key->Rotation(ignition::math::Quaternion<double>(0, 0, 0));
    }
"""
TAIL = "    set_animation(a);\n}\n}\n"


def source(vector=OUTSIDE, body=None, length="8.0"):
    frames = "".join(FRAME % frame for frame in FRAMES) if body is None else body
    return HEAD % vector + ANIMATION % length + frames + TAIL


def build(folder, text, *options, name="easylibobs_3"):
    if shutil.which("g++") is None:
        pytest.skip("no g++ here")
    path = folder / (name + ".cc")
    path.write_text(text)
    out = folder / (name + ".so")
    subprocess.run(["g++", "-shared", "-fPIC", *options, "-o", out, path], check=True)
    path.unlink()
    return str(out)


def read(path):
    from worlds import plugin_frames

    return plugin_frames.read(path)


@pytest.mark.parametrize("vector", [OUTSIDE, INLINED_WITH_VTABLE, INLINED_PLAIN], ids=["call", "vtable", "plain"])
@pytest.mark.parametrize("options", ["-O0", "-O1", "-O2 -fcf-protection", "-O3 -fno-plt", "-O2 -s -mavx"])
def test_key_frames_of_a_compiled_plugin(tmp_path, vector, options):
    found = read(build(tmp_path, source(vector), *options.split()))
    assert found == movers_table.Animation(8.0, True, tuple(FRAMES))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (source(body="for (int i = 0; i < 40; i++) {%s}" % (FRAME % (1.0, 2.0, 3.0))), "in a loop"),
        (source(body=(FRAME % (1.0, 2.0, 3.0)).replace("2.0", "(double)(long)a.p")), "computes its key frame 0"),
        (source(body="".join(FRAME % f for f in FRAMES[:1])), "one key frame"),
        (source(length="(double)(long)this"), "length of its animation"),
        (source(body=""), "no key frames"),
        (source(body='__asm__(".rept 70000\\nnop\\n.endr");'), "too much code"),
        (source(body=ANIMATION.replace(" a(", " b(") % "5.0" + FRAME % FRAMES[0] + FRAME % FRAMES[1]), "2 animations"),
        (source(body=(FRAME % FRAMES[0] + FRAME % FRAMES[1]).replace(", 0))", ", 4))")), "leaves the ground"),
    ],
)
def test_what_is_not_understood_is_refused_in_a_line(tmp_path, text, words):
    path = build(tmp_path, text, "-O1")
    with pytest.raises(WorldError, match=words) as caught:
        read(path)
    assert path in str(caught.value)
    assert "\n" not in str(caught.value)


def test_damaged_plugins_are_refused_and_never_crash(tmp_path):
    whole = bytearray(Path(build(tmp_path, source(), "-O0")).read_bytes())
    rng = np.random.default_rng(3)
    hurt = tmp_path / "hurt.so"
    refused = []
    for n in range(60):
        content = bytearray(whole)
        if n % 3 == 0:
            content = content[: int(rng.integers(len(whole)))]
        else:
            first, last = (0, 64) if n % 3 == 1 else (len(whole) - 2000, len(whole))  # the head, the table of sections
            for place in rng.integers(first, last, 8):
                content[place] = rng.integers(256)
        hurt.write_bytes(content)
        try:
            read(str(hurt))
        except WorldError as error:
            refused.append(str(error))
    assert len(refused) > 30
    assert not [line for line in refused if "\n" in line]


def command(*arguments):
    return subprocess.run(
        [sys.executable, "-m", "worlds.dynabarn_table", *map(str, arguments)], cwd=ROOT, capture_output=True, text=True
    )


def test_command_makes_the_table_and_names_what_it_does_not_understand(tmp_path, caplog):
    plugins, folder = tmp_path / "plugins", tmp_path / "worlds"
    plugins.mkdir()
    folder.mkdir()
    build(plugins, source(), "-O0", name="easylibobs_3")
    (plugins / "hardlibobs_5.so").write_bytes(b"not a plugin")
    put(folder, sdf(moving("easylibobs_3") + moving("o", filename="/opt/lib/easylibobs_3.so")), "world_0.world")
    path = put(folder, sdf(moving("easylibobs_3") + moving("hardlibobs_5") + moving("lamp")), "world_1.world")
    done = command(folder, plugins)
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 2
    assert "hardlibobs_5.so" in done.stderr
    assert "lamp.so" in done.stderr
    assert "1 plugins with 4 key frames" in done.stdout
    assert [len(w.movers) for w in worlds.load_all(str(folder))] == [2, 2]
    with caplog.at_level(logging.WARNING):
        caplog.clear()
        from worlds import dynabarn

        dynabarn._warned.clear()
        world = worlds.load(path)
    (record,) = caplog.records
    assert "hardlibobs_5" in record.message
    assert "lamp" in record.message
    assert "easylibobs_3" not in record.message
    assert len(world.cylinders) == 1  # the lamp stands
    assert world.movers[0] == worlds.Mover(0.5, tuple(FRAMES), 8.0)


def table(folder, *rows):
    path = folder / movers_table.NAME
    path.write_text("\n".join((",".join(movers_table.COLUMNS),) + rows) + "\n")
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
        (("a,10,1,0,0,0",), "are 1; there must be 2"),
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
        movers_table.read(path)


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


def test_a_source_of_a_mebibyte_is_read_in_seconds(tmp_path):
    text = moving("obs_3")
    for garbage in ("CreateKeyFrame(1);", "CreateKeyFrame(1); Vector3d(", "Vector3d(1,", "CreateKeyFrame(1  "):
        (tmp_path / "obs_3.cc").write_text(garbage * (2**20 // len(garbage)))
        started = time.process_time()
        with pytest.raises(WorldError, match="key frames in .*obs_3.cc are 0"):
            worlds.load(put(tmp_path, sdf(text), "world_0.world"))
        assert time.process_time() - started < 3.0


def test_a_sources_place_belongs_to_the_last_time_without_one(tmp_path):
    (tmp_path / "obs_3.cc").write_text(
        "Vector3d(9, 9, 0); k = a->CreateKeyFrame(0); // a remark %s\n v = Vector3d(i, j, 0); Vector3d( 1 , 2 , 0);"
        "Vector3d(8, 8, 0);\nCreateKeyFrame( 1.5 ); Vector3d(-3, 4e0, 0); CreateKeyFrame(9);" % ("x" * 5000)
    )
    (mover,) = worlds.load(put(tmp_path, sdf(moving("obs_3")), "world_0.world")).movers
    assert mover.waypoints == ((0.0, 1.0, 2.0), (1.5, -3.0, 4.0))
