"""World files that are missing, malformed, hostile or without a passage: one line each, in bounded time and memory."""

import contextlib
import os
import pickle
import resource
import subprocess
import sys
import time

import numpy as np
import pytest
from worlds_sdf import as_barn, cylinder, put, sdf

import worlds
from worlds import builtin, sdf_writer, sdf_xml

LETTERS = "abcdefghijklmnopqrstuvwxyz"
BOMB = '<!DOCTYPE sdf [<!ENTITY a "aaaaaaaaaa">%s]><sdf version="1.6"><world name="w">&z;</world></sdf>' % "".join(
    '<!ENTITY %s "%s">' % (b, "&%s;" % a * 10) for a, b in zip(LETTERS, LETTERS[1:])
)
EXTERNAL = (
    "<!DOCTYPE sdf [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><sdf><world name='w'><model name='&x;'/></world></sdf>"
)


def refused(path, *words):
    started = time.process_time()
    with pytest.raises(worlds.WorldError) as error:
        worlds.load(str(path))
    assert time.process_time() - started < 5.0
    line = str(error.value)
    assert "\n" not in line
    assert len(line) < 600
    for word in words:
        assert word in line, line
    return line


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["not well-formed"]),
        ("\0" * 1000, ["not well-formed"]),
        ("<sdf><world name='w'>", ["not well-formed"]),
        ("<html></html>", ["no <world>"]),
        (BOMB, ["DOCTYPE"]),
        (EXTERNAL, ["DOCTYPE"]),
        ("<a>" * 100_000, ["nests"]),
        (sdf(""), ["no obstacle"]),
        (sdf(cylinder(float("nan"), 0)), ["unit_cylinder_0", "nan", "finite"]),
        (sdf(cylinder(float("inf"), 0)), ["unit_cylinder_0", "finite"]),
        (sdf(cylinder(1e30, 0)), ["finite and within"]),
        (sdf(cylinder(0, 0, radius=-1)), ["radius", "above 0"]),
        (sdf(cylinder(0, 0, radius="wide")), ["radius", "wide", "1 number"]),
        (sdf(cylinder(0, 0).replace("0.000000</pose>", "</pose>")), ["pose", "6 numbers"]),
        (sdf(cylinder(0, 0).replace("<cylinder>", "<mesh><uri>x</uri></mesh><cylinder>")), ["mesh", "replace"]),
        (sdf("<include><uri>model://house</uri></include>"), ["model://house", "inline"]),
        (sdf("<population name='p'/>"), ["population"]),
        (sdf(cylinder(0, 0).replace("frame=''", "relative_to='elsewhere'")), ["elsewhere"]),
        (sdf(cylinder(0, 0) + cylinder(900, 900)), ["too large"]),
        ("<?xml version='1.0' encoding='klingon'?><sdf/>", []),
    ],
)
def test_bad_files(tmp_path, text, words):
    refused(put(tmp_path, text, "w.world"), *words)


def test_missing_folder_and_device(tmp_path):
    refused(tmp_path / "missing.world", "missing.world", "give an existing file")
    (tmp_path / "folder.world").mkdir()
    refused(tmp_path / "folder.world", "a folder, pipe or device")
    os.mkfifo(str(tmp_path / "pipe.world"))
    refused(tmp_path / "pipe.world", "a folder, pipe or device")
    refused("x\0y.world", "cannot be read")
    (tmp_path / "empty").mkdir()
    with pytest.raises(worlds.WorldError, match="0 .world files"):
        worlds.load_all(str(tmp_path / "empty"))


def test_a_hundred_thousand_cylinders(tmp_path):
    refused(put(tmp_path, sdf("".join(cylinder(n, 0) for n in range(100_000))), "w.world"), "bytes")
    collision = (
        "<collision name='c'><geometry><cylinder><radius>.1</radius><length>1</length></cylinder></geometry>"
        "</collision>"
    )
    refused(put(tmp_path, sdf("<model name='m'><link name='l'>%s</link></model>" % (collision * 100_000)), "w.world"))
    few = sdf("<model name='m'><link name='l'>%s</link></model>" % (collision * 20_000))
    refused(put(tmp_path, few, "w.world"), "10000 obstacles")


