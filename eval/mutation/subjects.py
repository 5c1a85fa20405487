"""What is mutated, and which tests are to find it: quick ones first, for the first that fails ends a trial."""

from __future__ import annotations

_STEP = "tests/env/test_driven_step.py"
_DRIVE = "tests/env/test_friction.py"
_LINEAR = ("tests/env/test_linear_drive.py", "tests/env/test_python_control.py")
_INTEGRATOR = "tests/env/test_dynamics.py::TestIntegrator"
_DRIVEN = (
    _STEP,
    "tests/env/test_drive_motion.py::test_breaking_away_while_the_torque_still_rises[0-lumped]",
    "tests/env/test_drive_motion.py::test_latency_and_lag[0.0002-2.7-lagrangian]",
)
_BUNDLES = (
    "tests/agents/test_bad_policies.py::test_bundles",
    "tests/agents/test_bad_policies.py::test_manifests_that_are_not_as_they_should_be",
    "tests/agents/test_bad_policies.py::test_how_far_a_training_may_have_gone",
    "tests/agents/test_bad_policies.py::test_a_manifest_of_a_megabyte_is_read_and_no_larger_one",
    "tests/agents/test_bad_policies.py::test_bundles_are_written_with_finite_numbers_alone",
    "tests/agents/test_bad_policies.py::test_what_a_machine_is_sent_of_a_bundle_is_the_bundle",
    "tests/agents/test_bad_policies.py::test_policies_that_are_not_saved",
    "tests/agents/test_bad_policies.py::test_a_bundle_that_cannot_be_replaced_stays_valid",
    "tests/agents/test_residual.py::test_bundle_holds_the_description_and_the_weights",
    "tests/agents/test_residual.py::test_inputs_are_picked_in_the_policys_own_order",
    "tests/agents/test_residual.py::test_a_bundle_is_of_a_plain_network_unless_it_says_otherwise",
    "tests/agents/test_residual.py::test_content_hash_depends_on_content_alone",
    "tests/agents/test_residual.py::test_saving_again_replaces_the_bundle",
)

