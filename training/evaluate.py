"""Evaluation: drives every method in every world, and makes tables, figures and statistics of the trials.

Started as `rosrun applr_ros1 evaluate.py` or `python -m training.evaluate`. An evaluation that was stopped continues
with the same command, and its rows are the same as without the stop. docs/evaluation.md describes the results.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import signal
import sys
import time
from typing import Any, Dict, List, Sequence

import sim_bridge
from applr_ros1.common.arguments import without_remappings
from applr_ros1.common.errors import UsageError, run_main
from applr_ros1.planner.variant import DEFAULT_WEIGHTS, DRAWN, OURS, PLANNERS, WEIGHTS
from applr_ros1.policy import methods
from training.evaluation.store import TRIALS, Store
from training.evaluation.trial_pool import Processes, RayActors
from training.evaluation.trials import PROTOCOLS, Task, plan, world_list

AHEAD = 8  # finished trials held back per worker, until those before them are done too
RETRIES = 2  # times a trial is driven again after its worker died


def main(arguments: Sequence[str] = None) -> int:
    """Exit status 0 when all trials are done and reported; 1 and one line on stderr otherwise; 130 after Ctrl-C."""
    signal.signal(signal.SIGTERM, _interrupt)
    return run_main(lambda: run(parse(arguments)), "evaluate.py")


def run(options: argparse.Namespace) -> int:
    worlds = world_list(options.worlds, options.protocol)
    chosen = methods.parse(options.methods)
    names = [w[:2] for w in worlds]
    tasks = plan(names, chosen, options.trials, options.seed, options.traces, options.weights, options.planner)
    store = Store(options.out, settings(options, worlds, chosen), tasks)
    try:
        if store.done < len(tasks):
            drive(tasks, store, options)
    except KeyboardInterrupt:
        raise KeyboardInterrupt("stopped; the same command continues") from None
    finally:
        store.close()
    print("%d trials in %s" % (len(tasks), os.path.join(options.out, TRIALS)))
    if options.report:
        from training.report import write

        print("report: %s" % write(options.out))
    return 0


def settings(options, worlds, chosen) -> Dict[str, Any]:
    """What must not change when an evaluation is continued: goes into evaluation.json."""
    digest = hashlib.sha256()
    for name, _, world in worlds:
        for part in (world.cylinders, world.boxes, world.course.path):
            digest.update(part.tobytes())
        digest.update(repr((name, world.course.start, world.course.goal, world.movers)).encode())
    return {
        "worlds": [name for name, _, _ in worlds],
        "worlds_sha256": digest.hexdigest(),
        "world_specs": [spec for _, spec, _ in worlds],
        "methods": {name: methods.make(spec).describe() for name, spec in chosen},
        "simulator": options.simulator,
        "protocol": options.protocol,
        "weights": options.weights,
        "planner": options.planner,
        "seed": options.seed,
    }


def drive(tasks: List[Task], store: Store, options) -> None:
    """Drives what is missing, and appends it in the plan's order."""
    from tqdm import tqdm

    began = time.monotonic()
    pool_settings = {"driver": options.driver, "simulator": options.simulator, "protocol": options.protocol}
    workers = min(options.workers, len(tasks) - store.done)
    pool = (
        RayActors(workers, pool_settings, options.ray_address)
        if options.ray_address
        else Processes(workers, pool_settings)
    )
    bar = tqdm(total=len(tasks), initial=store.done, unit="trial", dynamic_ncols=True, smoothing=0.05)
    try:
        for answer in in_order(tasks, store.done, pool, workers):
            store.append(answer)
            bar.update()
            bar.set_postfix_str(" ".join(answer["row"][:2] + [_said(answer)]), refresh=False)
    finally:
        bar.close()
        pool.close()
        store.finish(time.monotonic() - began, workers=workers, trials=options.trials)


def in_order(tasks: List[Task], first: int, pool, workers: int):
    """Yields the answers to tasks[first:], each as soon as all before it are there. UsageError if a trial fails."""
    free, given, ready, retries = list(range(workers)), {}, {}, {}
    again: List[int] = []
    next_task = next_out = first
    while next_out < len(tasks):
        while free and (again or (next_task < len(tasks) and next_task < next_out + AHEAD * workers + 1)):
            number = again.pop(0) if again else next_task
            next_task += number == next_task
            slot = free.pop()
            given[slot] = number
            pool.give(slot, tasks[number]._asdict())
        for slot, answer in pool.wait():
            number = given.pop(slot, None)
            free.append(slot)
            if number is None:  # a new worker that died while it had nothing to do
                raise UsageError("a worker died before its first trial; see its messages above")
            if answer is None:
                retries[number] = retries.get(number, 0) + 1
                if retries[number] > RETRIES:
                    task = tasks[number]
                    raise UsageError(
                        "trial %s of %s in %s ended its worker %d times; see the messages above"
                        % (task.trial, task.method, task.world, retries[number])
                    )
                again.append(number)
            elif "error" in answer:
                raise UsageError(answer["error"])
            else:
                ready[number] = answer
        while next_out in ready:
            yield ready.pop(next_out)
            next_out += 1


