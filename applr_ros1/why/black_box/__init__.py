"""The black box: keeps the last minutes in memory, finds stops, writes bags, and asks why."""
