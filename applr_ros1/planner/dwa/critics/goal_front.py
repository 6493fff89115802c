"""Critic "nose to goal": the distance of the robot's nose from the goal ahead of the nose."""

from applr_ros1.planner.dwa.critics.critic import Critic, GridReading
from applr_ros1.planner.dwa.records import FRONT
from applr_ros1.planner.sampling_planner import CostTerm

CRITIC = Critic(
    CostTerm(
        name="goal_front",
        title="nose to goal",
        parameter="goal_distance_bias",
        objection="takes the robot's nose farther away from the local goal",
        refusal="takes the robot's nose off the local costmap",
    ),
    scale="goal_scale",
    value="its grid at the last point's nose",
    refuses="-4: a nose off the map",
    grid=GridReading(FRONT, at_nose=True, refuses=False),
)
