"""Learning problem: Gymnasium environment, reward, settings of drives.

Importing this package registers the environment with Gymnasium under the name ID.
"""

from gymnasium.envs.registration import register

from applr_ros1.policy.decision import PERIOD

ID = "applr_ros1/Navigation-v0"
# By default the policy decides at the paper's period.
register(ID, entry_point="training.env.env:ApplrEnv", kwargs={"period": PERIOD})
