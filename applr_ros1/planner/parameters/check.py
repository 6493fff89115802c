"""Checks of parameter trees: errors, warnings about ignored values, and completion with defaults.

MoveBase completes its parameter tree; the node and robots/check.py print the messages. Names and
bounds come from declarations.tables, conflicts between values from the functions `contradictions`.
"""

from __future__ import annotations

import math
from typing import Any, Dict, Iterator, List, Set, Tuple

from applr_ros1.common.errors import did_you_mean, shown
from applr_ros1.planner.parameters.costmap_parameters import COSTMAP, DATA_TYPES, STATIC_COSTMAP
from applr_ros1.planner.parameters.declarations import (
    CONTRADICTIONS,
    GLOBAL_PLANNERS,
    LOCAL_PLANNERS,
    namespace,
    tables,
)
from applr_ros1.planner.parameters.layers import (
    COSTMAPS,
    FOUND_ABOVE,
    INHERITED,
    arranged,
    observation_sources,
    replaced,
)
from applr_ros1.planner.parameters.move_base_parameters import (
    BEHAVIOUR,
    DEFAULT_RECOVERIES,
    RECOVERY_TYPES,
)
from applr_ros1.planner.parameters.parameter import (
    Parameter,
    ParameterError,
    by_name,
    too_many_points,
)
from applr_ros1.planner.parameters.trees import Tree, branch

USUAL = tuple(behaviour["name"] for behaviour in DEFAULT_RECOVERIES)


def check(tree: Tree) -> List[str]:
    """Return the errors of a nested parameter tree.

    These are invalid values or, if none is invalid, conflicting values.
    """
    try:
        errors = _Inspection(arranged(tree)).errors
        return errors or list(_contradictions(_completed(tree)))
    except ParameterError as problem:
        return [str(problem)]


def remarks(tree: Tree) -> List[str]:
    """Return warnings about a tree without errors: values that are ignored, replaced or risky."""
    _, messages = _recoveries(tree)
    messages = [*messages, *replaced(tree)]
    inspection = _Inspection(arranged(tree))
    messages += inspection.warnings
    if inspection.unknown:
        messages.append(f"{', '.join(inspection.unknown)}: unknown, ignored")

    # The defaults of DWAPlannerROS are those of a base that can strafe; the ones here cannot.
    planner = _local_planner(tree)
    if planner == "DWAPlannerROS":
        values = _completed(tree)[planner]
        sideways_limits = (values["min_vel_y"], values["max_vel_y"])
        if any(sideways_limits):
            problem = f"{planner}/min_vel_y, max_vel_y are {sideways_limits}"
            messages.append(f"{problem}: the base cannot drive sideways, give 0 for both")
    return messages + list(_risks(arranged(tree)))


def _risks(tree: Tree) -> Iterator[str]:
    """Yield a warning if the local costmap has no sources or if the base frames differ."""
    frames = _frames(tree)
    global_frame = frames["global_costmap/robot_base_frame"].strip("/")
    local_frame = frames["local_costmap/robot_base_frame"].strip("/")
    if global_frame != local_frame:
        problem = f"local_costmap/robot_base_frame is {local_frame}"
        yield f"{problem}: both costmaps use {global_frame} of global_costmap, give {global_frame}"
    for label, frame in frames.items():
        if frame.startswith("/"):
            problem = f"{label} is {frame}: Noetic's tf2 refuses frames that begin with a slash"
            yield f"{problem}, give {frame.strip('/')}"
    if not list(observation_sources("local_costmap", branch(tree, "local_costmap"))):
        problem = "local_costmap has no observation source"
        yield f"{problem}: the robot will not detect obstacles, give a source"


def _frames(tree: Tree) -> Dict[str, str]:
    """Return the names of frames in an arranged tree by their parameters."""
    frames = {}
    for costmap in COSTMAPS:
        section = branch(tree, costmap)
        frames[f"{costmap}/robot_base_frame"] = str(section.get("robot_base_frame", "base_link"))
        frames[f"{costmap}/global_frame"] = str(section.get("global_frame", "map"))
        for source in observation_sources(costmap, section):
            frames[f"{source.path}/sensor_frame"] = str(source.values.get("sensor_frame", ""))
    return frames


