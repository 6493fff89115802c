"""Router of sensor observations to the obstacle layers by topic, for MoveBase.

It also detects silent sources.
"""

from __future__ import annotations

import math
from typing import Dict, List, Mapping, NamedTuple, Optional, Tuple, Union

from applr_ros1.common.angles import Pose
from applr_ros1.common.scan import (
    LaserScan,
    Observation,
    ObservationBuffer,
    PointCloud,
    Source,
    moved,
    observe,
)
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.parameters.layers import PREDICTED

Sensed = Union[Observation, Mapping[str, Observation]]


class _ListeningBuffer(NamedTuple):
    """Observation buffer of an obstacle layer that listens to a topic."""

    buffer: ObservationBuffer
    is_global: bool  # whether the buffer belongs to the global costmap


class ObservationRouter:
    """Router of observations to the sources of both costmaps, by topic.

    Args:
        local_costmap: costmap in which the robot drives. The robot stops when one of its sources
            falls silent.
        global_costmap: costmap of the global planner.
        timeout: age of the latest message at which a source counts as silent [s], 0 to disable. It
            applies to laser scans and clearing sources, because other sources may have nothing to
            report. Predictions of that age are dropped instead, whereas C++ would mark them
            forever.

    Attributes:
        data_types: data types of all sources by topic, those of the local costmap first.
        ray_origins: frame at whose origin the rays start, by topic, for sources with the parameter
            sensor_frame.
    """

    def __init__(self, local_costmap: Costmap, global_costmap: Costmap, timeout: float):
        self._local_costmap = local_costmap
        self._timeout = timeout
        self._listeners: Dict[str, List[_ListeningBuffer]] = {}
        self.data_types: Dict[str, str] = {}
        self.ray_origins: Dict[str, str] = {}
        # By topic and frame: stamp of the latest observation [s]
        self._stamps: Dict[str, Dict[Optional[str], float]] = {}
        self._last_call = -math.inf  # time of the last call [s]
        for costmap in (local_costmap, global_costmap):
            for layer in costmap.obstacle_layers:
                for buffer in layer.buffers:
                    self._add(_ListeningBuffer(buffer, costmap is global_costmap))

    def _add(self, listener: _ListeningBuffer) -> None:
        source = listener.buffer.source
        self._listeners.setdefault(source.topic, []).append(listener)
        self.data_types.setdefault(source.topic, source.data_type)
        if source.sensor_frame:
            self.ray_origins.setdefault(source.topic, source.sensor_frame)

    def route(
        self, sensed: Sensed, now: float, local_origin: Optional[Pose], placed: bool = True
    ) -> None:
        """Pass observations to the sources on their topics.

        Observations older than the latest one of their sensor are dropped.

        Args:
            sensed: {topic: observation}, or one observation of the first topic.
            now: time [s].
            local_origin: as in MoveBase.step.
            placed: whether the pose of the local costmap's frame in the global one is known. If
                not, only the sources of the local costmap get the observations.
        """
        self._follow_clock(now)
        if not isinstance(sensed, Mapping):
            first_topics = list(self.data_types)[:1]
            sensed = {topic: sensed for topic in first_topics}
        for topic, observation in sensed.items():
            # Lasers that share a topic may have different delays.
            stamps = self._stamps.setdefault(topic, {})
            if observation.stamp >= stamps.get(observation.frame, observation.stamp):
                stamps[observation.frame] = observation.stamp
                self._hand_on(topic, observation, now, local_origin, placed)

        # A tracker that has died would otherwise leave its last obstacles in the maps.
        predicted_stamp = self._latest(PREDICTED, now)
        if 0.0 < self._timeout < now - predicted_stamp:
            del self._stamps[PREDICTED]
            for listener in self._listeners[PREDICTED]:
                listener.buffer.forget()

    def _latest(self, topic: str, otherwise: float) -> float:
        """Return the stamp of the latest observation on a topic [s], or another time."""
        return max(self._stamps.get(topic, {}).values(), default=otherwise)

    def _hand_on(
        self,
        topic: str,
        observation: Observation,
        now: float,
        local_origin: Optional[Pose],
        placed: bool,
    ) -> None:
        """Give an observation to the buffers that listen to its topic.

        placed: whether local_origin is known; the global costmap takes nothing without it.
        """
        # Sources with the same frame and treatment of +inf share a projection.
        clouds: Dict[Tuple[bool, bool], PointCloud] = {}
        for buffer, is_global in self._listeners.get(topic, ()):
            if is_global and not placed:
                continue
            inf_is_valid = buffer.source.inf_is_valid and isinstance(observation, LaserScan)
            frame = local_origin if is_global else None
            key = (frame is not None, inf_is_valid)
            if key not in clouds:
                in_frame = observation if frame is None else moved(observation, frame)
                clouds[key] = observe(in_frame, inf_is_valid)
            buffer.add_cloud(clouds[key], now)

    def silent(self, now: float) -> Optional[Tuple[str, float]]:
        """Return (topic, timeout [s]) of a source that has been silent for too long, or None.

        Only sources of the local costmap count.
        """
        self._follow_clock(now)
        for layer in self._local_costmap.obstacle_layers:
            for buffer in layer.buffers:
                source = buffer.source
                # The timeout of C++, in seconds in spite of its name, which a disabled layer does
                # not apply.
                if layer.parameters.enabled and not buffer.is_current(now):
                    return source.topic, source.expected_update_rate
                # This package's own timeout: a laser that has died is one in a disabled layer, too.
                if self._timeout > 0.0 and _must_speak(source):
                    stamp = self._latest(source.topic, -math.inf)
                    if now - stamp > self._timeout:
                        return source.topic, self._timeout
        return None

    def _follow_clock(self, now: float) -> None:
        """Drop all observations when the clock steps back: their stamps would be in the future."""
        if now < self._last_call:
            self._stamps.clear()
            for listeners in self._listeners.values():
                for listener in listeners:
                    listener.buffer.forget()
        self._last_call = now


def _must_speak(source: Source) -> bool:
    """Return whether a source always has something to report."""
    if source.topic == PREDICTED:
        return False
    return source.data_type == "LaserScan" or source.clearing
