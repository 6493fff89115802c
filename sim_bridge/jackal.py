"""The Jackal's facts and figures: geometry, mass, limits, laser, odometry.

Every number of the robot stands here once.

Read by both simulators, the lidar and the ROS bridge. Lengths [m], masses [kg], angles [rad], times [s].
Sources: Clearpath's URDF and control.yaml for the Jackal, and Gazebo's sensor settings for it.
"""

import numpy as np

# -- body -----------------------------------------------------------------------------------------
CHASSIS_SIZE = (0.420, 0.310, 0.184)
CHASSIS_MASS = 16.523
CHASSIS_COM = (0.012, 0.002, 0.067)  # of base_link; 12 mm ahead: why it does not turn about base_link
CHASSIS_INERTIA = (0.3136, 0.3922, 0.4485)
WHEEL_RADIUS = 0.098
WHEEL_WIDTH = 0.040
WHEEL_MASS = 0.477
WHEEL_INERTIA = (0.0013, 0.0024, 0.0013)  # about x, y (the axle) and z
WHEEL_FRICTION = 0.5
BODY_FRICTION = 0.5  # chassis against obstacles
TRACK = 0.37559
WHEELBASE = 0.262
AXLE_HEIGHT = 0.0345  # of the wheels' axles above base_link
BASE_HEIGHT = WHEEL_RADIUS - AXLE_HEIGHT  # of base_link above the ground
MASS = CHASSIS_MASS + 4 * WHEEL_MASS
COM = tuple(CHASSIS_MASS / MASS * value for value in CHASSIS_COM[:2])  # of the whole robot, in base_link
# its height above the ground
COM_HEIGHT = BASE_HEIGHT + (CHASSIS_MASS * CHASSIS_COM[2] + 4 * WHEEL_MASS * AXLE_HEIGHT) / MASS
YAW_INERTIA = (
    CHASSIS_INERTIA[2]
    + 4 * WHEEL_INERTIA[2]
    + 4 * WHEEL_MASS * (TRACK**2 + WHEELBASE**2) / 4
    + CHASSIS_MASS * (CHASSIS_COM[0] ** 2 + CHASSIS_COM[1] ** 2)
    - MASS * (COM[0] ** 2 + COM[1] ** 2)
)  # about COM
GRAVITY = 9.8

# The navigation parameters' footprint (unpadded), and the real outline that meets obstacles:
# the wheels reach further than the chassis, in front, behind and to the sides.
FOOTPRINT = np.array([(-0.21, -0.165), (-0.21, 0.165), (0.21, 0.165), (0.21, -0.165)])
BODY_HALF_LENGTH = WHEELBASE / 2 + WHEEL_RADIUS  # .229
BODY_HALF_WIDTH = TRACK / 2 + WHEEL_WIDTH / 2  # .208

# -- velocity controller (diff_drive_controller's limits) -----------------------------------------
MAX_SPEED = 2.0
MAX_ACCELERATION = 20.0
MAX_YAW_RATE = 4.0
MAX_YAW_ACCELERATION = 25.0
COMMAND_TIMEOUT = 0.25

# -- skid steering (skid_steer.py): what Gazebo's per-world figures are matched with -----
GRIP_LIMIT = 3.7  # the tyres hold curves up to this v w [m/s^2]; calibrated so far
TYRE_CREEP = 0.02  # slip speed at which a tyre has .7 of its full friction [m/s]
GRIP_NOISE, GRIP_TIME = 0.10, 0.5  # uneven ground: each wheel's friction, relative sd; time [s]
WHEEL_NOISE, WHEEL_TIME = 0.005, 0.5  # each side's speed, relative sd; correlation time [s]
WHEEL_SHAKE = 0.01  # each side's speed while it moves, absolute sd [m/s]

# -- laser ----------------------------------------------------------------------------------------
LASER_FRAME = "front_laser"
LASER_OFFSET = (0.12, 0.0)  # in base_link, looking ahead
LASER_HEIGHT = 0.333  # above base_link
BEAMS = 720
ANGLE_MIN = -2.35619
ANGLE_MAX = 2.35619
ANGLE_INCREMENT = (ANGLE_MAX - ANGLE_MIN) / (BEAMS - 1)
RANGE_MIN = 0.1
RANGE_MAX = 30.0
SCAN_NOISE = 0.001  # standard deviation [m]
SCAN_RATE = 50.0
ODOMETRY_RATE = 50.0

# -- odometry: wheel speeds for the distance, IMU for the heading, as robot_localization fuses them --
ODOM_SCALE_ERROR = 0.005  # standard deviation of the wheels' scale, drawn at reset
ODOM_HEADING_DRIFT = 0.002  # standard deviation of the heading's error [rad] ...
ODOM_HEADING_TIME = 60.0  # ... and its correlation time [s]
ODOM_HEADING_NOISE = 0.003  # and of what changes from one reading to the next [rad]
ODOM_SPEED_NOISE = 0.005  # of the speed given with the pose [m/s]
GYRO_NOISE = 0.005  # [rad/s]
ACCELEROMETER_NOISE = 0.005  # [m/s^2]
