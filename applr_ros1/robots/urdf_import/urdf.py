"""Reader of a URDF or xacro file: tree of joints, poses, and vertices of collision shapes.

description.py derives a robot's wheels, outline and laser from the file.
"""

from __future__ import annotations

import io
import logging
import multiprocessing
import os
import re
import resource
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Set, Tuple

import numpy as np
from defusedxml import ElementTree

from applr_ros1.common.arrays import Array
from applr_ros1.common.errors import ApplrError
from applr_ros1.common.files import plain_xml, read_bytes, reading
from applr_ros1.robots.file_kinds import URDF, kind_of

BASES = ("base_link", "base_footprint")  # usual names of a base frame
# How to get the URDF that a running robot uses
OF_RUNNING_ROBOT = "rosparam get -p /robot_description > robot.urdf"
EXPANSION_S = 30.0  # longest time of the expansion of a xacro file [s]
EXPANSION_BYTES = 2 << 30  # most memory of the expansion of a xacro file
# What to do about a file that its parser does not understand
CHECK = "check_urdf (Debian: liburdfdom-tools) finds the error"
_OPTENV = re.compile(r"\$\(optenv\s+(\w+)")  # a variable that xacro reads if it is set


def _find_packages(path: str) -> None:
    """Make the ROS packages around a file known to xacrodoc, beside ROS_PACKAGE_PATH."""
    import xacrodoc

    # The nearest folder with a manifest is the package of the URDF.
    folders = Path(path).resolve().parents
    package = next((folder for folder in folders if (folder / "package.xml").is_file()), None)
    if package is None:
        return
    # Packages beside this one, or beside its repository
    for parent in (package.parent.parent, package.parent):
        packages = {}
        for manifest in (*parent.glob("*/package.xml"), *parent.glob("*/*/package.xml")):
            with reading(manifest):
                manifest_root = ElementTree.fromstring(read_bytes(manifest))
            package_name = str(manifest_root.findtext("name")).strip()
            packages[package_name] = manifest.parent
        xacrodoc.packages.update_package_cache(packages)


def _expanded(path: str, arguments: Mapping[str, str]) -> Tuple[str, List[str]]:
    """Return the URDF of a xacro file, and the variables that the file reads (_variables).

    A xacro file is a program, which may wait at a pipe or take all memory. Another process runs it,
    within EXPANSION_S and EXPANSION_BYTES.
    """
    with multiprocessing.get_context("fork").Pool(1, _limit_memory) as pool:
        expansion = pool.apply_async(_expand, (path, dict(arguments)))
        try:
            return expansion.get(EXPANSION_S)
        except multiprocessing.TimeoutError:
            problem = f"it has not ended after {EXPANSION_S:g} s"
        except ApplrError as error:
            problem = str(error)
    raise ApplrError(
        f"{path}: xacro fails: {problem}; give arguments as NAME:=VALUE and put packages "
        f"beside this file's package, or give the expanded URDF: {OF_RUNNING_ROBOT}"
    )


def _limit_memory() -> None:
    """Limit the memory that this process may take in addition to what it has."""
    page_count, *_ = Path("/proc/self/statm").read_text().split()
    limit = int(page_count) * resource.getpagesize() + EXPANSION_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))


def _expand(path: str, arguments: Dict[str, str]) -> Tuple[str, List[str]]:
    """Return what `_expanded` returns. Expressions of the file are evaluated as Python."""
    import xacro

    try:
        urdf_text = str(xacro.process_file(path, mappings=arguments).toxml())
    except Exception as error:  # An expression may raise any exception.
        raise ApplrError(" ".join(str(error).split())) from None
    return urdf_text, _variables(path)


def _variables(path: str) -> List[str]:
    """Return the optional environment variables of the last expanded xacro file, with values."""
    import xacro

    names = set()
    for xacro_file in (path, *filter(os.path.isfile, xacro.all_includes)):
        names.update(_OPTENV.findall(read_bytes(xacro_file).decode("utf-8", "replace")))
    return [f"{name} (now {os.environ.get(name, 'not set')})" for name in sorted(names)]