def _said(answer) -> str:
    row = answer["row"]
    return "%s s" % row[7] if row[4] == "True" else answer["measures"][4]


def _interrupt(*_):
    raise KeyboardInterrupt


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Checked options. ROS remapping arguments (name:=value) are ignored. Raises UsageError."""
    p = _Parser(
        prog="evaluate.py",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        description=__doc__,
        epilog="methods:\n%s\n\nprotocols:\n%s\n\na method of your own:\n%s"
        % (
            "\n".join("  %-16s %s" % (n, m[1]) for n, m in methods.METHODS.items()),
            "\n".join("  %-16s %s" % (n, v.sentence) for n, v in PROTOCOLS.items()),
            methods.__doc__.split("\n\n", 1)[1],
        ),
    )
    p.add_argument(
        "--worlds",
        default="generated:test",
        help=(
            "Worlds to drive in: generated:N, generated:train, generated:test, fresh:N-M, physical_course, a "
            ".world file or a folder of them; several are separated by commas. Default: %(default)s."
        ),
    )
    p.add_argument(
        "--methods",
        default="dwa,applr",
        help="Methods to compare, separated by commas: %s. Default: dwa,applr." % methods.FORMS,
    )
    p.add_argument(
        "--trials",
        type=_whole(1, 100_000),
        default=20,
        help="Number of trials of each method in each world. Default: %(default)s.",
    )
    p.add_argument(
        "--simulator",
        choices=sim_bridge.NAMES,
        default="pybullet",
        help="Simulator to drive in. Default: %(default)s.",
    )
    p.add_argument(
        "--protocol",
        choices=tuple(PROTOCOLS),
        default="paper",
        help="Rules of a trial, described below. Default: %(default)s.",
    )
    p.add_argument(
        "--weights",
        type=_kinds,
        default=[DEFAULT_WEIGHTS],
        help="What the distance weights of the planner count, metres or cells: %s, or %s for one of them in each world "
        "and trial. With several, separated by commas, everything is driven with each, and trials.csv gets a column "
        "weights. Default: %s." % (", ".join(WEIGHTS), DRAWN, DEFAULT_WEIGHTS),
    )
    p.add_argument(
        "--planner",
        choices=PLANNERS + (DRAWN,),
        default=OURS,
        help="Planner to drive with: ours, cpp-like with the defects of the C++ move_base that success depends on, or "
        "drawn for one of them in each world and trial. Default: %s." % OURS,
    )
    p.add_argument(
        "--workers",
        type=_whole(1, 4096),
        default=2,
        help="Number of trials that are driven at the same time, in processes or Ray actors. Default: %(default)s.",
    )
    p.add_argument(
        "--ray-address",
        default="",
        help="Address HOST:PORT of a Ray cluster to drive on, or auto for one that runs on this machine.",
    )
    p.add_argument(
        "--out",
        default="results",
        help=(
            "Folder for trials.csv, tables and figures. An evaluation that it holds already is continued. "
            "Default: %(default)s."
        ),
    )
    p.add_argument(
        "--seed",
        type=_whole(0, 2**31 - 1),
        default=0,
        help="Seed from which the seeds of all trials follow. Default: %(default)s.",
    )
    p.add_argument(
        "--traces",
        type=_whole(0, 1000),
        default=1,
        help="Number of trials of each method in each world whose driven path is stored. Default: %(default)s.",
    )
    p.add_argument("--driver", default="training.evaluation.trials:Driver", help=argparse.SUPPRESS)  # tests give a toy
    p.add_argument(
        "--no-report", dest="report", action="store_false", help="Write the trials alone, without tables and figures."
    )
    return p.parse_args(without_remappings(arguments))


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise UsageError("%s; --help lists all options" % message)


def _kinds(text: str) -> List[str]:
    kinds = text.split(",")
    for kind in kinds:
        if kind not in WEIGHTS + (DRAWN,):
            raise argparse.ArgumentTypeError(
                "%r is no kind of weights: give %s or %s" % (kind, ", ".join(WEIGHTS), DRAWN)
            )
    if len(set(kinds)) < len(kinds):
        raise argparse.ArgumentTypeError("%r names one twice" % text)
    return kinds


def _whole(low: int, high: int):
    def convert(text: str) -> int:
        try:
            value = int(text)
        except ValueError:
            raise argparse.ArgumentTypeError("%r is no whole number" % text) from None
        if not low <= value <= high:
            raise argparse.ArgumentTypeError("%d is out of range: give %d to %d" % (value, low, high))
        return value

    return convert


if __name__ == "__main__":
    sys.exit(main())
