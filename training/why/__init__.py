"""Why a robot stopped (./applr why): replay of a recorded drive, its events, their explanation and what would help."""
