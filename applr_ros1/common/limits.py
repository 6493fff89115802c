"""What several packages bound alike: the planner its costmaps, the nodes the maps that they take, `worlds` its own."""

MAX_CELLS = 16_000_000  # of one map, 200 x 200 m at .05 m; a larger one is refused instead of filling the memory
