"""Command-line programs: demo, playground, BARN Challenge, braking measurement, launcher."""
