"""The learning algorithm TD3 and its networks. Knows neither replay nor robot."""
