"""The paper's tables and figures from an evaluation's folder: `python -m training.report results/`. evaluate.py calls
`write` when its trials are done; everything lands in results/report/, with index.html to look at it all.
"""

from training.report.page import ReportError, write

__all__ = ["ReportError", "write"]
