"""World files that are missing, malformed, hostile or without a passage: one line each, in bounded time and memory."""

import os
import pickle

import numpy as np
import pytest

import worlds
from tests.support.refusals import refused as refused_call
from tests.support.worlds_sdf import as_barn, box, cylinder, put, sdf
from tests.support.worlds_sdf import refused_world as refused
from worlds import barn, sdf_writer

EXTERNAL = (
    "<!DOCTYPE sdf [<!ENTITY x SYSTEM 'file:///etc/passwd'>]><sdf><world name='w'><model name='&x;'/></world></sdf>"
)


WALLS = (0, 0.45, 1, 0.1), (0, -0.45, 1, 0.1), (0.45, 0, 0.1, 1), (-0.45, 0, 0.1, 1)
SHED = "".join(box(f"w{n}", x, y, 0.5, *size, 1) for n, (x, y, *size) in enumerate(WALLS))


@pytest.mark.fault("22")
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ["not well-formed"]),
        ("<html></html>", ["no <world>"]),
        (EXTERNAL, ["DOCTYPE"]),
        (sdf(""), ["no obstacle"]),
        (sdf(cylinder(float("nan"), 0)), ["unit_cylinder_0", "nan", "finite"]),
        (sdf(cylinder(0, 0, radius=-1)), ["radius", "above 0"]),
        (sdf(cylinder(0, 0).replace("0.000000</pose>", "</pose>")), ["pose", "6 numbers"]),
        (sdf(cylinder(0, 0) + cylinder(900, 900)), ["too large"]),
        (sdf(SHED), ["ends 0.10 m from its start", "--course X Y X Y"]),
    ],
)
def test_bad_files(tmp_path, text, words):
    refused(put(tmp_path, text, "w.world"), *words)


@pytest.mark.fault("22")
def test_deep_and_endless_files(tmp_path, monkeypatch):
    for tag in ("model", "a"):
        deep = f"<{tag} name='m'>" * 1500 + f"</{tag}>" * 1500
        for text in (deep, f"<state>{deep}</state>", f"<state><model name='m'>{deep}</model></state>"):
            refused(put(tmp_path, sdf(text + cylinder(0, 0)), "w.world"), "100 levels")
    monkeypatch.setattr("worlds.sdf.MAX_TAGS", 1000)
    refused(put(tmp_path, sdf("<a/>" * 1000), "w.world"), "1000 tags")


def test_missing_folder_and_device(tmp_path):
    refused(tmp_path / "missing.world", "missing.world", "give an existing file")
    (tmp_path / "folder.world").mkdir()
    refused(tmp_path / "folder.world", "a folder, pipe or device")
    os.mkfifo(str(tmp_path / "pipe.world"))
    refused(tmp_path / "pipe.world", "a folder, pipe or device")
    (tmp_path / "empty").mkdir()
    refused_call(lambda: worlds.load_all(str(tmp_path / "empty")), "0 .world files")


@pytest.mark.fault("22")
def test_a_hundred_thousand_cylinders(tmp_path):
    refused(put(tmp_path, sdf("".join(cylinder(n, 0) for n in range(100_000))), "w.world"), "bytes")
    disc = "<collision name='c'><geometry><sphere><radius>.1</radius></sphere></geometry></collision>"
    many = sdf("<model name='m'><link name='l'>%s</link></model>" % (disc * 20_000))
    refused(put(tmp_path, many, "w.world"), "10000 obstacles")


def test_sealed_worlds_have_no_passage(tmp_path):
    world = worlds.load("generated:7")
    _, path = barn.fields()[7]
    row = "".join(cylinder(-4.425 + 0.15 * r, 7.425, name="seal_%d" % r) for r in range(30))
    sealed = as_barn(world).replace("</world>", row + "</world>")
    refused(put(tmp_path, sealed), "no passage")
    refused(put(tmp_path, sealed, cells=path), "no passage")
    refused(put(tmp_path, sdf(box("w", 0, 2, 0.5, 8, 0.3, 1)), "wall.world"), "no passage")


class Evil:
    def __reduce__(self):
        return os.system, ("touch evil-was-here",)


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        (np.array([Evil(), Evil()], dtype=object), ["Object arrays"]),
        (np.array([[1.0, 2.0], [3.0, 4.0]]), ["float64"]),
        (np.zeros((3, 3), dtype=int), ["shape"]),
        (np.array([[5, 0], [5, 40]]), ["outside"]),
        (np.array([[5, 0], [9, 9]]), ["not neighbours"]),
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
        b"x" * (2**20 + 1),
        pickle.dumps(Evil()),
        npy("{'descr': '<i8', 'fortran_order': False, 'shape': (9000, 2), }", b"\0" * 16),
        npy("{'descr': '<i8', 'fortran_order': False, 'shape': (99999999999999, 2), }"),
    ],
)
def test_malformed_path_files(tmp_path, content):
    path = put(tmp_path, as_barn(worlds.load("generated:7")), cells=np.zeros((2, 2), dtype=int))
    (tmp_path / "path_files" / "path_7.npy").write_bytes(content)
    refused(path, "path_7.npy")


def test_bad_course_in_the_file(tmp_path):
    text = sdf_writer.text(worlds.load("generated:7"))
    for old, new, word in (
        ("<applr:start>", "<applr:start>nan ", "start"),
        ("<applr:goal>", "<applr:goal>x ", "goal"),
        ("<applr:path>", "<applr:path>1 ", "path"),
    ):
        refused(put(tmp_path, text.replace(old, new), "w.world"), word)
