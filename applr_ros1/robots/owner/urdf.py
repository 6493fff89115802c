"""Reads a URDF or xacro file as it stands: links, joints, boxes around shapes, masses. links.py says what they are."""

from __future__ import annotations

import contextlib
import io
import logging
import os
import re
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Set, Tuple
from xml.etree.ElementTree import Element

import numpy as np
from defusedxml import ElementTree

from applr_ros1.common.errors import ApplrError, reason
from applr_ros1.common.files import plain_xml, read_bytes
from applr_ros1.robots.owner.expand import expand

LASER = re.compile(r"laser|lidar|scan|hokuyo|sick", re.IGNORECASE)
MAX_DEPTH = 100  # levels of tags, joints from a link to the root, and files that a xacro file includes
MAX_LINKS = 2000
MANIFESTS = ("package.xml", "manifest.xml")  # of a package; the latter's name is its folder's
MESHES = ("stl", "dae", "obj")  # what RViz and Gazebo read; of others, archives among them, nothing bounds the size
JOINTS = ("continuous", "revolute", "prismatic", "fixed", "floating", "planar")
NUMBERS = {"xyz": 3, "rpy": 3, "size": 3, "radius": 1, "length": 1, "value": 1}  # how many an attribute has
NUMBERS.update(dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1))
Box = np.ndarray  # (2, 3): lowest and highest x, y, z in the base frame [m]


class Packages:
    """Folders of ROS packages by name: those around a file, then those in ROS_PACKAGE_PATH."""

    def __init__(self, path: Path):
        folder = Path(os.path.realpath(path)).parent  # resolve() raises for links in a circle
        above = [folder, *folder.parents]
        own = next((folder for folder in above if any((folder / name).is_file() for name in MANIFESTS)), above[0])
        roots = [own, own.parent, own.parent.parent]
        roots += [Path(folder) for folder in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if folder]
        self.missing: Set[str] = set()
        self.found: Dict[str, str] = {}
        places = ["*/" * depth + kind for kind in MANIFESTS for depth in range(3)]
        for file in (file for root in roots for place in places for file in root.glob(place)):
            with contextlib.suppress(ElementTree.ParseError, ValueError):  # also of a file with entities, or a pipe
                name = (ElementTree.fromstring(read_bytes(file)).findtext("name") or file.parent.name).strip()
                self.found.setdefault(name, str(file.parent))

    def folder(self, name: str) -> str:
        """The folder of a package; where there is none, one that is not there."""
        if name not in self.found:
            self.missing.add(name)
        return self.found.get(name, f"/there is no package {name}")


def _text(path: str, arguments: Mapping[str, str], packages: Packages) -> str:
    """The URDF in a file, which xacro has gone over where it is for xacro."""
    text = plain_xml(read_bytes(path))
    if "xacro" not in text and "${" not in text:
        return text
    text, problem, packages.missing = expand(path, arguments, packages.found)
    if problem:
        needed = re.search(r"Undefined substitution argument (\S+)|environment variable '(\w+)' is not set", problem)
        if needed and needed[2]:
            raise ApplrError(f"{path} reads {needed[2]} from the environment: export it as on the robot")
        if needed:
            raise ApplrError(f"{path} needs the argument {needed[1]}: give {needed[1]}:=VALUE")
        absent = ", ".join(sorted(packages.missing))
        there = f"; put {absent} beside its package, or source the workspace that has them" if absent else ""
        texts = _with_included(path, arguments, packages)
        found = {file: old for file, text in texts.items() if (old := re.search(r"<(include|property|macro)\b", text))}
        for file, old in list(found.items())[:1]:
            whose = "it" if file == path else file
            there += f"; {whose} has <{old[1]}>, and since Noetic xacro takes its tags with xacro: alone"
        raise ApplrError(f"{path}: xacro refuses it: {problem}{there}")
    return text


