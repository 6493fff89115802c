"""Synthetic Gazebo world files for tests, because the repository has none of BARN's or DynaBARN's files."""

import os

import numpy as np

import worlds
from tests.support.refusals import refused


def refused_world(path, *words):
    """Return the one-line error about a world file."""
    return refused(lambda: worlds.load(str(path)), *words)


def model(name, pose, shape):
    """Return a model of one shape; `pose` is six numbers as text. The attribute `frame` is as in DynaBARN's files."""
    return (
        f"<model name='{name}'><static>1</static><pose frame=>{pose}</pose><link name='link'><collision name='c'>"
        f"<geometry>{shape}</geometry></collision></link></model>"
    )


def box(name, x, y, z, *size, yaw=0):
    """Return a box (size along x, y, z) centred at (x, y, z)."""
    return model(name, f"{x} {y} {z} 0 0 {yaw}", "<box><size>%s %s %s</size></box>" % size)


COURSE = """<applr:course xmlns:applr='applr'><applr:start>0 -9 1.57</applr:start><applr:goal>0 9 1.57</applr:goal>
<applr:goal_tolerance>0.4</applr:goal_tolerance><applr:path>0 -9 0 9</applr:path></applr:course>"""


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
    """Return a cylinder of radius .5 m with the Gazebo plugin `filename`, by default NAME.so, as in DynaBARN."""
    return cylinder(x, y, radius=0.5, name=name).replace(
        "</model>", "<plugin name='%s' filename='%s'/></model>" % (name, filename or name + ".so")
    )


def as_barn(world):
    """Return the text of a BARN-style file for a world of cylinders: models, then their poses as a saved state."""
    xy = world.cylinders[:, :2]
    models = "".join(cylinder(x, y, name="unit_cylinder_%d" % n) for n, (x, y) in enumerate(xy))
    states = "".join(
        "<model name='unit_cylinder_{0}'><pose frame=''>{1:f} {2:f} 0 0 0 0</pose><scale>1 1 1</scale>"
        "<link name='link'><pose frame=''>{1:f} {2:f} 0 0 0 0</pose></link></model>".format(n, x, y)
        for n, (x, y) in enumerate(xy)
    )
    return sdf(models + "<state world_name='default'>%s</state>" % states, "")


def put(folder, text, name="world_7.world", cells=None):
    """Write a world file, and a path file beside it if cells are given. Return the path of the world file."""
    path = os.path.join(str(folder), name)
    with open(path, "wb" if isinstance(text, bytes) else "w") as file:
        file.write(text)
    if cells is not None:
        os.makedirs(os.path.join(str(folder), "path_files"), exist_ok=True)
        np.save(os.path.join(str(folder), "path_files", "path_7.npy"), cells, allow_pickle=True)
    return path