class _Inspection:
    """Errors and warnings about the names and values of an arranged tree.

    Attributes:
        errors: a line for each value with which the node cannot start.
        warnings: a line for each value that is not used as it stands.
        unknown: names that nothing reads, and that resemble no other name.
    """

    def __init__(self, tree: Tree):
        self.errors: List[str] = []
        self.warnings: List[str] = []
        self.unknown: List[str] = []
        self._declared = tables(tree)
        self._sections = [*self._declared, *_behaviours(tree)]
        idle_planners = _idle_planners(tree)
        used_entries = {name: value for name, value in tree.items() if name not in idle_planners}
        self._walk(used_entries, "")

    def _walk(self, section: Tree, path: str) -> None:
        """Inspect a section, "" for the tree, and all sections below it."""
        parameters = self._parameters(path)
        for key, value in section.items():
            label = _label(path, key)
            if isinstance(value, dict) and label in self._sections:
                self._walk(value, label)
            elif key in parameters and not isinstance(value, dict):
                self._examine(parameters[key], value, label)
            elif value is None:
                continue  # A section without entries is None in YAML.
            elif not path and label in self._declared:
                self.errors.append(f"{label} is {shown(value)}: give a mapping of names and values")
            else:
                self._report_unread(section, path, key)

    def _parameters(self, path: str) -> Dict[str, Parameter]:
        """Return the parameters that a section may have, by all their names."""
        # Only the declared sections and those of recovery behaviours are walked.
        parameters = by_name(self._declared.get(path, BEHAVIOUR))
        if path in COSTMAPS:
            return {**INHERITED, **parameters}
        if not path:
            for parameter in COSTMAP + STATIC_COSTMAP:
                if parameter.name in FOUND_ABOVE:
                    parameters[parameter.name] = parameter
        return parameters

    def _report_unread(self, section: Tree, path: str, key: str) -> None:
        """Warn about a name that nothing reads, with the name that was probably meant.

        An unknown section that resembles no other is not reported: it may hold the values of a
        plugin that the tree does not choose.
        """
        parameters = self._parameters(path)
        label = _label(path, key)
        is_section = isinstance(section[key], dict)
        newer_names = {}
        for parameter in parameters.values():
            newer_names.update(dict.fromkeys(parameter.older, parameter.name))
        if key in newer_names:
            advice = f"give {newer_names[key]}"
        else:
            # Only a name of the same kind, section or parameter, that is not yet in use was meant.
            known_names = self._subsections(path) if is_section else list(parameters)
            advice = did_you_mean(key, [name for name in known_names if not section.get(name)])
        if advice:
            self.warnings.append(f"{label} is ignored: {advice}")
        elif not is_section:
            self.unknown.append(label)

    def _subsections(self, path: str) -> List[str]:
        """Return the known sections below a section, as they are called in it."""
        prefix = _label(path, "")  # "" for the tree itself, otherwise with a slash at the end
        return [name[len(prefix) :] for name in self._sections if name.startswith(prefix)]

    def _examine(self, parameter: Parameter, value: Any, label: str) -> None:
        """Report a value that is not used as it stands."""
        if not parameter.reads(value):
            if parameter.type != "list":  # _recoveries reports lists.
                problem = f"{label} is {shown(value)}"
                replacement = f"the default {parameter.default!r} is used, as in C++"
                self.warnings.append(f"{problem}: {replacement}; {parameter.give}")
            return
        try:
            converted = parameter.convert(value, label)
            clamped = parameter.clamp(converted, label)
        except ParameterError as problem:
            self.errors.append(str(problem))
            return
        if clamped == converted:
            return
        advice = f"give a value from {parameter.min!r} to {parameter.max!r}"
        if parameter.beyond == "error":
            self.errors.append(f"{label} is {converted!r}: {advice}")
        elif parameter.beyond:
            self.warnings.append(f"{label} is {converted!r}: {clamped!r} is used, {advice}")


def _label(path: str, name: str) -> str:
    """Return the path of a name in the section `path`, which is "" for the tree itself."""
    return f"{path}/{name}" if path else name


def _local_planner(tree: Tree) -> str:
    return namespace(str(tree.get("base_local_planner", LOCAL_PLANNERS[0])))


def _idle_planners(tree: Tree) -> Set[str]:
    """Return the sections of the local planners that the tree does not choose."""
    return set(map(namespace, LOCAL_PLANNERS)) - {_local_planner(tree)}


def complete(tree: Tree) -> Tree:
    """Return a new nested dict of the tree with defaults for all absent parameters.

    Both names of each alias are present. The parameters of layers and sources are in the sections
    where C++ reads them (layers.arranged), and `plugins` is always present. Values that layers
    inherit from their costmap are given only at the layers, except for a track_unknown_space at the
    costmap.

    Raises:
        ParameterError: A value is invalid, or values conflict; the message is one line.
    """
    full_tree = _completed(tree)
    for conflict in _contradictions(full_tree):
        raise ParameterError(conflict)  # Only the first conflict is reported.
    return full_tree


def _completed(tree: Tree) -> Tree:
    """Return the same as `complete`, without checking for conflicts between values."""
    full_tree: Tree = {}
    tree = arranged(tree)
    declared_sections = tables(tree)
    idle_planners = _idle_planners(tree)
    for path, parameters in declared_sections.items():
        given_section = branch(tree, path)
        section = branch(full_tree, path, create=True)
        for parameter in parameters:
            if f"{path}/{parameter.name}" in declared_sections:
                continue  # A layer has this name, so nothing reads the parameter.
            given_values = parameter.given_in(given_section)
            # C++ searches for this one from the planner's name space upwards.
            if not given_values and parameter.name == "controller_frequency":
                given_values = parameter.given_in(tree)
            # Inherited parameters are completed at the layers. The costmap itself reads only one.
            is_read_here = bool(given_values) and parameter.name == "track_unknown_space"
            if path in COSTMAPS and parameter.name in INHERITED and not is_read_here:
                continue
            label = _label(path, parameter.name)
            value = given_values[0] if given_values else parameter.default
            try:
                value = parameter.taken(value, label)
            except ParameterError:
                # Nothing reads the values of a planner that is not chosen.
                if path not in idle_planners:
                    raise
                value = parameter.default
            section.update(dict.fromkeys(parameter.names, value))
    _complete_behaviours(tree, full_tree)
    return full_tree