def _check_tree(path: str, root: Element) -> None:
    """Refuses tags nested too deep, joints that lead in a circle, and links that hang on nothing."""
    depth, level = 0, [root]
    while level and depth <= MAX_DEPTH:
        depth, level = depth + 1, [child for element in level for child in element]
    if level:
        raise ApplrError(f"{path} has over {MAX_DEPTH} levels of tags; a URDF has six")
    if len(root.findall("link")) + len(root.findall("joint")) > 2 * MAX_LINKS:
        raise ApplrError(f"{path} has over {MAX_LINKS} links: give the URDF of one robot")
    ends = [
        [end.get("link") for tag in ("child", "parent") for end in j.findall(tag)[:1]] for j in root.findall("joint")
    ]
    above = {pair[0]: pair[1] for pair in ends if len(pair) == 2}
    below = [pair[0] for pair in ends if len(pair) == 2]
    if len(below) > len(above):
        twice = next(link for link in below if below.count(link) > 1)
        raise ApplrError(f"{path}: more than one joint leads to the link {twice}: take all but one of them out")
    for link in above:
        at, steps = link, 0
        while at in above:
            at, steps = above[at], steps + 1
            if steps > MAX_DEPTH:
                what = f"lead back to it, or are over {MAX_DEPTH}; take one of them out"
                raise ApplrError(f"{path}: the joints above the link {at} {what}")
    links = [link.get("name") for link in root.findall("link")]
    absent = sorted({str(end) for pair in ends for end in pair if end not in links})
    if absent:
        raise ApplrError(f"{path}: joints name {', '.join(absent)}, which is no link there; take each such joint out")
    roots = [link for link in links if link not in above]
    if len(roots) > 1:  # robot_state_publisher refuses it, too
        others = ", ".join(map(str, roots[1:]))[:200]
        raise ApplrError(f"{path}: no joint leads to {others}, nor to {roots[0]!s:.60}: a robot has one root")


def _with_included(path: str, arguments: Mapping[str, str], packages: Packages) -> Dict[str, str]:
    """Return the texts of a xacro file and of those that it includes, by file, as far as they are there."""
    texts: Dict[str, str] = {}
    defaults: Dict[str, str] = {}
    files = [path]
    for file in files:
        with contextlib.suppress(ApplrError, OSError, UnicodeDecodeError):
            texts[file] = plain_xml(read_bytes(file))
            defaults.update(re.findall(r"<xacro:arg\s+name=[\"'](\w+)[\"']\s+default=[\"']([^\"']*)", texts[file]))
            for name in re.findall(r"<xacro:include\b[^<>]*?\bfilename\s*=\s*[\"']([^\"']+)", texts[file]):
                name = re.sub(
                    r"\$\(arg\s+(\w+)\)", lambda match: arguments.get(match[1], defaults.get(match[1], "")), name
                )
                name = re.sub(r"\$\(find\s+([\w-]+)\)", lambda match: packages.folder(match[1]), name)
                name = os.path.normpath(os.path.join(os.path.dirname(file), name))
                files += [name] * (len(files) < MAX_DEPTH and name not in files)
    return texts


def _choices(path: str, arguments: Mapping[str, str], packages: Packages) -> str:
    """Return what to say where a part may be switched off: arguments and environment variables that a xacro file reads.

    Files that it includes are looked through, too, as far as they are there. Named are those that decide on a laser,
    else those that have to do with one, else all.
    """
    texts = _with_included(path, arguments, packages)
    found = []
    for words, pattern, form in (
        ("the file takes", r"<xacro:arg\b[^<>]*?\bname\s*=\s*[\"'](\w+)", "{}:="),
        ("it reads", r"\$\(\s*(?:opt)?env\s+(\w+)", "{}"),
    ):
        names = sorted({name for text in texts.values() for name in re.findall(pattern, text)})
        deciding = {
            name for text in texts.values() for name in re.findall(r"<xacro:(?:if|unless)\b[^<>]*" + pattern, text)
        }
        names = [name for name in names if LASER.search(name)] or names
        names = [name for name in names if name in deciding] or names
        end = " from the environment" if words == "it reads" else ""
        found += [f"; {words} {', '.join(map(form.format, names))}{end}"] * bool(names)
    return "".join(found)


