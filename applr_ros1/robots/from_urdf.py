"""Reads what a robot's URDF or xacro file says of it, as the sections of robot.yaml name it: `read`.

training/new_robot.py writes the folder of a robot from it; urdf.py goes the other way, for RViz.
"""

from __future__ import annotations

import contextlib
import io
import logging
import os
import re
import sys
import types
from dataclasses import dataclass, field
from math import atan2, hypot
from pathlib import Path
from typing import Any, Dict, Iterable, Iterator, List, Mapping, Optional, Set, Tuple

import numpy as np
from defusedxml import ElementTree

from applr_ros1.common.errors import ApplrError, reason

_OMNI = re.compile(r"mecanum|omni_?wheel|planar_move|force_based_move", re.IGNORECASE)
_LASER = re.compile(r"laser|lidar|scan|hokuyo|sick", re.IGNORECASE)
_RAYS = ("ray", "gpu_ray", "lidar", "gpu_lidar")
_OURS = "the planners and simulators here are for four wheels on two axles (skid steer) and for two on one axle"
_SIDEWAYS = " is of an omni base, which also drives sideways"
Box = np.ndarray  # (2, 3): lowest and highest x, y, z in the base frame [m]


@dataclass
class Description:
    """What a URDF says. values: by section and field of robot.yaml; what it does not say is not there.

    notes: sentences about what was left out or looks odd.
    """

    values: Dict[str, Dict[str, Any]] = field(default_factory=dict)
    notes: List[str] = field(default_factory=list)


def read_urdf(path: str, arguments: Mapping[str, str], base_frame: str = "", laser_frame: str = "") -> Description:
    """The description of the robot in a URDF or xacro file.

    Args:
        path: The file. Packages that it names are looked for around it and in ROS_PACKAGE_PATH.
        arguments: Of the xacro file, by name.
        base_frame: Link in which places are given; "": base_link, else base_footprint, else the root of the tree.
        laser_frame: Link that is the scanner's; "": the one that a sensor of Gazebo or a link's name says.

    Raises:
        ApplrError: The file is no URDF, or describes no base with two driven wheels or with four on two axles.
    """
    return _Reader(path, arguments, base_frame).description(laser_frame)


class _Packages:
    """Folders of ROS packages by name: those around a file, then those in ROS_PACKAGE_PATH."""

    def __init__(self, path: Path):
        above = path.resolve().parents
        own = next((folder for folder in above if (folder / "package.xml").is_file()), above[0])
        roots = [own, own.parent, own.parent.parent]
        roots += [Path(folder) for folder in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if folder]
        self.missing: Set[str] = set()
        self._found: Dict[str, str] = {}
        for file in (file for root in roots for depth in range(3) for file in root.glob("*/" * depth + "package.xml")):
            with contextlib.suppress(ElementTree.ParseError, OSError):
                name = (ElementTree.parse(file).findtext("name") or "").strip()
                self._found.setdefault(name, str(file.parent))

    def folder(self, name: str) -> str:
        """The folder of a package; where there is none, a pattern that no file matches.

        xacro passes over an include whose pattern matches nothing, so that a robot needs not have the packages of all
        sensors that its file could add.
        """
        if name not in self._found:
            self.missing.add(name)
        return self._found.get(name, f"/there is no package [{name}]")


def _text(path: str, arguments: Mapping[str, str], packages: _Packages) -> str:
    """The URDF in a file, which xacro has gone over where it is for xacro."""
    import xacro

    try:
        text = Path(path).read_text(encoding="utf-8")
    except UnicodeDecodeError:
        raise ApplrError(f"{path} is no text: give a URDF or xacro file") from None
    if "xacro" not in text:
        return text
    index = types.ModuleType("ament_index_python.packages")  # where xacro asks for packages
    index.get_package_share_directory = packages.folder  # type: ignore[attr-defined]
    sys.modules.update({"ament_index_python": types.ModuleType("ament_index_python"), index.__name__: index})
    try:
        with contextlib.redirect_stderr(io.StringIO()):
            return str(xacro.process_file(path, mappings=dict(arguments)).toxml())
    except Exception as error:  # what a file of expressions raises can be anything
        missing = re.search(r"Undefined substitution argument (\S+)", str(error))
        if missing:
            raise ApplrError(f"{path} needs the argument {missing[1]}: give {missing[1]}:=VALUE") from None
        absent = ", ".join(sorted(packages.missing))
        there = f"; put {absent} beside its package, or source the workspace that has them" if absent else ""
        raise ApplrError(f"{path}: xacro refuses it: {reason(error)}{there}") from None


