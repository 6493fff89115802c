"""The laser and the footprint of the included Jackal by short names, from its description."""

import numpy as np

from applr_ros1.robots import load

_LASER = load("jackal").laser
LASER_OFFSET = _LASER.pose[:2]
BEAMS, ANGLE_MIN, ANGLE_MAX, ANGLE_INCREMENT = _LASER.beams, _LASER.first_angle, _LASER.last_angle, _LASER.increment
RANGE_MIN, RANGE_MAX = _LASER.range_min, _LASER.range_max
FOOTPRINT = np.array([(-0.21, -0.165), (-0.21, 0.165), (0.21, 0.165), (0.21, -0.165)])
