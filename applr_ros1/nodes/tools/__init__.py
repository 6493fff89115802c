"""Command-line programs: demo, playground, BARN Challenge, braking measurement, and their launcher."""
# Import rule: modules here may import the same packages as those in nodes/.