class _Reader:
    """One URDF: its tree of joints, and the boxes around its shapes in the base frame."""

    def __init__(self, path: str, arguments: Mapping[str, str], base_frame: str):
        try:
            import yourdfpy
        except ModuleNotFoundError as missing:
            raise ApplrError(
                f"Python's {missing.name} is not installed: run ./applr robot, or "
                "pip install --no-deps -r requirements/urdf.txt"
            ) from None
        self.path, self.packages = path, _Packages(Path(path))
        self.lost: Set[str] = set()  # meshes that are not there
        text = _text(path, arguments, self.packages)
        named = sorted(set(re.findall(r"<xacro:arg\s+name=\"(\w+)\"", Path(path).read_text(encoding="utf-8"))))
        self.choices = f"; the file takes {', '.join(name + ':=' for name in named)}" if named else ""
        try:
            self.xml = ElementTree.fromstring(text)
        except (ElementTree.ParseError, ValueError) as error:
            raise ApplrError(f"{path} is no XML ({reason(error)}): give a URDF or xacro file") from None
        if self.xml.tag != "robot":
            raise ApplrError(
                f"{path}: its outermost tag is <{self.xml.tag}>: give a URDF or xacro file, whose is <robot>"
            )
        logging.getLogger("yourdfpy").setLevel(logging.CRITICAL)
        try:
            self.urdf = yourdfpy.URDF.load(io.BytesIO(text.encode()), load_meshes=False)
        except Exception as error:  # the library says of a missing tag that None has no attribute
            raise ApplrError(f"{path} cannot be read as URDF: {type(error).__name__}: {reason(error)}") from None
        self.links = self.urdf.link_map
        self.joint_to = {joint.child: joint for joint in self.urdf.robot.joints}
        if base_frame and base_frame not in self.links:
            raise ApplrError(f"{path} has no link {base_frame}, which the parameter files name as robot_base_frame")
        usual = [name for name in ("base_link", "base_footprint") if name in self.links]
        self.base = base_frame or (usual or [self.urdf.base_link])[0]
        # joints that move a link, the nearest first
        self.moving = {name: [j for j in self._above(name) if j.type != "fixed"] for name in self.links}

    def _above(self, link: str) -> Iterator[Any]:
        while link in self.joint_to:
            yield self.joint_to[link]
            link = self.joint_to[link].parent

    def pose(self, link: str) -> np.ndarray:
        """(4, 4) of a link in the base frame."""
        return self.urdf.get_transform(link, self.base)

    def axis(self, joint: Any) -> np.ndarray:
        """(3,) the direction of a joint's axis in the base frame."""
        direction = self.pose(joint.child)[:3, :3] @ np.asarray(joint.axis, dtype=float)
        return direction / (np.linalg.norm(direction) or 1.0)

    # --- shapes -------------------------------------------------------------------------------------------------------

    def boxes(self, names: Iterable[str], kind: str = "collisions") -> List[Box]:
        """A box around each shape of some links that can be read. kind: collisions or visuals."""
        shapes = [(name, shape) for name in names for shape in getattr(self.links[name], kind)]
        found = [self._box(name, shape) for name, shape in shapes if shape.geometry is not None]
        return [box for box in found if box is not None]

    def _box(self, link: str, shape: Any) -> Optional[Box]:
        geometry = shape.geometry
        pose = self.pose(link) @ (np.eye(4) if shape.origin is None else shape.origin)
        turn, middle = pose[:3, :3], pose[:3, 3]
        if geometry.box is not None:
            half = np.abs(turn) @ (np.asarray(geometry.box.size) / 2)
        elif geometry.sphere is not None:
            half = np.full(3, geometry.sphere.radius)
        elif geometry.cylinder is not None:
            along = np.abs(turn[:, 2])
            half = geometry.cylinder.length / 2 * along
            half = half + geometry.cylinder.radius * np.sqrt(np.maximum(1 - along**2, 0))
        else:
            corners = self._mesh(geometry.mesh)
            return None if corners is None else around([corners @ turn.T + middle])
        return np.array([middle - half, middle + half])

    def _mesh(self, mesh: Any) -> Optional[np.ndarray]:
        """(n, 3) the corners of a mesh, scaled [m]; None, and noted, where it cannot be read."""
        import trimesh

        package, _, inside = mesh.filename.partition("package://")[2].partition("/")
        try:
            if package:
                file = os.path.join(self.packages.folder(package), inside)
            else:
                file = os.path.join(os.path.dirname(self.path), re.sub("^file://", "", mesh.filename))
            loaded: Any = trimesh.load(file, force="mesh", skip_materials=True)
            corners = np.asarray(loaded.vertices)
        except Exception:  # of the readers of a dozen formats
            corners = np.empty((0, 3))
        if not len(corners):
            self.lost.add(mesh.filename)
            return None
        return corners * (1.0 if mesh.scale is None else np.asarray(mesh.scale))

    # --- the sections of robot.yaml -----------------------------------------------------------------------------------

    def description(self, laser_frame: str) -> Description:
        """All that the file says."""
        said = Description({"base": {}, "body": {}, "laser": {}, "topics": {}, "frames": {"base": self.base}})
        wheels = self._wheels()
        base = said.values["base"]
        found, ahead = self._drive(wheels)
        base.update(found)
        driven = {joint.name for joint, _ in wheels.values()}
        suspension = {j.name for joint, _ in wheels.values() for j in self.moving[joint.child]} - driven
        rest = [name for name in self.links if not driven & {j.name for j in self.moving[name]}]
        rigid = [name for name in rest if {j.name for j in self.moving[name]} <= suspension]
        loose = [name for name in rest if name not in rigid]
        if base["drive"] == "two_wheel":
            places, standing = self._casters(rest, base["axle_height"], base["wheel_radius"])
            if places:
                base["casters"] = places
            swivels = {joint.name for name in standing for joint in self.moving[name]}
            rigid = [name for name in rigid if name not in standing]
            loose = [name for name in loose if not swivels & {joint.name for joint in self.moving[name]}]
        self._body(said, rest, rigid, loose)
        self._laser(said, laser_frame)
        if abs(ahead) > 0.01:
            where = "ahead of" if ahead > 0 else "behind"
            said.notes.append(
                f"the wheels' middle lies {abs(ahead):.3f} m {where} {self.base}: the simulators drive as if above it, "
                "so base.casters and body.com count from the wheels' middle"
            )
            for place in [*base.get("casters", []), said.values["body"].get("com", [0.0])]:
                place[0] -= ahead
        if self.lost:
            said.notes.append(
                f"meshes that are not there, and are left out of the outline: {', '.join(sorted(self.lost))}"
            )
        return said

    def _wheels(self) -> Dict[str, Tuple[Any, Box]]:
        """Joints of the driven wheels and boxes around these, by link."""
        match = _OMNI.search(ElementTree.tostring(self.xml, "unicode"))
        if match:
            raise ApplrError(f"{self.path}: {match[0]}{_SIDEWAYS}: {_OURS}")
        wrong: Dict[str, str] = {}
        found: Dict[str, Tuple[Any, Box]] = {}
        for joint in self.urdf.robot.joints:
            carriers, axis = self.moving.get(joint.child, [])[1:], self.axis(joint)
            if joint.type != "continuous" or abs(axis[2]) > 0.3 or any(j.type == "continuous" for j in carriers):
                continue  # a swivel, a turret, a caster below its swivel, a roller on a wheel's rim
            parts = [name for name, joints in self.moving.items() if joints[:1] == [joint]]
            boxes = self.boxes(parts) or self.boxes(parts, "visuals")
            steering = [j.name for j in carriers if abs(self.axis(j)[2]) > 0.7]
            if steering:
                wrong[joint.child] = f"{steering[0]} steers the wheel of {joint.name}"
            elif abs(axis[1]) < 0.95:
                wrong[joint.child] = f"{joint.name}, which turns about an axis not across the robot,{_SIDEWAYS}"
            if boxes:
                found[joint.child] = (joint, around(boxes))
        lowest = min((box[0, 2] for _, box in found.values()), default=0.0)
        found = {name: (j, box) for name, (j, box) in found.items() if box[0, 2] < lowest + (box[1, 2] - box[0, 2]) / 4}
        for name in found:  # what turns above the ground, such as a gripper, is no wheel
            if name in wrong:
                raise ApplrError(f"{self.path}: {wrong[name]}: {_OURS}")
        return found

    def _drive(self, wheels: Dict[str, Tuple[Any, Box]]) -> Tuple[Dict[str, Any], float]:
        """Kind of the drive and measures of the wheels, and how far their middle lies ahead of the base frame [m]."""
        if not wheels:
            lost = f" (there is no {sorted(self.lost)[0]})" if self.lost else ""
            raise ApplrError(
                f"{self.path} has no wheels: no continuous joint turns a link with a shape{lost} about an axis across "
                "the robot; give the URDF of the whole robot"
            )
        boxes = np.array([box for _, box in wheels.values()])
        middles, sizes = boxes.mean(axis=1), boxes[:, 1] - boxes[:, 0]
        ahead, radius = float(middles[:, 0].mean()), float(sizes[:, 2].mean() / 2)
        front, left = middles[:, 0] > ahead + radius / 4, middles[:, 1] > middles[:, 1].mean()
        pairs = (len(wheels), int(front.sum()), int(left.sum()), int(left[front].sum()))
        if pairs not in ((4, 2, 2, 1), (2, 0, 1, 0)):
            raise ApplrError(f"{self.path}: the driven wheels are {', '.join(sorted(wheels))}: {_OURS}")
        found: Dict[str, Any] = {
            "drive": "two_wheel" if len(wheels) == 2 else "skid_steer",
            "wheel_radius": radius,
            "wheel_width": float(sizes[:, 1].mean()),
            "track": float(middles[left, 1].mean() - middles[~left, 1].mean()),
            "axle_height": float(middles[:, 2].mean()),
        }
        if front.any():
            found["wheelbase"] = float(middles[front, 0].mean() - middles[~front, 0].mean())
        round_ones = [name for name in wheels if any(c.geometry.sphere for c in self.links[name].collisions)]
        if round_ones:  # balls that stand for wheels say nothing about their width
            seen = self.boxes(round_ones, "visuals")
            found.update(wheel_width=float(np.mean([b[1, 1] - b[0, 1] for b in seen])) if seen else None)
        mass, _, inertia = self._inertia(wheels)
        if mass:
            found["wheel_mass"] = mass / len(wheels)
            own = np.mean([self._inertia([name])[2] for name in wheels], axis=0)
            if own.min() > 1e-9:
                found["wheel_inertia"] = own.tolist()
        return {name: value for name, value in found.items() if value is not None}, ahead

    def _inertia(self, names: Iterable[str]) -> Tuple[float, np.ndarray, np.ndarray]:
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

    def _casters(self, rest: List[str], axle: float, radius: float) -> Tuple[List[List[float]], Set[str]]:
        """Where links other than the wheels touch the ground (x, y), and which do."""
        places: List[List[float]] = []
        standing = set()
        for name in rest:
            for box in self.boxes([name]) or self.boxes([name], "visuals"):
                x, y = box.mean(axis=0)[:2].tolist()
                if box[0, 2] > axle - 0.85 * radius or np.max(box[1] - box[0]) > 4 * radius:
                    continue  # above the ground, or a body that hangs low
                standing.add(name)
                if all(hypot(x - other[0], y - other[1]) > radius for other in places):
                    places.append([x, y])
        return places, standing

    def _body(self, said: Description, rest: List[str], rigid: List[str], loose: List[str]) -> None:
        boxes = self.boxes(rigid)
        if not boxes:
            boxes = self.boxes(rigid, "visuals")
            said.notes.append("the body has no collision shapes: its outline is that of what is seen")
        body = said.values["body"]
        if boxes:
            low, high = around(boxes)
            body.update(size=(high - low).tolist(), centre=((low + high) / 2)[:2].tolist(), bottom=float(low[2]))
        shaped = [name for name in loose if self.links[name].collisions]
        if shaped:
            said.notes.append(f"links that move are left out of the outline: {', '.join(shaped)}")
        mass, centre, inertia = self._inertia(rest)
        if mass:
            body.update(mass=mass, com=centre.tolist())
            if inertia.min() > 1e-9:
                body["inertia"] = inertia.tolist()

    def _laser(self, said: Description, frame: str) -> None:
        """Its place, and what a sensor of Gazebo says of its rays."""
        sensors = {}
        for holder in self.xml.findall("gazebo"):
            for sensor in holder.findall("sensor"):
                flat = float(sensor.findtext(".//vertical/samples") or 1) <= 1
                if sensor.get("type") in _RAYS and flat and self._looks_around(holder.get("reference"), sensor):
                    named = (sensor.findtext("plugin/frameName") or sensor.findtext("plugin/frame_name") or "").strip()
                    sensors[named if named in self.links else holder.get("reference")] = sensor
        named = [name for name in self.links if _LASER.search(name)]
        leaves = [name for name in named if not any(name in self._parents(other) for other in named)]
        candidates = [frame] if frame in self.links else list(sensors) or leaves
        if not candidates:
            said.notes.append(
                "there is no laser: no link is named after one, and no sensor of Gazebo has rays" + self.choices
            )
            said.values["laser"].update({"frame": frame} if frame else {})
            return
        if len(candidates) > 1:
            said.notes.append(
                f"of the lasers {', '.join(candidates)} the first is taken: one planar scanner is simulated"
            )
        frame = candidates[0]
        pose, laser = self.pose(frame), said.values["laser"]
        x, y, z = pose[:3, 3].tolist()
        laser.update(frame=frame, pose=[x, y, atan2(pose[1, 0], pose[0, 0])], height=z)
        if abs(pose[2, 2]) < 0.99:
            said.notes.append(f"{frame} is tilted: the simulators hold it level")
        sensor = sensors.get(frame, next(iter(sensors.values())) if len(sensors) == 1 else None)
        if sensor is None:
            return
        places = {
            "beams": ".//horizontal/samples",
            "first_angle": ".//horizontal/min_angle",
            "last_angle": ".//horizontal/max_angle",
            "range_min": ".//range/min",
            "range_max": ".//range/max",
            "rate": "update_rate",
            "noise": ".//noise/stddev",
        }
        for name, place in places.items():
            text = sensor.findtext(place)
            with contextlib.suppress(TypeError, ValueError):
                laser[name] = int(float(text)) if name == "beams" else float(text)
        if pose[2, 2] < 0 and {"first_angle", "last_angle"} <= set(laser):  # upside down
            laser.update(first_angle=-laser["last_angle"], last_angle=-laser["first_angle"])
        topic = (sensor.findtext("plugin/topicName") or "").strip()
        if topic:
            said.values["topics"]["scan"] = topic

    def _looks_around(self, link: str, sensor: Any) -> bool:
        """Whether it is level and wide: cliff sensors and sonars are rays for Gazebo as well."""
        ends = [sensor.findtext(f".//horizontal/{name}_angle") or "0" for name in ("min", "max")]
        return link in self.links and abs(self.pose(link)[2, 2]) > 0.99 and float(ends[1]) - float(ends[0]) > 0.6

    def _parents(self, link: str) -> List[str]:
        return [joint.parent for joint in self._above(link)]


def around(boxes: List[np.ndarray]) -> Box:
    """The box around points, (n, 3) each."""
    points = np.concatenate(boxes)
    return np.array([points.min(axis=0), points.max(axis=0)])
