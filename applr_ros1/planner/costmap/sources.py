"""An observation source of an obstacle layer: its settings, and the point clouds that it has at the moment.

Called by obstacle_layer.ObstacleLayer and MoveBase. Follows costmap_2d/observation_buffer.cpp.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, List, Optional

from applr_ros1.planner.costmap.scan import PointCloud


@dataclass
class Source:
    """Settings of one source, named as the ROS parameters; the defaults are those of a planar laser."""

    topic: str = "scan"
    data_type: str = "LaserScan"  # or PointCloud2, PointCloud
    sensor_frame: str = ""  # where the rays start; empty: the frame of the message
    marking: bool = True
    clearing: bool = True
    inf_is_valid: bool = False  # +inf of a laser scan clears as far as it can
    min_obstacle_height: float = -2.0  # [m] points below or above are dropped
    max_obstacle_height: float = 2.0
    obstacle_range: float = 2.5  # [m] points at or beyond it do not mark
    raytrace_range: float = 3.0  # [m] rays clear up to it
    observation_persistence: float = 0.0  # [s] for which clouds are kept; 0: the newest alone
    expected_update_rate: float = 0.0  # [s] after which the source counts as silent; 0: never

    def __post_init__(self):  # the kernels are compiled for these types alone
        for field in fields(self):
            kind: Any = type(field.default)
            setattr(self, field.name, kind(getattr(self, field.name)))


class ObservationBuffer:
    """The clouds of one source, newest first; they are applied in every update until they go.

    Attributes:
        source: the settings.
        clouds: PointClouds in the costmap's frame.
        taken: time [s] at which the newest one came, None before the first.
    """

    def __init__(self, source: Source):
        self.source = source
        self.clouds: List[PointCloud] = []
        self.taken: Optional[float] = None

    def take(self, cloud: PointCloud, now: float) -> None:
        """A new cloud at time `now` [s]. What was taken longer ago than observation_persistence goes."""
        self.taken = now
        kept = self.source.observation_persistence
        if kept <= 0.0:
            self.clouds = [cloud]
            return
        self.clouds.insert(0, cloud)
        for i, old in enumerate(self.clouds):
            if now - old.stamp > kept:
                del self.clouds[i:]
                break

    def forget(self) -> None:
        """The source has said nothing yet."""
        self.clouds, self.taken = [], None

    def is_current(self, now: float) -> bool:
        """Whether the source still says something as often as expected_update_rate demands."""
        longest = self.source.expected_update_rate
        return longest <= 0.0 or (self.taken is not None and now - self.taken <= longest)
