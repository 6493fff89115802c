"""Workers that execute calls, behind the interface of concurrent.futures, and what an actor does in an environment.

pool.py executes in this process or hands out to workers: processes of this machine (process.py) or Ray actors (ray.py).
collector.py is a training episode, and the policy's weights; a trial is training/trials/runner.py.
"""
