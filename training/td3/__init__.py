"""TD3 and its networks."""
# Imports only common. Knows neither the replay buffer nor robots.