def _complete_behaviours(tree: Tree, full: Tree) -> None:
    """Add the active recovery behaviours and the parameters of each listed behaviour."""
    behaviour_names = _behaviours(tree)
    full["recovery_behaviors"], _ = _recoveries(tree)
    for behaviour_name in behaviour_names:
        if behaviour_name in full and behaviour_name not in USUAL:
            problem = f"recovery_behaviors has the name {behaviour_name!r}, which is already in use"
            raise ParameterError(f"{problem}: give another one")

    # As in move_base.cpp, the default behaviours take their distances from other parameters.
    full["conservative_reset"]["reset_distance"] = full["conservative_reset_dist"]
    full["aggressive_reset"]["reset_distance"] = 4 * full["local_costmap"]["circumscribed_radius"]
    for behaviour_name in behaviour_names:
        section = {**full.get(behaviour_name, {}), **branch(tree, behaviour_name)}
        values = {}
        for parameter in BEHAVIOUR:
            given_values = parameter.given_in(section)
            value = given_values[0] if given_values else parameter.default
            values[parameter.name] = parameter.taken(value, f"{behaviour_name}/{parameter.name}")
        full[behaviour_name] = values


def _contradictions(full: Tree) -> Iterator[str]:
    """Yield the errors of a complete tree: unavailable plugins and conflicting values."""
    known_plugins = {"base_global_planner": GLOBAL_PLANNERS, "base_local_planner": LOCAL_PLANNERS}
    for name, plugins in known_plugins.items():
        if full[name] not in plugins:
            yield f"{name} is {full[name]}: give {' or '.join(plugins)}"

    # Sections with rules of their own
    planner = namespace(full["base_local_planner"])
    sections = [name for name in (planner, *COSTMAPS) if name in full]
    for section in sections:
        for conflict in CONTRADICTIONS[section](full[section]):
            yield f"{section}/{conflict}"

    # Rotations check a pose every sim_granularity of a full turn.
    for behaviour in dict.fromkeys(["rotate_recovery", *_behaviours(full)]):
        full_turn = {"sim_granularity": math.inf, **full[behaviour], "a turn of": 2 * math.pi}
        for conflict in too_many_points(full_turn, "sim_granularity", ["a turn of"]):
            yield f"{behaviour}/{conflict}"

    # Sources of messages that can be read
    for name in COSTMAPS:
        for source in observation_sources(name, full[name]):
            data_type = source.values["data_type"]
            if data_type not in DATA_TYPES:
                yield f"{source.path}/data_type is {data_type}: give {' or '.join(DATA_TYPES)}"


def _recoveries(tree: Tree) -> Tuple[List[Dict[str, str]], List[str]]:
    """Return the active recovery behaviours, and warnings about the list of a tree.

    As in move_base.cpp, loadRecoveryBehaviors, the default behaviours replace an invalid list, and
    a type may be given without its package. Types that are not available are left out.
    """
    given_list = tree.get("recovery_behaviors", DEFAULT_RECOVERIES)
    entries = given_list if isinstance(given_list, list) else [given_list]
    behaviour_names = []
    for entry in entries:
        is_typed = isinstance(entry, dict) and isinstance(entry.get("type"), str)
        behaviour_names.append(entry.get("name") if is_typed else None)

    # One wrong entry makes C++ ignore the list. The default list has one name twice.
    for entry, behaviour_name in zip(entries, behaviour_names):
        is_repeated = behaviour_names.count(behaviour_name) > 1 and given_list != DEFAULT_RECOVERIES
        if is_repeated or not isinstance(behaviour_name, str):
            problem = f"recovery_behaviors has {shown(entry)}"
            advice = "give each behaviour a unique name and a type"
            line = f"{problem}: the default behaviours are used, as in C++; {advice}"
            return DEFAULT_RECOVERIES, [line]

    full_types = {namespace(kind): kind for kind in RECOVERY_TYPES}
    active_behaviours = []
    warnings = []
    for entry in entries:
        kind = full_types.get(namespace(entry["type"]), entry["type"])
        if kind in RECOVERY_TYPES:
            active_behaviours.append(dict(entry, type=kind))
        else:
            problem = f"recovery_behaviors has {kind}"
            warnings.append(f"{problem}: this type is not available, the others are used")
    return active_behaviours, warnings


def _behaviours(tree: Tree) -> List[str]:
    """Return the names in recovery_behaviors, none if the default behaviours are active."""
    behaviours, _ = _recoveries(tree)
    if behaviours == DEFAULT_RECOVERIES:
        return []
    return [behaviour["name"] for behaviour in behaviours]
