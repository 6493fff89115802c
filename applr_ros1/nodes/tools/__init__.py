"""Programs that a person starts beside the robot: demo, recording, RViz, the BARN Challenge."""
