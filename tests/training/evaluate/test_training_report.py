"""Tests of the report: statistics by hand, the paper's tables of synthetic trials, all files."""

import html
import math
import re
from dataclasses import replace
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
from training.attempts.verdict import (
    LEVEL,
    Comparison,
    Estimate,
    compare,
    over_worlds,
    rate,
    wilson,
)
from training.evaluate import paper, report, tables
from training.evaluate import verdict as judging
from training.evaluate.profiles import LIMITS, profiles
from training.evaluate.report import summary, write
from training.evaluate.stored import Results, set_of
from training.evaluate.table import TrialTable
from training.evaluate.tables import Table
from training.evaluate.trial import Result, plan_trials
from worlds import load as load_world
from worlds.world import clearance

METHODS = ("dwa", "applr", "other")
# Shares of successful trials, and mean times relative to dwa
SUCCESS_RATES = {"dwa": 0.95, "applr": 0.99, "other": 0.99}
RELATIVE_TIMES = {"dwa": 1.0, "applr": 0.75, "other": 0.85}
TIME_LIMIT_S = 100.0
HARD_WORLD = "generated:3"  # world in which all methods fail
TRACED_WORLD = "generated:20"
SESSION = {
    "date": "2026-01-02",
    "commit": "abc",
    "cpu": "a processor",
    "cores": 4,
    "command": "evaluate.py",
    "versions": {"numpy": "2"},
}

# x, y, yaw [m, m, rad]
POSE = np.column_stack([np.full(200, -2.0), np.linspace(4.1, 10.0, 200), np.full(200, 1.57)])
TIME = 0.05 * np.arange(200)
SETS = [SPACE.theta0, SPACE.high, SPACE.theta0, SPACE.theta0, SPACE.high]
TRACE = driven(TIME, POSE, theta=SETS, decided=2.0 * np.arange(5))
# A result of a trial without measurements, as of a robot whose drives have none
NOT_MEASURED = Result(
    decisions=2,
    path_length_m=6.0,
    route_m=math.nan,
    min_clearance_m=math.nan,
    mean_jerk=math.nan,
    mean_turn=math.nan,
    switching=math.nan,
)


def named(*names):
    """Return [(name, specification), ...] of worlds or methods."""
    return [(name, name) for name in names]


