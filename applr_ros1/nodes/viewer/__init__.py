"""The node viewer: the robot, its planner and its parameters as a page in a browser, made with viser.

It subscribes to what the other nodes publish and calls what they offer to everybody.
"""
# Imports policy, robots and what nodes share.
