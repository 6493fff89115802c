"""Command-line programs: demo, playground, BARN Challenge, braking measurement, and their launcher."""
# Imports the same packages as the nodes.
