"""A process that drives evaluation trials: `python -m training.evaluation.trial_worker FD`, started by trial_pool.py only.

A line of JSON in on stdin is a task, a line out on the file descriptor FD its answer. Closing stdin ends it, so it
never outlives the evaluation. What libraries print goes to stderr.
"""  # noqa: E501

from __future__ import annotations

import importlib
import json
import os
import signal
import sys
import traceback

THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def make(settings: dict):
    """The driver: {"driver": "module:Class", "simulator": name, "protocol": name}."""
    module, name = settings["driver"].split(":")
    return getattr(importlib.import_module(module), name)(settings["simulator"], settings["protocol"])


def answer(driver, message: dict) -> dict:
    """The driver's result for a task, or {"error": one line}."""
    from training.evaluation.trials import Task

    try:
        return driver.run(Task(**message))
    except Exception as error:  # the evaluation must hear of it, whatever it is
        what = "trial %s of %s in %s failed: " % (message["trial"], message["method"], message["world"])
        return failure(what, error)


def failure(what: str, error: Exception) -> dict:
    line = (str(error).splitlines() or [""])[0]
    if not isinstance(error, (ValueError, OSError)):
        line = "%s: %s" % (type(error).__name__, line)
        traceback.print_exc()  # ours to mend, so ours to see
    return {"error": what + line}


def main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the evaluation, which ends this process
    out = os.fdopen(int(sys.argv[1]), "w")
    os.dup2(2, 1)
    driver = broken = None
    for line in sys.stdin:
        message = json.loads(line)
        if "simulator" in message:
            try:
                driver, broken = make(message), None
            except Exception as error:
                broken = failure("simulator %s cannot start: " % message["simulator"], error)
            continue
        out.write(json.dumps(broken or answer(driver, message)) + "\n")
        out.flush()


if __name__ == "__main__":
    main()
