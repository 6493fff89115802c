"""What several tests use: stand-ins for nodes and robots, slow reference implementations, made-up worlds and maps."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = ROOT / "tests" / "data"
HANGS = 600.0  # s after which a process counts as hanging: ten times what the longest takes on a quiet machine
