"""Command-line programs: demo, playground, BARN Challenge, braking measurement, and their launcher."""
