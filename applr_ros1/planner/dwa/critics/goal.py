"""Critic "goal": the distance of the last point from the local goal."""

from applr_ros1.planner.dwa.critics.critic import Critic, GridReading
from applr_ros1.planner.dwa.records import GOAL
from applr_ros1.planner.sampling_planner import GOAL_TERM

CRITIC = Critic(
    GOAL_TERM._replace(
        name="goal", refusal="passes through cells from which the local goal cannot be reached"
    ),
    scale="goal_scale",
    value="its grid at the last point",
    refuses="as the critic above",
    grid=GridReading(GOAL, at_nose=False, refuses=True),
)
