"""Learning: the meta-environment, TD3, actors and learner, datasets, evaluation and reports."""

from applr_ros1.common import interrupts

if interrupts.is_starting():
    interrupts.make_quiet()