class UrdfFile:
    """One URDF with the poses of its links in the base frame.

    Attributes:
        path: Path of the file.
        xml: Root element of the file.
        base: Link of the base frame.
        links: yourdfpy's links by name.
        joints: yourdfpy's joints by name.
        moving: For each link, the movable joints between it and the base frame, nearest to the link
            first.
        lost: Missing collision meshes.
        variables: Environment variables that the xacro file reads if they are set, with their
            values in brackets.
    """

    def __init__(self, path: str, arguments: Mapping[str, str], base_frame: str) -> None:
        """Read a file.

        Args:
            path: URDF, or xacro file with a name that ends in .xacro.
            arguments: Arguments of the xacro file by name.
            base_frame: Base frame of the robot.

        Raises:
            ApplrError: The file is no valid URDF, has no links, or several that no joint connects,
                xacro fails, or there is no link base_frame.
        """
        import yourdfpy

        self.path = path
        self.lost: Set[str] = set()
        self.variables: List[str] = []
        content = read_bytes(path)
        kind = kind_of(content)
        if kind != URDF and b"<robot" not in content:
            remedy = "give the URDF or xacro file of the whole robot"
            raise ApplrError(f"{path} is {kind or 'no URDF'}: {remedy}")
        _find_packages(path)
        is_xacro = path.endswith(".xacro")
        if is_xacro:
            urdf_text, self.variables = _expanded(path, arguments)
        else:
            urdf_text = plain_xml(content)
        with reading(path, CHECK):
            self.xml = ElementTree.fromstring(urdf_text)
        if not is_xacro:
            for element in self.xml.iter():
                if "xacro}" in element.tag or "${" in str(element.attrib):
                    remedy = "rename it so that its name ends in .xacro"
                    raise ApplrError(f"{path} has xacro tags: {remedy}")
        if self.xml.find("link") is None:
            remedy = "give a URDF, or if it only defines macros, the file that uses them"
            raise ApplrError(f"{path} has no links: {remedy}")
        # yourdfpy also reads what nothing here needs: colours, which may be out of its range.
        for link in self.xml.findall("link"):
            for visual in link.findall("visual"):
                link.remove(visual)
        # yourdfpy warns about joints that mimic others.
        logging.getLogger("yourdfpy").setLevel(logging.ERROR)
        with reading(path, CHECK):
            xml_file = io.BytesIO(ElementTree.tostring(self.xml))
            self._urdf = yourdfpy.URDF.load(xml_file, load_meshes=False)
            self.links = self._urdf.link_map
            if len(self.links) < len(self._urdf.robot.links):
                raise ValueError("two links have one name")
        self.joints = self._urdf.joint_map
        # A link has one parent.
        self._joint_to = {joint.child: joint for joint in self.joints.values()}
        self.base = base_frame
        if base_frame not in self.links:
            usual_names = [name for name in BASES if name in self.links]
            advised_name = usual_names[0] if usual_names else self._urdf.base_link
            raise ApplrError(
                f"{path} has no link {base_frame}, the robot_base_frame of the parameter files: "
                "add it to the URDF with a fixed joint, or set robot_base_frame: "
                f"{advised_name} in a copy of the parameter file"
            )
        self._check_connected()
        # Joints above the base frame move the robot as a whole.
        above_base = {joint.name for joint in self._above(base_frame)}
        self.moving: Dict[str, List[Any]] = {}
        for link_name in self.links:
            self.moving[link_name] = []
            for joint in self._above(link_name):
                if joint.type != "fixed" and joint.name not in above_base:
                    self.moving[link_name].append(joint)

    def _check_connected(self) -> None:
        """Raise ApplrError if joints do not connect all links to the base frame."""
        root = self._root(self.base)
        loose_links = [link for link in self.links if self._root(link) != root]
        if not loose_links:
            return
        problem = f"no joint connects {', '.join(loose_links)} to {self.base}"
        remedy = "correct the joints in a copy of the file"
        if self.path.endswith(".xacro"):
            remedy = "give arguments as NAME:=VALUE, as the robot's launch file does"
        if self.variables:
            remedy = f"set the environment variable {' or '.join(self.variables)} as on the robot"
        if self.path.endswith(".xacro"):
            remedy += f", or give the URDF of the running robot: {OF_RUNNING_ROBOT}"
        raise ApplrError(f"{self.path}: {problem}: {remedy}")

    def _root(self, link: str) -> str:
        """Return the link at the upper end of the joints above a link."""
        for joint in self._above(link):
            link = joint.parent
        return link

    def _above(self, link: str) -> Iterator[Any]:
        """Yield the joints from a link to the root, at most all of them: a ring has no root."""
        for _ in self.joints:
            if link not in self._joint_to:
                break
            yield self._joint_to[link]
            link = self._joint_to[link].parent

    def pose(self, link: str) -> Array:
        """Return the pose (4, 4) of a link in the base frame."""
        return np.asarray(self._urdf.get_transform(link, self.base))

    def axis(self, joint: Any) -> Array:
        """Return the direction (3,) of a joint's axis in the base frame."""
        rotation = self.pose(joint.child)[:3, :3]
        direction: Array = rotation @ np.asarray(joint.axis, dtype=float)
        return direction

    def parts(self, joint: Any) -> List[str]:
        """Return the links that turn with a joint and do not move relative to its child."""
        return [link_name for link_name, joints in self.moving.items() if joints[:1] == [joint]]

    def mass(self, links: Iterable[str]) -> float:
        """Return the sum of the masses of some links [kg]. A link without inertia has none."""
        inertias = [self.links[link_name].inertial for link_name in links]
        return float(sum(inertia.mass or 0.0 for inertia in inertias if inertia is not None))

    def shapes(self, link: str) -> List[Array]:
        """Return the vertices (n, 3) [m] of each collision shape of a link in the base frame.

        Missing meshes are left out.
        """
        shapes = []
        for collision in self.links[link].collisions:
            vertices = self._vertices(collision.geometry)
            shape_pose = self.pose(link)
            if collision.origin is not None:
                shape_pose = shape_pose @ collision.origin
            if len(vertices):
                rotation = shape_pose[:3, :3]
                position = shape_pose[:3, 3]
                shapes.append(vertices @ rotation.T + position)
        return shapes

    def _vertices(self, shape: Any) -> Any:
        """Return the vertices (n, 3) [m] of a shape in its frame.

        A missing mesh has none and is added to `lost`.
        """
        import trimesh

        if shape.box is not None:
            return trimesh.creation.box(shape.box.size).vertices
        if shape.cylinder is not None:
            return trimesh.creation.cylinder(shape.cylinder.radius, shape.cylinder.length).vertices
        if shape.sphere is not None:
            return trimesh.creation.icosphere(radius=shape.sphere.radius).vertices
        mesh_file = self._mesh_file(shape.mesh.filename)
        if not os.path.isfile(mesh_file):
            self.lost.add(shape.mesh.filename)
            return np.zeros((0, 3))
        with reading(mesh_file):
            mesh: Any = trimesh.load(mesh_file, force="mesh", skip_materials=True)
            vertices = mesh.vertices
        # RViz and Gazebo read Collada files in the file's own unit.
        if mesh.units:
            vertices = vertices * trimesh.units.unit_conversion(mesh.units, "meters")
        if shape.mesh.scale is not None:
            vertices = vertices * shape.mesh.scale
        return vertices

    def _mesh_file(self, name: str) -> str:
        """Return the path of a mesh, or "" if its package is missing."""
        import xacrodoc

        package_name, _, inner_path = name.partition("package://")[2].partition("/")
        # Without package://, the path is relative to the URDF.
        if not package_name:
            return os.path.join(os.path.dirname(self.path), name.replace("file://", "", 1))
        try:
            return os.path.join(xacrodoc.packages.get_path(package_name), inner_path)
        except xacrodoc.packages.PackageNotFoundError:
            return ""
