"""Router of sensor observations to the obstacle layers by topic, with detection of silent sources, for MoveBase."""

from __future__ import annotations

import math
from typing import Any, Dict, List, Mapping, NamedTuple, Optional, Tuple, Union

from applr_ros1.common.angles import Pose
from applr_ros1.common.scan import (
    LaserScan,
    Observation,
    ObservationBuffer,
    PointCloud,
    moved,
    observe,
)
from applr_ros1.planner.costmap.costmap import Costmap
from applr_ros1.planner.parameters.layers import PREDICTED

Sensed = Union[Observation, Mapping[str, Observation]]


class _Listener(NamedTuple):
    """Observation buffer of an obstacle layer that listens to a topic."""

    buffer: ObservationBuffer
    is_global: bool  # whether the buffer belongs to the global costmap


class ObservationRouter:
    """Router of observations to the sources of both costmaps, by topic.

    Args:
        local_costmap: costmap in which the robot drives. The robot stops when one of its sources falls silent.
        global_costmap: costmap of the global planner.
        timeout: age of the latest message at which a source counts as silent [s], 0 to disable. It applies to laser
            scans and clearing sources, because other sources may have nothing to report. Predictions of that age
            are dropped instead, whereas C++ would mark them forever.

    Attributes:
        data_types: data types of all sources by topic, those of the local costmap first.
        ray_origins: frame at whose origin the rays start, by topic, for sources with the parameter sensor_frame.
    """

    def __init__(self, local_costmap: Costmap, global_costmap: Costmap, timeout: float):
        self._local, self._timeout = local_costmap, timeout
        self._listeners: Dict[str, List[_Listener]] = {}
        self.data_types: Dict[str, str] = {}
        self.ray_origins: Dict[str, str] = {}
        self._stamps: Dict[str, float] = {}
        self._last = -math.inf  # time of the last call [s]
        for costmap, is_global in ((local_costmap, False), (global_costmap, True)):
            for layer in costmap.obstacle_layers:
                for buffer in layer.buffers:
                    topic = buffer.source.topic
                    self._listeners.setdefault(topic, []).append(_Listener(buffer, is_global))
                    self.data_types.setdefault(topic, buffer.source.data_type)
                    if buffer.source.sensor_frame:
                        self.ray_origins.setdefault(topic, buffer.source.sensor_frame)

    def take(
        self, sensed: Sensed, now: float, local_origin: Optional[Pose], placed: bool = True
    ) -> None:
        """Pass observations to the sources on their topics. Observations older than the latest one are dropped.

        Args:
            sensed: {topic: observation}, or one observation of the first topic.
            now: time [s].
            local_origin: as in MoveBase.step.
            placed: whether the pose of the local costmap's frame in the global one is known. If not, only the sources
                of the local costmap get the observations.
        """
        self._follow_clock(now)
        if not isinstance(sensed, Mapping):
            sensed = {topic: sensed for topic in list(self.data_types)[:1]}
        for topic, observation in sensed.items():
            if topic in self._stamps and observation.stamp < self._stamps[topic]:
                continue
            self._stamps[topic] = observation.stamp
            self._hand_on(topic, observation, now, local_origin, placed)
        if (
            0.0 < self._timeout < now - self._stamps.get(PREDICTED, now)
        ):  # Outdated predictions are forgotten.
            del self._stamps[PREDICTED]
            for listener in self._listeners[PREDICTED]:
                listener.buffer.forget()

    def _hand_on(
        self,
        topic: str,
        observation: Observation,
        now: float,
        local_origin: Optional[Pose],
        placed: bool,
    ) -> None:
        clouds: Dict[
            Any, PointCloud
        ] = {}  # projections, shared by sources with the same frame and treatment of +inf
        for buffer, is_global in self._listeners.get(topic, ()):
            if is_global and not placed:
                continue
            valid = buffer.source.inf_is_valid and isinstance(observation, LaserScan)
            frame = local_origin if is_global else None
            key = frame is not None, valid
            if key not in clouds:
                clouds[key] = observe(
                    observation if frame is None else moved(observation, frame), valid
                )
            buffer.take(clouds[key], now)

    def silent(self, now: float) -> Optional[Tuple[str, float]]:
        """Return (topic, timeout [s]) of a source of the local costmap that has been silent for too long, or None."""
        self._follow_clock(now)
        for layer in self._local.obstacle_layers:
            for buffer in layer.buffers:
                source = buffer.source
                if layer.parameters.enabled and not buffer.is_current(now):
                    return source.topic, source.expected_update_rate
                must_speak = (
                    source.data_type == "LaserScan" or source.clearing
                ) and source.topic != PREDICTED
                if self._timeout > 0.0 and must_speak:
                    stamp = self._stamps.get(source.topic)
                    if stamp is None or now - stamp > self._timeout:
                        return source.topic, self._timeout
        return None

    def _follow_clock(self, now: float) -> None:
        """Drop all observations when the clock steps back, because their stamps would be in the future."""
        if now < self._last:
            self._stamps.clear()
            for listeners in self._listeners.values():
                for listener in listeners:
                    listener.buffer.forget()
        self._last = now