def test_memory_stays_bounded(tmp_path):
    path = put(tmp_path, sdf("<a/>" * 3_900_000), "w.world")
    code = (
        "import resource, sys, worlds\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try: worlds.load(sys.argv[1])\n"
        "except worlds.WorldError as error: print(error)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    out = subprocess.run(
        [sys.executable, "-c", code, path],
        capture_output=True,
        text=True,
        check=True,
        cwd=os.path.dirname(os.path.dirname(os.path.abspath(__file__))),
    ).stdout.split("\n")
    assert "elements" in out[0]
    assert int(out[1]) < 200_000


def test_sealed_worlds_have_no_passage(tmp_path):
    world = worlds.load("generated:7")
    _, path = builtin.fields()[7]
    row = "".join(cylinder(-4.425 + 0.15 * r, 7.425, name="seal_%d" % r) for r in range(30))
    sealed = as_barn(world).replace("</world>", row + "</world>")
    refused(put(tmp_path, sealed), "no passage")
    refused(put(tmp_path, sealed, cells=path), "no passage")
    wall = (
        "<model name='w'><pose>0 2 .5 0 0 0</pose><link name='l'><collision name='c'><geometry><box>"
        "<size>8 .3 1</size></box></geometry></collision></link></model>"
    )
    refused(put(tmp_path, sdf(wall), "wall.world"), "no passage")


class Evil:
    def __reduce__(self):
        return os.system, ("touch evil-was-here",)


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        (np.array([Evil(), Evil()], dtype=object), ["Python objects"]),
        (np.array([[1.0, 2.0], [3.0, 4.0]]), ["float64"]),
        (np.zeros((3, 3), dtype=int), ["shape"]),
        (np.zeros((0, 2), dtype=int), ["shape"]),
        (np.array([[5, 0], [5, 40]]), ["outside"]),
        (np.array([[5, 0], [-1, 1]]), ["outside"]),
        (np.array([[5, 0], [9, 9]]), ["not neighbours"]),
        (np.array([[2**62, 0], [5, 1]]), ["outside"]),
    ],
)
def test_bad_path_files(tmp_path, monkeypatch, cells, words):
    monkeypatch.chdir(tmp_path)
    refused(put(tmp_path, as_barn(worlds.load("generated:7")), cells=cells), "path_7.npy", *words)
    assert not os.path.exists("evil-was-here")


def npy(header, body=b""):
    header = header.ljust(117).encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + body


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x93NUMPY",
        b"x" * (2**20 + 1),
        pickle.dumps(Evil()),
        npy("{'descr': __import__('os')}"),
        npy("{" * 100),
        npy("{'descr': '<i8', 'fortran_order': False, 'shape': (9000, 2), }", b"\0" * 16),
        npy("{'descr': '<i8', 'fortran_order': False, 'shape': (99999999999999, 2), }"),
    ],
)
def test_malformed_path_files(tmp_path, content):
    path = put(tmp_path, as_barn(worlds.load("generated:7")), cells=np.zeros((2, 2), dtype=int))
    (tmp_path / "path_files" / "path_7.npy").write_bytes(content)
    refused(path, "path_7.npy")


def test_path_file_outside_its_folder(tmp_path):
    _, cells = builtin.fields()[7]
    np.save(str(tmp_path / "elsewhere.npy"), cells)
    (tmp_path / "in" / "path_files").mkdir(parents=True)
    os.symlink(str(tmp_path / "elsewhere.npy"), str(tmp_path / "in" / "path_files" / "path_7.npy"))
    refused(put(tmp_path / "in", as_barn(worlds.load("generated:7"))), "leads out of")


def test_bad_course_in_the_file(tmp_path):
    text = sdf_writer.text(worlds.load("generated:7"))
    for old, new, word in (
        ("<applr:start>", "<applr:start>nan ", "start"),
        ("<applr:goal>", "<applr:goal>x ", "goal"),
        ("<applr:path>", "<applr:path>1 ", "path"),
    ):
        refused(put(tmp_path, text.replace(old, new), "w.world"), word)


def test_heavy_but_lawful_world_stays_within_time(tmp_path):
    big = "".join(cylinder(20.0 * np.cos(n), 20.0 * np.sin(n), radius=4.0, name="c%d" % n) for n in range(3000))
    started = time.monotonic()
    with contextlib.suppress(worlds.WorldError):
        worlds.load(put(tmp_path, sdf(big), "w.world"))
    assert time.monotonic() - started < 10.0


def test_limits_leave_room_for_barn():
    assert sdf_xml.MAX_BYTES > 10 * 2**20
    assert sdf_xml.MAX_ELEMENTS > 10 * 30_000
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss > 0