def _bare(text: str, path: str) -> bytes:
    """A URDF without all that says nothing of links and joints, so that a mistake in it stops nothing.

    ApplrError, with the place, for a number or a kind of joint that is none.
    """
    xml = ElementTree.fromstring(text)
    for part in [part for part in xml if part.tag not in ("link", "joint")]:
        xml.remove(part)
    for part in xml:
        kept = ("origin", "parent", "child", "axis", "limit", "mimic", "inertial", "visual", "collision")
        for inner in [inner for inner in part if inner.tag not in kept]:
            part.remove(inner)
        place = f"{path} cannot be read as URDF: {part.tag} {part.get('name')}"
        if part.tag == "joint" and part.get("type") not in JOINTS:
            raise ApplrError(f"{place} has the type {part.get('type')}: give {', '.join(JOINTS)}")
        for name, given in (item for element in part.iter() for item in element.items() if item[0] in NUMBERS):
            words, many = given.split(), NUMBERS[name]
            if len(words) != many or not all(re.fullmatch(r"[-+.\deE]{1,60}", word) for word in words):
                raise ApplrError(f"{place} has {name} {given!r:.60}: give {many} finite number{'s' * (many > 1)}")
        for axis in part.findall("axis"):
            if not any(float(number) for number in (axis.get("xyz") or "1").split()):
                part.remove(axis)  # (0, 0, 0), which says nothing
        for material in [(shape, inner) for shape in part for inner in shape.findall("material")]:
            material[0].remove(material[1])
    return ElementTree.tostring(xml)


