"""The paper's tables and figures from the folder of an evaluation.

Started as `python -m training.report results/`; evaluate.py calls page.write when its trials are done. Everything is
written to results/report/, with an index.html that shows it all.
"""
