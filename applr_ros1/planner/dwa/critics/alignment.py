"""Critic "nose on path": the distance of the robot's nose from the path, except near its end."""

from applr_ros1.planner.dwa.critics.critic import Critic, GridReading
from applr_ros1.planner.dwa.records import ALIGNMENT
from applr_ros1.planner.sampling_planner import CostTerm

CRITIC = Critic(
    CostTerm(
        name="alignment",
        title="nose on path",
        parameter="path_distance_bias",
        objection="takes the robot's nose farther away from the plan",
        refusal="takes the robot's nose off the local costmap",
    ),
    scale="alignment_scale",
    value="its grid at the last point's nose",
    refuses="-4: a nose off the map",
    grid=GridReading(ALIGNMENT, at_nose=True, refuses=False),
)