class UrdfFile:
    """One URDF: its tree of joints, and boxes around its shapes and masses of its links in the base frame.

    Attributes:
        xml: Its root. links, joints: Of yourdfpy, by name and in order. base: The link in which positions are given.
        moving: By link, the joints that move it, the nearest first. lost: Meshes that are not there.
        choices: What to say where a part may be switched off: the arguments that the file takes.
    """

    def __init__(self, path: str, arguments: Mapping[str, str], base_frame: str = ""):
        try:
            import xacro  # noqa: F401  (expand.py's process needs it)
            import yourdfpy
        except ModuleNotFoundError as missing:
            raise ApplrError(
                f"Python's {missing.name} is not installed: run ./applr robot, or "
                "pip install --no-deps -r requirements/urdf.txt"
            ) from None
        self.path, self.packages = path, Packages(Path(path))
        self.lost: Set[str] = set()  # meshes that are not there
        self._meshes: Dict[str, np.ndarray] = {}  # corners (n, 3) [m] of files that were read
        self._poses: Dict[str, np.ndarray] = {}
        text = _text(path, arguments, self.packages)
        self.choices = _choices(path, arguments, self.packages)
        try:
            self.xml = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError) as error:
            raise ApplrError(f"{path} is no XML ({reason(error)}): give a URDF or xacro file") from None
        if self.xml.tag != "robot":
            raise ApplrError(
                f"{path}: its outermost tag is <{self.xml.tag}>: give a URDF or xacro file, whose is <robot>"
            )
        _check_tree(path, self.xml)
        if self.xml.find("link") is None:
            beside = ("joint", "gazebo", "material", "transmission")
            other = next((f"; or is <{part.tag}> a macro" for part in self.xml if part.tag not in beside), "")
            other += ", which since Noetic is called with xacro: before its name?" * bool(other)
            raise ApplrError(f"{path} has no links, as files of macros alone: give the file that uses them{other}")
        logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)
        try:
            self.urdf = yourdfpy.URDF.load(io.BytesIO(_bare(text, path)), load_meshes=False)
        except ApplrError:
            raise
        except Exception as error:  # the library says of a missing tag that None has no attribute
            problem = f"{type(error).__name__}: {reason(error)}; ask check_urdf for the place"
            raise ApplrError(f"{path} cannot be read as URDF: {problem}") from None
        self.links, self.joints = self.urdf.link_map, self.urdf.robot.joints
        self.joint_to = {joint.child: joint for joint in self.joints}
        usual = [name for name in ("base_link", "base_footprint") if name in self.links]
        self.base = self.link(base_frame) or (usual or [self.urdf.base_link])[0]
        self.moving = {name: [j for j in self.above(name) if j.type != "fixed"] for name in self.links}

    def link(self, frame: str) -> str:
        """The link of a frame, which may have a prefix in tf; "" where there is none."""
        return next((name for name in (frame, frame.rpartition("/")[2]) if name in self.links), "")

    def above(self, link: str) -> Iterator[Any]:
        """The joints from a link to the root."""
        while link in self.joint_to:
            yield self.joint_to[link]
            link = self.joint_to[link].parent

    def pose(self, link: str) -> np.ndarray:
        """(4, 4) of a link in the base frame."""
        if link not in self._poses:
            self._poses[link] = self.urdf.get_transform(link, self.base)
        return self._poses[link]

    def axis(self, joint: Any) -> np.ndarray:
        """(3,) the direction of a joint's axis in the base frame."""
        direction = self.pose(joint.child)[:3, :3] @ np.asarray(joint.axis, dtype=float)
        return direction / (np.linalg.norm(direction) or 1.0)

    def boxes(self, names: Iterable[str], kind: str = "collisions", axes: Any = np.eye(3)) -> List[Box]:  # noqa: B008
        """The ends along axes (n, 3) of each shape of some links that can be read. kind: collisions or visuals."""
        shapes = [(name, shape) for name in names for shape in getattr(self.links[name], kind)]
        found = [self._box(name, shape, axes) for name, shape in shapes if shape.geometry is not None]
        return [box for box in found if box is not None]

    def _box(self, link: str, shape: Any, axes: np.ndarray) -> Optional[Box]:
        geometry = shape.geometry
        pose = self.pose(link) @ (np.eye(4) if shape.origin is None else shape.origin)
        turn, middle = axes @ pose[:3, :3], axes @ pose[:3, 3]
        if geometry.box is not None:
            half = np.abs(turn) @ (np.asarray(geometry.box.size) / 2)
        elif geometry.sphere is not None:
            half = np.full(len(axes), geometry.sphere.radius)
        elif geometry.cylinder is not None:
            along = np.abs(turn[:, 2])
            half = geometry.cylinder.length / 2 * along
            half = half + geometry.cylinder.radius * np.sqrt(np.maximum(1 - along**2, 0))
        elif geometry.mesh is None:
            return None
        else:
            corners = self._mesh(geometry.mesh)
            return None if corners is None else around([corners @ turn.T + middle])
        return np.array([middle - half, middle + half])

    def _mesh(self, mesh: Any) -> Optional[np.ndarray]:
        """(n, 3) the corners of a mesh, scaled [m]; None, and noted, where it cannot be read."""
        if mesh.filename not in self._meshes:
            try:
                self._meshes[mesh.filename] = self._corners(mesh.filename)
            except Exception:  # of the readers of a dozen formats
                self._meshes[mesh.filename] = np.empty((0, 3))
        corners = self._meshes[mesh.filename]
        if not len(corners):
            self.lost.add(mesh.filename or "one without a filename")
            return None
        return corners * (1.0 if mesh.scale is None else np.asarray(mesh.scale))

    def _corners(self, name: str) -> np.ndarray:
        import trimesh

        package, _, inside = name.partition("package://")[2].partition("/")
        if package:
            file = os.path.join(self.packages.folder(package), inside)
        else:
            file = os.path.join(os.path.dirname(self.path), re.sub("^file://", "", name))
        kind = os.path.splitext(file)[1][1:].lower()
        content = read_bytes(file) if kind in MESHES else b""
        loaded: Any = trimesh.load(io.BytesIO(content), file_type=kind, force="mesh", skip_materials=True)
        corners = np.asarray(loaded.vertices)
        if kind == "dae":  # which RViz and Gazebo read in its own unit
            corners = corners * trimesh.units.unit_conversion(loaded.units or "meters", "meters")
        return corners

    def inertia(self, names: Iterable[str]) -> Tuple[float, np.ndarray, np.ndarray]:
        """Mass, (3,) centre of mass, and (3,) moments about x, y, z through it, of some links together."""
        parts = []
        for name in names:
            inertial = self.links[name].inertial
            if inertial is not None and inertial.mass:
                pose = self.pose(name) @ (np.eye(4) if inertial.origin is None else inertial.origin)
                own = np.zeros((3, 3)) if inertial.inertia is None else inertial.inertia
                parts.append((inertial.mass, pose[:3, 3], np.diag(pose[:3, :3] @ own @ pose[:3, :3].T)))
        mass = sum(part[0] for part in parts)
        if not mass:
            return 0.0, np.zeros(3), np.zeros(3)
        centre = sum(m * place for m, place, _ in parts) / mass
        arms = [(m, (place - centre) ** 2, own) for m, place, own in parts]
        return float(mass), centre, sum(own + m * (arm.sum() - arm) for m, arm, own in arms)


def around(boxes: List[np.ndarray]) -> Box:
    """The box around points, (n, 3) each."""
    points = np.concatenate(boxes)
    return np.array([points.min(axis=0), points.max(axis=0)])
