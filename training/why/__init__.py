"""Why a robot stopped (./applr why): replay of a recorded drive, its events, and remedies."""
