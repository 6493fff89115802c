"""Gazebo world files made in the tests: no file of anybody else's is in this repo. tests/test_worlds_*.py use it."""

import os

import numpy as np

CYLINDER = (
    "<model name='{name}'><static>1</static><pose frame=''>{pose}</pose><link name='link'>"
    "<collision name='collision'><geometry><cylinder><radius>{radius}</radius><length>1</length></cylinder>"
    "</geometry></collision></link></model>"
)
GROUND = (
    "<model name='ground_plane'><static>1</static><link name='link'><collision name='c'><geometry><plane>"
    "<normal>0 0 1</normal><size>100 100</size></plane></geometry></collision></link></model>"
)


def sdf(body):
    return "<sdf version='1.6'><world name='default'><light name='sun' type='directional'/>%s%s</world></sdf>" % (
        GROUND,
        body,
    )


def cylinder(x, y, radius=0.075, name="unit_cylinder_0", z=0.0):
    return CYLINDER.format(name=name, pose="%f %f %f 0.000000 0.000000 0.000000" % (x, y, z), radius=radius)


def moving(name, x=0.0, y=0.0, filename=None):
    """A cylinder of .5 m with a Gazebo plugin, as DynaBARN's; `filename` of the plugin, by default its name and .so."""
    return cylinder(x, y, radius=0.5, name=name).replace(
        "</model>", "<plugin name='%s' filename='%s'/></model>" % (name, filename or name + ".so")
    )


def as_barn(world):
    """The text of a BARN-style file for a world of cylinders: models, then the same poses in a saved state."""
    xy = world.cylinders[:, :2]
    models = "".join(cylinder(x, y, name="unit_cylinder_%d" % n) for n, (x, y) in enumerate(xy))
    states = "".join(
        "<model name='unit_cylinder_{0}'><pose frame=''>{1:f} {2:f} 0 0 0 0</pose><scale>1 1 1</scale>"
        "<link name='link'><pose frame=''>{1:f} {2:f} 0 0 0 0</pose></link></model>".format(n, x, y)
        for n, (x, y) in enumerate(xy)
    )
    return sdf(models + "<state world_name='default'>%s</state>" % states)


def put(folder, text, name="world_7.world", cells=None):
    """Writes a world file, and a path file beside it when cells are given. Returns the file's path."""
    path = os.path.join(str(folder), name)
    with open(path, "wb" if isinstance(text, bytes) else "w") as file:
        file.write(text)
    if cells is not None:
        os.makedirs(os.path.join(str(folder), "path_files"), exist_ok=True)
        np.save(os.path.join(str(folder), "path_files", "path_7.npy"), cells, allow_pickle=True)
    return path