SUBJECTS: dict[str, tuple[str, ...]] = {
    "beltarm_env/physics/derivative.py": ("tests/env/test_python_control.py",),
    "beltarm_env/physics/drive.py": (_DRIVE, _STEP),
    "beltarm_env/physics/friction.py": (_DRIVE, _INTEGRATOR, "tests/env/test_full_arm.py"),
    "beltarm_env/physics/full_arm.py": (
        "tests/env/test_models.py::TestEquations",
        "tests/env/test_python_control.py",
        _STEP,
        "tests/env/test_full_arm.py",
    ),
    "beltarm_env/physics/integrator.py": (
        _INTEGRATOR,
        "tests/env/test_dynamics.py::TestAgainstEventLocatedIntegration::test_little_friction",
        "tests/env/test_full_arm.py",
    ),
    "beltarm_env/physics/kinematics.py": ("tests/env/test_kinematics.py",),
    "beltarm_env/physics/linear.py": (*_LINEAR, "tests/env/test_bad_input.py::test_joint_angle_of_the_linear_model"),
    "beltarm_env/physics/lumped.py": (
        "tests/env/test_models.py::test_equations_of_the_lumped_arm_follow_from_its_energy",
        "tests/env/test_python_control.py",
        _STEP,
        _INTEGRATOR,
    ),
    "beltarm_env/physics/sampled.py": _LINEAR,
    "beltarm_env/physics/substeps.py": (
        "tests/env/test_models.py::TestEnvironment::test_limits_by_hand",
        "tests/env/test_models.py::TestEnvironment::test_fastest_rate_is_the_largest_eigenvalue",
        "tests/env/test_models.py::TestEnvironment::test_within_ranges_the_full_arm_is_fastest_where_link_2_is_a_rod",
        "tests/env/test_models.py::TestEnvironment::test_a_motor_in_thick_oil_is_fast_too",
        "tests/env/test_models.py::TestEnvironment::test_the_largest_kinematic_error_is_the_one_that_the_refusal_names",
        "tests/env/test_bad_input.py::test_drives_that_cannot_be_integrated",
        "tests/env/test_models.py::TestEnvironment::test_fastest_mode_asks_for_steps_enough",
        "tests/env/test_models.py::TestEnvironment::test_no_arm_of_a_range_is_faster_than_those_that_are_checked",
        "tests/env/test_models.py::TestEnvironment::test_every_arm_of_ranges_that_are_accepted_can_be_integrated",
        "tests/env/test_models.py::TestEnvironment::test_too_stiff_an_arm_is_refused",
    ),
    "beltarm_env/physics/trigonometry.py": (
        "tests/env/test_kinematics.py::TestSinCos",
        "tests/env/test_trigonometry.py",
    ),
    "beltarm_env/physics/driven/events.py": _DRIVEN,
    "beltarm_env/physics/driven/step.py": _DRIVEN,
    "beltarm_env/physics/driven/torque.py": _DRIVEN,
    "beltarm_env/task/cost.py": (
        "tests/env/test_env.py::test_reward_is_the_documented_cost",
        "tests/env/test_env.py::test_terms_saturate",
        "tests/env/test_env.py::test_an_arm_that_a_torque_tears_apart_has_a_finite_tip_error",
        "tests/env/test_env.py::test_leaving_is_charged_the_bound_for_every_remaining_step",
    ),
    "beltarm_env/task/reference.py": (
        *("tests/env/test_reference.py::TestShape", "tests/env/test_reference.py::TestPeaks"),
        "tests/env/test_reference.py::TestInTheEnvironment",
    ),
    "beltarm_env/task/sensors.py": ("tests/env/test_sensors.py",),
    "eval/comparison/statistics.py": (
        "tests/eval/test_estimates.py",
        "tests/eval/test_from_1991.py::test_worst_is_the_mean_of_a_twentieth",
    ),
    "eval/tails/estimates.py": (
        "tests/eval/test_tails.py::test_percentiles_are_values_and_their_intervals_cover",
        "tests/eval/test_tails.py::test_an_end_that_too_few_values_show_is_not_a_number",
        "tests/eval/test_tails.py::test_errors_of_few_values_by_hand",
        "tests/eval/test_tails.py::test_a_thousandth_is_the_tail_and_one_value_at_least",
        "tests/eval/test_tails.py::test_tails_of_known_values",
        "tests/eval/test_tails.py::test_what_a_tail_is_told_by",
    ),
    "eval/report/verdict.py": (
        "tests/eval/test_verdict.py::test_both_averages_decide",
        "tests/eval/test_verdict.py::test_a_learned_method_that_is_better_and_worse",
        "tests/eval/test_verdict.py::test_the_protocol_says_who_is_compared",
        "tests/eval/test_verdict.py::test_an_added_controller_has_a_sentence_of_its_own",
        "tests/eval/test_verdict.py::test_an_added_controller_stands_in_where_nothing_was_learned",
        "tests/eval/test_verdict.py::test_costs_of_several_times_as_much",
        "tests/eval/test_verdict.py::test_a_difference_below_three_percent_is_a_practical_tie",
        "tests/eval/test_verdict.py::test_a_tie_is_called_one",
        "tests/eval/test_verdict.py::test_better_takes_the_mean_too",
        "tests/eval/test_verdict.py::test_the_correction_is_for_all_splits",
        "tests/eval/test_verdict.py::test_the_main_split_decides_who_is_compared",
        "tests/eval/test_verdict.py::test_the_best_of_several_learned_methods_stands_for_them",
        "tests/eval/test_verdict.py::test_without_a_learned_method_or_a_classical_one",
        "tests/eval/test_verdict.py::test_the_duels_are_in_the_results_and_in_the_summary",
        "tests/eval/test_verdict.py::test_the_answer_when_learning_loses",
    ),
    "agents/policy/actor.py": ("tests/agents/test_actor.py", *_BUNDLES),
    "agents/policy/bundle.py": _BUNDLES,
    "agents/policy/weights.py": ("tests/agents/test_actor.py", *_BUNDLES),
    "agents/policy/inputs.py": _BUNDLES,
    "agents/policy/manifest.py": _BUNDLES,
    "baselines/tools/schema.py": ("tests/baselines/test_schema.py", *_BUNDLES),
}
"""Tests, as pytest is told them, by module."""
