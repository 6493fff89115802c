"""Best-first search of both local planners: the loop, and lower bounds from closed forms.

Each planner keeps its samples, its costs and its choice of a command. See
docs/explanation/planner.md, section 6.4.
"""
