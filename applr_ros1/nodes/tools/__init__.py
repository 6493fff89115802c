"""Programs that a person starts beside the robot: the launcher, the demo, the BARN Challenge, braking."""
# Imports what the nodes import.