def random_result(method, world, mean_s, rng):
    """Return the result of a trial, with a time around `mean_s` [s] if it succeeds."""
    success = rng.random() < SUCCESS_RATES[method] and world != HARD_WORLD
    seconds = TIME_LIMIT_S
    reason = "time limit"
    if success:
        seconds = round(mean_s * math.exp(rng.normal(0, 0.08)), 4)
        reason = "finished"
    return Result(
        success=success,
        timeout=not success,
        time_s=seconds,
        decisions=math.ceil(seconds / 2),
        path_length_m=6.5,
        reason=reason,
        route_m=7.0,
        min_clearance_m=0.3,
        mean_jerk=5.0,
        mean_turn=1.0,
        switching=0.1,
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return an evaluation of three methods, six trials in each of 40 worlds."""
    evaluation_folder = tmp_path_factory.mktemp("evaluation")
    worlds = [f"generated:{number}" for number in range(39)]
    worlds.append("physical_course")
    methods = {
        "dwa": {"parameters": {"max_vel_x": 0.5}},
        "applr": {"class": "Actor"},
        "other": {"class": "Actor"},
    }
    settings = dict(
        SETTINGS,
        worlds=worlds,
        world_specs=worlds,
        simulator="kinematic",
        protocol="paper",
        seed=0,
        methods=methods,
    )
    store = TrialTable(evaluation_folder, settings)
    rng = np.random.default_rng(1)
    for trial in plan_trials(named(*worlds), named(*METHODS), trials=6, seed=0):
        mean_s = RELATIVE_TIMES[trial.method] * (20.0 + 0.4 * worlds.index(trial.world))
        result = random_result(trial.method, trial.world, mean_s, rng)
        has_trace = trial.trace and trial.world == TRACED_WORLD
        store.add(trial, result, TRACE.pack() if has_trace else b"")
    store.note(wall_s=75.0, provenance=[SESSION], workers=2)
    return evaluation_folder


@pytest.fixture(scope="module")
def results(folder):
    """Return the stored evaluation as the report reads it."""
    return Results(folder)


# -- statistics ------------------------------------------------------------------------------------
def test_welch_is_scipys_with_nan_in_edge_cases():
    rng = np.random.default_rng(0)
    fast_times = rng.normal(20, 3, 20)
    slow_times = rng.normal(23, 5, 18)
    single_time = fast_times[:1]
    # The means of these differ in the last bit.
    two_equal = np.full(2, 5.05)
    twenty_equal = np.full(20, 5.05)

    def trials(*worlds):
        """Return successful trials with the times [s] of each world, and a failure."""
        rows = [(0, 99, 1.0, False)]
        for world, times in enumerate(worlds):
            for number, time_s in enumerate(times):
                rows.append((world, number, time_s, True))
        return pd.DataFrame(rows, columns=["world", "trial", "time_s", "success"])

    tests = tables.welch(
        trials(fast_times, single_time, two_equal),
        trials(slow_times, slow_times, twenty_equal, slow_times),
    )

    scipys_test = stats.ttest_ind(fast_times, slow_times, equal_var=False)
    assert tests.p[0] == pytest.approx(scipys_test.pvalue)
    assert np.isnan(tests.p).tolist() == [False, True, True]
    assert np.isnan(tests.holm).tolist() == [False, True, True]
    assert tables.significant(tests) == (1, 0)
    assert tables.significant(tests, "holm") == (1, 0)


def test_holm_by_hand():
    p = np.array([0.01, 0.04, 0.03, 0.005])
    adjusted_p = tables.holm_adjusted(p)
    assert adjusted_p == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert tables.holm_adjusted(np.zeros(0)).tolist() == []


def test_wilson_by_known_values():
    assert wilson(0.0, 10) == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert wilson(0.0, 94)[0] == 0.0, "not -0"
    assert wilson(0.9, 10) == pytest.approx((0.5958, 0.9821), abs=1e-4)


def test_equal_trials_of_a_world_count_as_one():
    worlds = pd.Series(np.repeat(np.arange(20), 6))
    assert rate(worlds % 2 == 0, worlds) == pytest.approx((0.5, *wilson(0.5, 19)))
    unequal = pd.Series(np.arange(120) % 2 == 0)
    assert rate(unequal, worlds) == pytest.approx((0.5, *wilson(0.5, 120)))
    # Every trial counts once, however many its world has.
    one_and_three = pd.Series([0, 1, 1, 1])
    assert rate(one_and_three == 0, one_and_three).value == 0.25


def test_the_bootstrap_resamples_worlds_not_trials():
    """Ten worlds with 100 equal trials each have the interval of ten trials, 1.96 deviations."""
    means = np.linspace(10.0, 30.0, 10)
    half_width = 1.96 * means.std() / math.sqrt(10)
    estimate = over_worlds(means * 100, np.full(10, 100.0))
    expected = (20.0, 20.0 - half_width, 20.0 + half_width)
    assert estimate == pytest.approx(expected, abs=0.3)
    assert over_worlds(means) == pytest.approx(estimate)


def test_the_paired_test_is_of_the_mean_by_hand():
    """The differences are 9, 5, -1 and -1, whose sum is 12.

    Eight of the 16 sign patterns have a sum of at least 12 or at most -12. Ranks give .625.
    """
    comparison = compare([29.0, 25.0, 19.0, 19.0], [20.0] * 4)
    assert comparison.worlds == 4
    assert comparison.p == 8 / 16
    assert comparison.difference.value == 3.0
    assert comparison.gain.value == -0.15

    alone = compare([10.0], [20.0])
    assert alone.worlds == 1
    assert alone.gain.value == 0.5
    assert np.isnan([alone.p, alone.gain.low, alone.difference.high]).all()


def test_better_is_a_smaller_mean_with_a_significant_difference():
    def is_better(scores):
        return compare(scores, [20.0] * len(scores)).better(LEVEL)

    assert is_better([10.0] * 6)
    assert not is_better([30.0] * 6)
    assert not is_better([10.0] * 3), "p = .25"


@pytest.mark.parametrize(("p", "is_better"), [(0.02, True), (0.03, False)])
def test_of_two_rivals_each_needs_half_the_level(results, monkeypatch, p, is_better):
    """The better one of two equal methods is often better by luck."""
    assert len(results.rivals) == 2
    comparison = Comparison(50, Estimate(-2.0, -4.0, 0.0), Estimate(0.1, 0.0, 0.2), p)
    monkeypatch.setattr(judging, "compare", lambda scores, others: comparison)
    # Neither is worse in its worst tenth.
    monkeypatch.setattr(judging, "worst_tenth", lambda scores: dict.fromkeys(scores, 0.0))
    answer = "yes" if is_better else "no"
    assert f" better: {answer}, " in report.headline(results)
    for line in report.summary(results):
        assert f"better: {answer}" in line


def test_the_headline_names_the_rival_that_saves_most(results, monkeypatch):
    first_rival, second_rival = results.rivals
    gain = Estimate(0.1, 0.0, 0.2)
    for best, others_s, best_s in ((second_rival, -2.0, -5.0), (first_rival, 3.0, -1.0)):
        made = []
        for rival in results.rivals:
            difference = best_s if rival == best else others_s
            estimate = Estimate(difference, difference - 1.0, difference + 1.0)
            comparison = Comparison(50, estimate, gain, 0.001)
            made.append(judging.Judged(rival, "dwa", comparison, 0.05, ""))
        monkeypatch.setattr(report, "judged", lambda *_, made=made: made)
        assert report.headline(results).startswith(f"{best} better: yes, ")


# -- groups of worlds ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("world", "group"),
    [
        ("generated:294", "Test"),
        ("world_294", "Test"),
        ("generated:299", "Training"),
        ("world_299", "Training"),
        ("world_300", "Other"),  # BARN's worlds are 0 to 299.
        ("generated:300", "Other"),
        ("fresh:7", "Other"),
        ("physical_course", "Physical course"),
    ],
)
def test_only_barns_300_worlds_belong_to_its_split(world, group):
    assert set_of(world) == group


def test_with_fewer_than_two_driven_test_worlds_all_worlds_are_judged(folder):
    results = Results(folder)
    trials = results.trials
    training_world = results.of_set("Training")[0]
    first_test, second_test = results.of_set("Test")[:2]

    def judged_worlds(is_driven):
        results.trials = trials[is_driven]
        return set(report.judged_trials(results).world)

    driven = {training_world, first_test, second_test}
    is_driven = trials.world.isin(driven)
    assert judged_worlds(is_driven) == {first_test, second_test}
    assert judged_worlds(is_driven & (trials.world != second_test)) == {training_world, first_test}
    # The rivals alone drove the second one.
    is_of_rival = trials.method != "dwa"
    assert judged_worlds(is_driven & (is_of_rival | (trials.world != second_test))) == driven


# -- tables ----------------------------------------------------------------------------------------


def test_table_4_names_failures(results):
    table = tables.table_4(results)
    assert table.rows.method.tolist() == list(METHODS)
    names_failures = table.rows.failures.str.contains("time limit")
    succeeds_always = table.rows.successes.str.startswith("6")
    assert (names_failures != succeeds_always).all()
    assert table.rows["paper [s]"][0].startswith("72.8")


def test_the_papers_columns_are_for_the_papers_robot(folder):
    results = Results(folder)
    results.robot = {**results.robot, "name": "pioneer"}
    for make in (tables.table_1, tables.table_2, tables.table_3, tables.table_4):
        table = make(results)
        assert not table.rows.columns.str.contains("paper|decisions").any()
        assert not {paper.UNIT, f"(*) {paper.SWAP_SLIP}"} & set(table.notes)


def test_a_failure_counts_as_the_time_limit_however_early_it_is(tmp_path):
    """A method that hits something after 3 s does not beat one that arrives after 20 s."""
    worlds = [f"generated:{number}" for number in range(1, 7)]
    hard_world, *easy_worlds = worlds  # The baseline fails in the first world, too.
    methods = [("dwa", "dwa"), ("crash", "dwa")]
    store = TrialTable(tmp_path, dict(SETTINGS, worlds=worlds, protocol="barn-challenge"))
    for trial in plan_trials(named(*worlds), methods, trials=2, seed=0):
        result = replace(
            NOT_MEASURED,
            collided=True,
            time_s=3.0,
            reason="contact",
        )
        if trial.method == "dwa" and trial.world in easy_worlds:
            result = replace(
                NOT_MEASURED,
                success=True,
                time_s=20.0 + worlds.index(trial.world),
                reason="finished",
            )
        store.add(trial, result)
    results = Results(tmp_path)

    comparison = results.compare("crash", "dwa", easy_worlds)
    assert comparison.difference.value == pytest.approx(TIME_LIMIT_S - 23.0)
    # Two of all sign patterns have such a large difference.
    assert comparison.p == 2 / 2**5
    assert results.by_difficulty(worlds) == [*easy_worlds, hard_world]
    table = tables.table_3(results).rows.set_index("worlds")
    # Mean of 25 s and 100 s
    assert table["dwa mean time, all trials [s]"]["Difficult All"] == "62.50"


def test_contacts_of_a_moving_robot_are_counted_unless_a_speed_is_unknown(tmp_path):
    world = "generated:7"
    store = TrialTable(tmp_path, dict(SETTINGS, worlds=[world], world_specs=[world]))
    # Speeds [m/s] of the first contact: a robot that stands may be touched by a mover.
    contact_speeds = {
        "dwa": (0.3, 0.05, 0.8, None),
        "older": (0.3, math.nan, 0.05, None),
    }
    for trial in plan_trials(named(world), named(*contact_speeds), trials=4, seed=0):
        speed = contact_speeds[trial.method][trial.trial]
        result = replace(NOT_MEASURED, success=True, time_s=20.0)
        if speed is not None:
            result = replace(result, collided=True, contact_speed=speed)
        store.add(trial, result)
    rates = tables.rates(Results(tmp_path)).rows.set_index("method")
    assert rates.moving["dwa"] == "2"
    assert rates.moving["older"] == tables.NONE


def test_means_are_compared_over_the_same_worlds(folder):
    """One of the methods was driven in only some of the worlds."""
    results = Results(folder)
    easy_worlds = results.of_set("Test")[:4]
    trials = results.trials
    is_driven = (trials.method != "other") | trials.world.isin(easy_worlds)
    results.trials = trials[is_driven]
    baseline_score = results.of("dwa", easy_worlds).score.mean()
    other_score = results.of("other", easy_worlds).score.mean()

    table = tables.table_1(results).rows.set_index(["worlds", "method"])

    faster_by = float(table["faster than dwa [s]"]["Test", "other"])
    assert faster_by == pytest.approx(baseline_score - other_score, abs=0.006)


def test_in_a_table_words_begin_at_the_left_and_numbers_end_at_the_right():
    rows = pd.DataFrame([{"method": "dwa", "what it is": "<b> | ±", "time [s]": "12.3"}])
    table_html = Table("t", "a & b", rows).html()
    assert "a &amp; b" in table_html
    assert (
        '<th scope="col">what it is</th><th scope="col" class="number">time [s]</th>' in table_html
    )
    assert '<td>&lt;b&gt; | ±</td><td class="number">12.3</td>' in table_html


# -- whole reports ---------------------------------------------------------------------------------
def test_the_report_is_complete(folder):
    page_text = Path(write(folder)).read_text(encoding="utf-8")
    for table_name in ("table_1", "table_2", "table_3", "table_4", "pairs", "rates", "methods"):
        table_file = folder / "report" / f"{table_name}.csv"
        assert table_file.stat().st_size > 0
    assert "nan" not in page_text
    assert page_text.count("<table") == 7
    # A wide table scrolls by itself.
    assert len(re.findall(r'<div class="wide[^>]*><table', page_text)) == 7

    # Order of the parts
    parts = [
        'class="verdict"',
        *map(html.escape, summary(Results(folder))),
        '<div id="times">',
        '<div id="profiles">',
        "<table",
        '<a href="drives.html">',
    ]
    positions = list(map(page_text.index, parts))
    assert positions == sorted(positions)

    # How it was measured
    assert "Wall time 01:15" in page_text
    assert (
        "monitor False, movers False, planner ours, protocol paper, seed 0, simulator kinematic"
        in (page_text)
    )
    driven_on = "Driven on 2026-01-02 with commit abc on a processor (4 cores); numpy 2."
    assert f"{driven_on} Command: evaluate.py" in page_text


@pytest.mark.heavy
@needs_browser
@pytest.mark.slow
def test_the_figure_of_the_report_says_by_keyboard_what_each_point_is(folder):
    with opened(Path(write(folder))) as page:
        slider = focused(page, "slider", "World of the group Test")
        description = page.locator("#times figure").last.locator("p")
        first_text = description.inner_text()
        slider.press("ArrowRight")
        second_text = description.inner_text()
    assert first_text != second_text
    for text in (first_text, second_text):
        for method in METHODS:
            assert re.search(rf"{method} (\d+\.\d s|never arrives)", text)


def test_a_profile_has_the_room_around_each_pose(folder):
    (of_applr, of_other) = profiles(Results(folder))["drawn"]
    assert [of_applr["method"], of_other["method"]] == ["applr", "other"], "dwa's set is constant"
    (drive,) = of_applr["world"]["drives"]
    assert of_applr["world"]["name"] == "generated:20"
    poses = np.cumsum(drive["p"], axis=0) / 100.0
    clearances = clearance(load_world("generated:20"), poses[:, :2])
    expected_regions = np.digitize(clearances, LIMITS)
    # Poses on the page have hundredths of a metre, which may change the region near its limits.
    to_limits = np.abs(clearances[:, None] - np.array(LIMITS))
    is_sure = to_limits.min(axis=1) > 0.01
    regions = np.array(of_applr["regions"])
    assert regions[is_sure].tolist() == expected_regions[is_sure].tolist()
    assert len(set(of_applr["regions"])) > 1


@pytest.mark.heavy
@needs_browser
def test_keys_choose_a_profile_and_move_along_it(folder):
    with opened(Path(write(folder))) as page:
        profile_box = page.locator("#profiles")
        chooser = focused(page, "combobox", "Method and world of the profile")
        options = chooser.get_by_role("option").all_inner_texts()
        assert options == ["applr in generated:20", "other in generated:20"]
        chooser.press("ArrowDown")
        # The profile's charts are drawn in the next frame.
        profile_box.get_by_text("max_vel_x: 0.5").wait_for()
        slider = focused(page, "slider", "Time in seconds")
        slider.press("End")
        assert profile_box.get_by_text("10.0 of 10.0 s").count()
        assert profile_box.get_by_text("max_vel_x: 2").count()


@pytest.fixture
def store(tmp_path):
    """Return the table of an evaluation of one method in one world, and its trial."""
    (trial,) = plan_trials([("house", "generated:7")], [("mine", "dwa")], trials=1, seed=0)
    settings = dict(SETTINGS, worlds=["house"], world_specs=["generated:7"])
    return TrialTable(tmp_path, settings), trial


def test_without_traces_there_is_no_profile(store, tmp_path):
    table, trial = store
    table.add(trial, replace(NOT_MEASURED, success=True, time_s=9.0))
    assert profiles(Results(tmp_path)) == {}


def test_report_of_one_method_and_one_world(store, tmp_path):
    table, trial = store
    result = replace(NOT_MEASURED, timeout=True, time_s=TIME_LIMIT_S, reason="time limit")
    table.add(trial, result, TRACE.pack())
    page_text = Path(write(tmp_path)).read_text(encoding="utf-8")
    assert "paper [" not in page_text
    assert "paper&#x27;s numbers" not in page_text


def test_nothing_to_report_is_one_line(tmp_path):
    with pytest.raises(ApplrError, match="no trials"):
        write(tmp_path)
