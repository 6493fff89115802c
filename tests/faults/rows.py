"""The faults that the package survives, one row each: what fails, what happens, and the tests that show it.

Rows 1 to 25 are the promises; those with a letter came up while the commands and nodes were attacked. table.py makes
the tables of README.md and docs/faults.md from here and from the measured figures in measured.json.
"""

from typing import NamedTuple, Tuple

SENSORS, PROCESSES = "faults/test_sensors.py::", "faults/test_processes.py::"
REQUESTS, MACHINE = "faults/test_requests.py::", "faults/test_machine.py::"
HOSTILE = "test_hostile_experience.py::"


class Row(NamedTuple):
    """One fault.

    Attributes:
        number: its number, a letter behind it for further faults of the same kind.
        fault: what fails.
        outcome: what happens then.
        tests: the tests that provoke it, as file::function below tests/.
        figures: names of the measured figures that the row shows; none: all of its tests'.
    """

    number: str
    fault: str
    outcome: str
    tests: Tuple[str, ...]
    figures: Tuple[str, ...] = ()


SECTIONS = {
    "The policy and the applr node": (
        Row(
            "1",
            "the policy puts out NaN or infinity",
            "refused, the parameters stay, diagnostics count it",
            (
                "test_applr_node.py::test_fault_1_nan_actor_is_refused_and_counted",
                "test_reconfigure_client.py::test_fault_1_nan_never_goes_out",
            ),
        ),
        Row(
            "2",
            "values beyond the bounds, fractions for sample counts",
            "clipped to the bounds, rounded to the nearest number",
            ("test_reconfigure_client.py::test_fault_2_values_beyond_bounds_are_clipped_and_rounded",),
        ),
        Row(
            "3",
            "a parameter server (the planner) freezes",
            "the robot stands; the request is given up within 1 s and repeated; everything goes on when it answers",
            (PROCESSES + "test_the_planner_freezes",),
        ),
        Row(
            "4",
            "the planner is restarted",
            "the applr node connects again and sets the current parameters",
            (PROCESSES + "test_the_planner_is_killed_and_comes_back",),
            ("current parameters after",),
        ),
        Row(
            "5",
            "one of the three parameter servers refuses",
            "the values of the others are restored: never half a set",
            ("test_reconfigure_client.py::test_fault_5_one_refusal_puts_the_others_back",),
        ),
        Row(
            "6",
            "a person changes a parameter, for instance in rqt_reconfigure",
            "the next observation contains what the planner really has",
            (PROCESSES + "test_a_persons_change_is_in_the_next_observation",),
        ),
        Row(
            "7",
            "50 changes of parameters in a second",
            "neither a deadlock nor a gap in `/cmd_vel`",
            (PROCESSES + "test_fifty_changes_of_parameters_in_a_second",),
        ),
        Row(
            "8",
            "the applr node is killed",
            "this package's `move_base` is back on θ₀ within three times `applr/period` (default 2 s) and drives on",
            (PROCESSES + "test_the_applr_node_is_killed",),
        ),
        Row(
            "9",
            "the policy file is missing, truncated, of another shape, a pickle",
            "refused with the reason, nothing in it is executed, θ₀ is used",
            ("test_applr_node.py::test_fault_9_unusable_policies_leave_theta_0",),
        ),
    ),
    "Sensors, clock and planner": (
        Row(
            "10",
            "no scan",
            "the robot stands, and drives again when scans return",
            (SENSORS + "test_no_scan",),
        ),
        Row(
            "10a",
            "no odometry, though its transforms still come",
            "the collision monitor stops the robot and says so",
            (SENSORS + "test_no_odometry",),
        ),
        Row(
            "11",
            "scans of NaN alone, without beams, with another number of beams",
            "not used: the robot stands and says why; single odd beams are treated as REP 117 says",
            (
                SENSORS + "test_scans_that_cannot_be_used",
                SENSORS + "test_odd_beams_are_ordinary",
                "test_applr_node.py::test_fault_11_odd_scans",
            ),
        ),
        Row(
            "11a",
            "another scanner comes up late, with other beams",
            "taken after 2 s without a usable scan",
            (SENSORS + "test_another_scanner_is_taken",),
        ),
        Row(
            "11b",
            "a blind scanner at 2 m/s before a wall: all beams too near, zero, NaN, -inf, +inf, range_max, a frozen "
            "image, absurd geometry",
            "the collision monitor stops the robot; no contact",
            (
                "faults/test_blind_scanners.py::test_a_wall_at_full_speed",
                "faults/test_blind_scanners.py::test_without_the_monitor_it_is_a_contact",
                REQUESTS + "test_a_frozen_image_at_full_speed",
            ),
        ),
        Row(
            "12",
            "stamps that are old, ahead or out of order; no transform; an unknown frame",
            "the robot stands and names the transform; scans out of order change nothing",
            (
                SENSORS + "test_stamps_of_scans_that_are_old_or_ahead",
                SENSORS + "test_scans_out_of_order_change_nothing",
                SENSORS + "test_no_transform",
                SENSORS + "test_a_frame_that_nobody_knows",
            ),
        ),
        Row(
            "12a",
            "one transform stamped 30 s ahead",
            "the robot does not stand for 30 s",
            (SENSORS + "test_a_transform_far_ahead",),
        ),
        Row(
            "13",
            "`/clock` stands still or jumps back",
            "the robot stands; after a jump the goal is aborted and everything begins anew",
            (SENSORS + "test_the_clock_stands_still", SENSORS + "test_the_clock_jumps_back"),
        ),
        Row(
            "14",
            "the planner dies while the robot moves",
            "the base stops when commands cease",
            (
                PROCESSES + "test_the_planner_is_killed_and_comes_back",
                "test_ros_bridge.py::test_drives_on_either_topic_and_stops_when_commands_do",
            ),
            ("stands after",),
        ),
        Row(
            "14a",
            "the collision monitor dies, or commands get lost on the way to the base",
            "the base stops; the launch file starts the monitor again",
            (PROCESSES + "test_the_collision_monitor_is_killed", PROCESSES + "test_commands_get_lost_on_the_way"),
        ),
        Row(
            "14b",
            "a planner gone mad: 2 m/s at a wall, 10⁹ m/s, NaN",
            "the collision monitor stops the robot before the wall",
            (REQUESTS + "test_a_planner_gone_mad",),
        ),
        Row(
            "14c",
            "`move_base` dies while the robot is idle, or is late",
            "the applr node says so in diagnostics, and no longer when it is there",
            ("test_applr_node.py::test_a_dead_move_base_is_noticed_while_idle",),
        ),
        Row(
            "15",
            "a hundred goals in a second; an invalid quaternion, an unknown frame, a goal that is not finite",
            "each goal ends in the right state of actionlib",
            (REQUESTS + "test_a_hundred_goals_in_a_second", REQUESTS + "test_goals_that_cannot_be"),
        ),
        Row(
            "16",
            "`make_plan` and `clear_costmaps` called all the time while driving",
            "no deadlock, no wrong plan",
            (REQUESTS + "test_make_plan_and_clear_costmaps_all_the_time",),
        ),
        Row(
            "17",
            "a start in collision, a sealed goal, an oscillation, a goal in an obstacle",
            "the recoveries run in order, then the goal is aborted",
            (
                "test_move_base.py::test_a_start_in_collision_is_driven_out_of_or_ends_in_recoveries",
                "test_move_base.py::test_sealed_goal_tries_every_recovery_in_order_and_aborts",
                "test_move_base.py::test_oscillation_recovers_and_aborts_in_its_own_words",
                "test_move_base.py::test_goals_that_cannot_be_reached_are_aborted",
            ),
        ),
        Row(
            "17a",
            "a sealed goal that every reset of the maps opens again",
            "circled for ever as in C++; with `applr/recovery_rounds` aborted after so many rounds",
            ("test_move_base.py::test_a_sealed_goal_is_given_up_where_recovery_rounds_are_limited",),
        ),
        Row(
            "17b",
            "the collision monitor holds the robot back for good",
            "other small motions are tried, then the recoveries run, then the goal is aborted",
            (
                "test_move_base.py::test_a_robot_that_is_held_back_tries_other_motions_and_then_recovers",
                "test_move_base.py::test_a_robot_without_a_command_tries_other_motions_where_a_monitor_watches",
            ),
        ),
    ),
    "Files, training and the machine": (
        Row(
            "18",
            "damaged bags, missing topics, jumps of the clock",
            "what cannot be used is skipped with a reason and counted; the rest is converted",
            ("test_bags.py::test_fault_18_damaged_bags_are_skipped_and_counted",),
        ),
        Row(
            "18a",
            "archives that unpack to gigabytes (bz2, lz4, npz)",
            "unpacked piece by piece, refused beyond the bounds in SECURITY.md",
            (
                HOSTILE + "test_a_bag_that_unpacks_to_too_much_is_one_line_in_little_memory",
                HOSTILE + "test_shards_that_are_no_archives_or_unpack_to_too_much",
            ),
        ),
        Row(
            "18b",
            "datasets with missing or wrong keys, empty shards, lengths that are no numbers",
            "one line; nothing is left that is in the way of the next try",
            (
                HOSTILE + "test_manifests_with_wrong_or_missing_keys",
                HOSTILE + "test_shards_with_wrong_or_missing_arrays",
                HOSTILE + "test_a_run_that_fails_on_its_dataset_is_not_in_the_way_of_the_next",
            ),
        ),
        Row(
            "18c",
            "pipes, devices and folders in place of files, to read or to write",
            "refused at once, and what is there stays",
            (
                HOSTILE + "test_bags_that_are_no_files",
                HOSTILE + "test_a_pipe_in_a_runs_folder_is_one_line_at_once",
                "test_common.py::test_only_regular_files_within_the_bound_are_read",
                "test_common.py::test_what_is_no_file_is_not_written_over",
            ),
        ),
        Row(
            "18d",
            "a demonstration is stopped",
            "the bag is closed and says that it is partial",
            (HOSTILE + "test_a_stopped_demonstration_says_that_it_is_partial",),
        ),
        Row(
            "19",
            "the training or an evaluation is killed at any moment",
            "resumed with nothing lost but the step in progress: the same weights and rows in the end",
            (
                "test_train.py::test_sigkill_at_random_moments_loses_nothing",
                "test_training_evaluate.py::test_killed_and_started_again_gives_the_same_rows",
            ),
        ),
        Row(
            "20",
            "an actor dies, hangs, or sends malformed or repeated episodes",
            "replaced, or refused and counted; nothing from the network is unpickled",
            (
                "test_workers.py::test_a_killed_and_a_stopped_process_are_replaced",
                "test_workers.py::test_the_learner_refuses_and_counts_what_is_wrong_and_goes_on",
                "test_replay.py::test_the_same_episode_twice_is_refused_in_any_order",
            ),
        ),
        Row(
            "20a",
            "an answer with an info of wrong types, a journal that holds such a record",
            "refused before it is taken; the journal is resumed without it; what counts the reasons stays small",
            (
                HOSTILE + "test_an_answer_with_a_malformed_info_is_refused_and_counted",
                HOSTILE + "test_a_journal_that_holds_a_malformed_record_resumes_without_it",
                HOSTILE + "test_refused_texts_do_not_grow_without_end",
            ),
        ),
        Row(
            "20b",
            "somebody on the network looks for a local training's Ray",
            "it listens on the loopback interface only",
            ("test_workers.py::test_ray_on_this_machine_listens_on_loopback_only",),
        ),
        Row(
            "21",
            "a full disk, a folder that cannot be written",
            "one line; the last good checkpoint is intact",
            (
                "test_train.py::test_a_full_disk_leaves_the_last_checkpoint",
                "test_replay.py::test_journal_on_a_full_disk_stays_whole",
                "test_bags.py::test_writing_where_nothing_can_be_written",
            ),
        ),
        Row(
            "22",
            "world files with entity expansion, deep nesting, NaN poses, 100,000 cylinders",
            "refused, or loaded within bounded time and memory",
            (
                "test_worlds_hostile.py::test_bad_files",
                "test_worlds_hostile.py::test_a_hundred_thousand_cylinders",
                "test_worlds_hostile.py::test_memory_stays_bounded",
                "test_worlds_hostile.py::test_path_file_outside_its_folder",
            ),
        ),
        Row(
            "23",
            "Ctrl-C",
            "every process that was started has ended",
            (
                "test_launch.py::test_interrupted_demo_leaves_nobody",
                "test_train.py::test_ctrl_c_saves_and_stops",
                HOSTILE + "test_ctrl_c_during_imports_is_one_line",
            ),
        ),
        Row(
            "23a",
            "options and arguments that cannot be, quotes and newlines in paths",
            "one line and a status, never a traceback; paths with quotes are used as they are",
            (
                HOSTILE + "test_options_that_cannot_be_are_one_line",
                HOSTILE + "test_mistakes_on_the_other_command_lines_are_one_line",
                "test_common.py::test_a_newline_in_a_path_leaves_the_error_on_one_line",
                "test_launch.py::test_a_wrong_argument_is_one_line",
                "test_launch_paths.py::test_quotes_and_spaces_in_paths_reach_the_nodes_as_they_are",
                "test_launch_paths.py::test_a_line_break_in_an_argument_is_refused",
            ),
        ),
        Row(
            "24",
            "two stacks on one machine",
            "neither hears the other; the end of one leaves the other alone",
            (MACHINE + "test_two_stacks_on_one_machine",),
        ),
        Row(
            "25",
            "the processor is busy",
            "commands stay young; control cycles that were missed are reported, not made up for",
            (MACHINE + "test_the_processor_is_busy",),
        ),
    ),
}
ROWS = tuple(row for rows in SECTIONS.values() for row in rows)
