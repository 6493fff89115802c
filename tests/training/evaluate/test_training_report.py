"""Tests of the report: statistics by hand, the paper's tables from synthetic trials, every output
file.
"""

import html
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from applr_ros1.common.errors import ApplrError
from applr_ros1.policy.parameter_space import SPACE
from tests.support.browser import focused, needs_browser, opened
from tests.support.drives import driven
from tests.support.runs import SETTINGS
from training.evaluate import tables
from training.evaluate.compare import LEVEL, compare, over_worlds, rate, wilson
from training.evaluate.profiles import LIMITS, profiles
from training.evaluate.report import summary, write
from training.evaluate.stored import Results
from training.evaluate.table import Trials
from training.evaluate.tables import Table
from training.evaluate.trial import Result, plan_trials
from worlds import load as load_world
from worlds.world import clearance

METHODS = ("dwa", "applr", "other")


POSE = np.column_stack([np.full(200, -2.0), np.linspace(4.1, 10.0, 200), np.full(200, 1.57)])
TRACE = driven(
    np.arange(200) * 0.05,
    POSE,
    theta=[SPACE.theta0, SPACE.high, SPACE.theta0, SPACE.theta0, SPACE.high],
    decided=np.arange(5) * 2.0,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return an evaluation of three methods, six trials in each of 40 worlds. applr is 25 % faster,
    dwa may fail.
    """
    out = tmp_path_factory.mktemp("evaluation")
    worlds = ["generated:%d" % n for n in range(0, 39)] + ["physical_course"]
    plan = plan_trials([(w, w) for w in worlds], [(m, m) for m in METHODS], 6, seed=0)
    settings = dict(
        SETTINGS, worlds=worlds, world_specs=worlds, simulator="kinematic", protocol="paper", seed=0
    )
    learnt = {"applr": {"class": "Actor"}, METHODS[2]: {"class": "Actor"}}
    settings["methods"] = {"dwa": {"parameters": {"max_vel_x": 0.5}}, **learnt}
    store = Trials(out, settings)
    rng = np.random.default_rng(1)
    for task in plan:
        mean = 20.0 + 0.4 * worlds.index(task.world)
        mean *= {"dwa": 1.0, "applr": 0.75}.get(task.method, 0.85)
        good = (
            rng.random() < (0.95 if task.method == "dwa" else 0.99) and task.world != "generated:3"
        )
        seconds = round(mean * math.exp(rng.normal(0, 0.08)), 4) if good else 100.0
        reason = "finished" if good else "time limit"
        decisions = math.ceil(seconds / 2)
        result = Result(
            good, False, not good, seconds, decisions, 6.5, reason, 7.0, 0.3, 5.0, 1.0, 0.1
        )
        traced = task.trace and task.world in ("generated:20",)
        store.add(task, result, TRACE.pack() if traced else b"")
    session = {
        "date": "2026-01-02",
        "commit": "abc",
        "cpu": "a processor",
        "cores": 4,
        "command": "evaluate.py",
    }
    store.note(wall_s=75.0, provenance=[dict(session, versions={"numpy": "2"})], workers=2)
    return out


@pytest.fixture(scope="module")
def results(folder):
    return Results(folder)


# -- statistics ------------------------------------------------------------------------------------
def test_welch_is_scipys_with_nan_in_edge_cases():
    rng = np.random.default_rng(0)
    a = rng.normal(20, 3, 20)
    b = rng.normal(23, 5, 18)
    equal = np.full(2, 5.05), np.full(20, 5.05)  # The two means differ in the last bit.

    def trials(*times):
        rows = [
            (world, n, time, True)
            for world, of_world in enumerate(times)
            for n, time in enumerate(of_world)
        ]
        return pd.DataFrame(
            [*rows, (0, 99, 1.0, False)], columns=["world", "trial", "time_s", "success"]
        )

    tests = tables.welch(trials(a, a[:1], equal[0]), trials(b, b, equal[1], b))
    assert tests.p[0] == pytest.approx(stats.ttest_ind(a, b, equal_var=False).pvalue)
    assert np.isnan(tests.p).tolist() == np.isnan(tests.holm).tolist() == [False, True, True]
    assert (tables.significant(tests), tables.significant(tests, "holm")) == ((1, 0), (1, 0))


def test_holm_by_hand():
    p = np.array([0.01, 0.04, 0.03, 0.005])
    below = tables.holm_adjusted(p) < 0.05  # .005 < .0125, .01 < .0167, .03 >= .025
    assert below.tolist() == [True, False, False, True]
    assert tables.holm_adjusted(p) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert tables.holm_adjusted(np.zeros(0)).tolist() == []


def test_wilson_by_known_values():
    assert wilson(0.0, 10) == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert wilson(0.0, 94)[0] == 0.0, "not -0"
    assert wilson(0.9, 10) == pytest.approx((0.5958, 0.9821), abs=1e-4)


def test_equal_trials_of_a_world_count_as_one():
    worlds = pd.Series(np.repeat(np.arange(20), 6))
    assert rate(worlds % 2 == 0, worlds) == pytest.approx((0.5, *wilson(0.5, 19)))
    apart = pd.Series(np.arange(120) % 2 == 0)
    assert rate(apart, worlds) == pytest.approx((0.5, *wilson(0.5, 120)))


def test_the_bootstrap_resamples_worlds_not_trials():
    """Ten worlds with 100 equal trials each have the interval of ten trials: 1.96 standard
    errors.
    """
    means = np.linspace(10.0, 30.0, 10)
    half = 1.96 * means.std() / math.sqrt(10)
    estimate = over_worlds(means * 100, np.full(10, 100.0))
    assert estimate == pytest.approx((20.0, 20.0 - half, 20.0 + half), abs=0.3)
    assert over_worlds(means) == pytest.approx(estimate)


def test_the_paired_test_is_of_the_mean_by_hand():
    """Eight of the 16 sign patterns of 9, 5, -1 and -1 have a sum of at least 12 or at most -12;
    ranks give .625.
    """
    comparison = compare([29.0, 25.0, 19.0, 19.0], [20.0] * 4)
    assert (comparison.worlds, comparison.p) == (4, 8 / 16)
    assert (comparison.difference.value, comparison.gain.value) == (3.0, -0.15)
    alone = compare([10.0], [20.0])
    assert (alone.worlds, alone.gain.value) == (1, 0.5)
    assert np.isnan([alone.p, alone.gain.low, alone.difference.high]).all()


def test_better_is_a_smaller_mean_with_a_significant_difference():
    def is_better(scores):
        return compare(scores, [20.0] * len(scores)).better(LEVEL)

    assert is_better([10.0] * 6)
    assert not is_better([30.0] * 6)
    assert not is_better([10.0] * 3), "p = .25"


def test_a_line_of_the_report_names_arrivals_times_and_the_test(results):
    line, _ = summary(results)
    test = results.of_set("Test")
    trials = results.trials[results.trials.world.isin(test)].set_index(["world", "trial"])
    success = {name: trials.success[trials.method == name] for name in METHODS[:2]}
    both = success["dwa"] & success["applr"]
    times = [trials.time_s[trials.method == name][both].mean() for name in ("applr", "dwa")]
    arrive = f"{success['applr'].sum()} of {len(both)} arrive (dwa: {success['dwa'].sum()})"
    change = f"{times[0]:.1f} s instead of {times[1]:.1f} s where both arrive ({both.sum()} drives)"
    assert line.startswith(f"applr better: yes, {arrive}; {change}; p = ")


# -- tables ----------------------------------------------------------------------------------------


def test_table_4_names_failures(results):
    table = tables.table_4(results)
    assert table.rows.method.tolist() == list(METHODS)
    assert (
        table.rows.failures.str.contains("time limit") != table.rows.successes.str.startswith("6")
    ).all()
    assert table.rows["paper [s]"][0].startswith("72.8")


def test_a_failure_counts_as_the_time_limit_however_early_it_is(tmp_path):
    """A method that hits something after 3 s in every trial does not beat one that arrives after 20
    s.
    """
    worlds = ["generated:%d" % n for n in range(1, 7)]
    plan = plan_trials([(w, w) for w in worlds], [("dwa", "dwa"), ("crash", "dwa")], 2, seed=0)
    store = Trials(tmp_path, dict(SETTINGS, worlds=worlds, protocol="barn-challenge"))
    for trial in plan:
        # The baseline fails in the first world, too.
        good = trial.method == "dwa" and trial.world != worlds[0]
        seconds, reason = (
            (20.0 + worlds.index(trial.world), "finished") if good else (3.0, "contact")
        )
        result = Result(good, not good, False, seconds, 2, 6.0, reason, *[math.nan] * 5)
        store.add(trial, result)
    results = Results(tmp_path)
    comparison = results.compare("crash", "dwa", worlds[1:])
    assert comparison.difference.value == pytest.approx(100.0 - 23.0)
    # Two of all sign patterns have such a large difference.
    assert comparison.p == 2 / 2**5
    assert results.by_difficulty(worlds) == [*worlds[1:], "generated:1"]
    rows = tables.table_3(results).rows.set_index("worlds")
    # Mean of 25 s and 100 s.
    assert rows["dwa mean time, all trials [s]"]["Difficult All"] == "62.50"


def test_means_are_compared_over_the_same_worlds(folder):
    """One of the methods was driven in only some of the worlds."""
    joined = Results(folder)
    easy = joined.of_set("Test")[:4]
    joined.trials = joined.trials[
        (joined.trials.method != METHODS[2]) | joined.trials.world.isin(easy)
    ]
    base, other = (joined.of(method, easy).score.mean() for method in ("dwa", METHODS[2]))
    rows = tables.table_1(joined).rows.set_index(["worlds", "method"])
    assert float(rows["faster than dwa [s]"]["Test", METHODS[2]]) == pytest.approx(
        base - other, abs=0.006
    )


def test_text_is_escaped_in_html():
    text = Table(
        "t", "a & b", pd.DataFrame([{"x_1": "50 %", "y": "<b> | ±" * 20}]), ["note: θ"]
    ).html()
    assert "&lt;b&gt; | ±" * 20 in text
    assert "a &amp; b" in text


# -- whole reports ---------------------------------------------------------------------------------
def test_the_report_is_complete(folder):
    page = write(folder)
    out = folder / "report"
    text = Path(page).read_text(encoding="utf-8")
    for name in ("table_1", "table_2", "table_3", "table_4", "pairs", "rates", "methods"):
        assert (out / ("%s.csv" % name)).stat().st_size > 0
    assert "Wall time 01:15; base seed 0" in text
    assert "kinematic" in text
    assert "nan" not in text
    assert len(re.findall(r'<div class="wide[^>]*><table', text)) == text.count("<table") == 7
    lines = [html.unescape(text).index(line) for line in summary(Results(folder))]
    assert lines == sorted(lines)
    assert (
        text.index('class="verdict"')
        < lines[0]
        < lines[-1]
        < text.index('<div id="times">')
        < text.index('<div id="profiles">')
        < text.index("<table")
        < text.index('<a href="drives.html">')
    )
    assert "Planner: ours." in text
    assert (
        "Driven on 2026-01-02 with commit abc on a processor (4 cores); numpy 2. Command: "
        "evaluate.py" in text
    )


@needs_browser
def test_the_figure_of_the_report_says_by_keyboard_what_each_point_is(folder):
    with opened(Path(write(folder))) as view:
        slider = focused(view, "slider", "World of the group Test")
        words = view.locator("#times figure").last.locator("p")
        first = words.inner_text()
        slider.press("ArrowRight")
        second = words.inner_text()
    assert first != second
    for text in (first, second):
        assert all(re.search(rf"{method} (\d+\.\d s|never arrives)", text) for method in METHODS)


def test_a_profile_has_the_room_around_each_pose(folder):
    (first, second) = profiles(Results(folder))["drawn"]
    assert [first["method"], second["method"]] == ["applr", "other"], "dwa's set is constant"
    (drive,) = first["world"]["drives"]
    assert first["world"]["name"] == "generated:20"
    poses = np.cumsum(drive["p"], axis=0) / 100.0
    room = clearance(load_world("generated:20"), poses[:, :2])
    is_sure = np.abs(room[:, None] - np.array(LIMITS)).min(axis=1) > 0.01
    regions = np.array(first["regions"])
    assert regions[is_sure].tolist() == np.digitize(room, LIMITS)[is_sure].tolist()
    assert len(set(first["regions"])) > 1


@needs_browser
def test_keys_choose_a_profile_and_move_along_it(folder):
    with opened(Path(write(folder))) as view:
        box = view.locator("#profiles")
        chosen = focused(view, "combobox", "Method and world of the profile")
        options = chosen.get_by_role("option").all_inner_texts()
        assert options == ["applr in generated:20", "other in generated:20"]
        chosen.press("ArrowDown")
        assert box.get_by_text("max_vel_x: 0.5").count()
        slider = focused(view, "slider", "Time in seconds")
        slider.press("End")
        assert box.get_by_text("10.0 of 10.0 s").count()
        assert box.get_by_text("max_vel_x: 2").count()


def test_without_traces_there_is_no_profile(tmp_path):
    plan = plan_trials([("house", "generated:7")], [("mine", "dwa")], 1, seed=0)
    store = Trials(tmp_path, dict(SETTINGS, worlds=["house"], world_specs=["generated:7"]))
    store.add(plan[0], Result(True, False, False, 9.0, 5, 3.0, "", *[math.nan] * 5))
    assert profiles(Results(tmp_path)) == {}


def test_report_of_one_method_and_one_world(tmp_path):
    plan = plan_trials([("house", "generated:7")], [("mine", "dwa")], 1, seed=0)
    store = Trials(tmp_path, dict(SETTINGS, worlds=["house"], world_specs=["generated:7"]))
    result = Result(False, True, True, 100.0, 50, 3.0, "time limit", *[math.nan] * 5)
    store.add(plan[0], result, TRACE.pack())
    text = Path(write(tmp_path)).read_text(encoding="utf-8")
    assert "paper [" not in text
    assert "paper&#x27;s numbers" not in text


def test_nothing_to_report_is_one_line(tmp_path):
    with pytest.raises(ApplrError, match="no trials"):
        write(tmp_path)


def test_clearance_of_a_world():
    world = load_world("generated:7")
    assert clearance(world, np.array([[-2.25, 12.0]]))[0] > 1.0
    post = world.cylinders[np.argmin(world.cylinders[:, 1])]
    near = post[:2] + (0.0, -0.35 - post[2])  # .35 m from the foremost post's surface
    assert clearance(world, near[None])[0] == pytest.approx(0.35)
