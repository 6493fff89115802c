"""Workers that drive episodes and trials: a pool of them (pool.py, ray.py), and a training episode (collect.py)."""
