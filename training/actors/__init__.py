"""Workers that do tasks one after the other, in this process, in child processes or as Ray actors: one interface.

tasks.py says what travels, worker.py does tasks, pool.py hands them out, local.py and ray.py are the two kinds of
parallel workers. What a task means is defined by its runner: collector.py for training episodes,
training/evaluation/trials.py for trials.
"""
