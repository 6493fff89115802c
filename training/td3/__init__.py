"""TD3 and its networks."""
# Imports common alone; knows neither replay nor robot.
