"""Critic "path": the distance of the last point from the path."""

from applr_ros1.planner.dwa.critics.critic import Critic, GridReading
from applr_ros1.planner.dwa.records import PATH
from applr_ros1.planner.sampling_planner import PATH_TERM

CRITIC = Critic(
    PATH_TERM._replace(
        name="path", refusal="passes through cells from which the plan cannot be reached"
    ),
    scale="path_scale",
    value="its grid at the last point",
    refuses="-3: a point in a wall; -2: a point that no flood reached; -4: a point off the map",
    grid=GridReading(PATH, at_nose=False, refuses=True),
)
