"""The paper's tables and figures from the folder of an evaluation.

evaluate.py calls page.write when its trials are done, and when it is started again. Everything is written to
results/report/, with an index.html that shows it all.
"""
