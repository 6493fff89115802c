"""Programs that a person starts beside the robot: demo, teleoperation, recording, RViz, the BARN Challenge."""
