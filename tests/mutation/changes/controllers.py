"""Controllers, what they plan, and the files that they are written into."""

from tests.mutation.change import Change

LAWS = "tests/sysid_evo/test_controllers.py"
PLANNING = "tests/sysid_evo/test_predictive.py"

CHANGES = (
    Change(
        "the integral of a PID winds up",
        "sysid_evo/controllers/pid.py",
        "np.where(beyond * ki * error > 0.0, integral, grown)",
        "grown",
        (f"{LAWS}::test_an_integral_does_not_wind_up",),
    ),
    Change(
        "an angle that jumps by a turn kicks the derivative",
        "sysid_evo/controllers/pid.py",
        "change = change - period * np.round(",
        "change = change - 0.0 * np.round(",
        (f"{LAWS}::test_an_angle_that_jumps_by_a_turn_does_not_kick_the_derivative",),
    ),
    Change(
        "a plan believes the most hopeful of several models",
        "sysid_evo/predictive_control.py",
        "scores = np.min(",
        "scores = np.max(",
        (f"{PLANNING}::test_the_lowest_score_of_several_models_counts",),
    ),
    Change(
        "a plan knows the waypoint after the next",
        "sysid_evo/predictive_control.py",
        "known = self.task.foreseen(view.task_state)",
        "known = view.task_state",
        (f"{PLANNING}::test_it_does_not_know_the_waypoint_after_the_next",),
    ),
    Change(
        "LQR holds its target without the control that it takes to stay there",
        "sysid_evo/controllers/lqr.py",
        "((controls - middle) / span,",
        "(0.0 * (controls - middle) / span,",
        ("tests/sysid_evo/test_lqr.py::test_it_is_the_textbook_feedback_around_rest_at_the_target",),
    ),
    Change(
        "a controller written in Python forgets what it remembers",
        "sysid_evo/export/python_file.py",
        'after = [f"self.{name} = {value.name}"',
        'after = [f"self.{name} = 0.0 * {value.name}"',
        (
            "tests/sysid_evo/export/test_python_file.py::"
            "test_the_python_file_gives_the_commands_of_the_product_over_ten_thousand_samples",
        ),
    ),
    Change(
        "a switch in C changes its level at another output",
        "sysid_evo/export/c_file.py",
        'return f"({left} {e.operator} {right} ? {yes} : {no})"',
        'return f"({left} - 0.1 {e.operator} {right} ? {yes} : {no})"',
        (
            "tests/sysid_evo/export/test_c_file.py::"
            "test_the_c_file_gives_the_commands_of_the_product_over_ten_thousand_samples",
        ),
    ),
    Change(
        "a plan on which the model diverges scores like any other",
        "sysid_evo/engine/imagined.py",
        "np.where(lost, task.worst - 1.0, scores)",
        "scores",
        (f"{PLANNING}::test_a_sequence_on_which_the_model_diverges_is_the_worst",),
    ),
    Change(
        "a controller with a model of the comparison inside does not depend on its fit",
        "evaluation/cells/controllers.py",
        "return tuple(self.models.values())",
        "return ()",
        (
            "tests/evaluation/test_comparison.py::"
            "test_a_model_of_the_comparison_stands_inside_a_controller_by_its_label",
        ),
    ),
    Change(
        "a robot meets the noise that is usual for models",
        "evaluation/cells/controllers.py",
        "if experiment.noise is None and any(",
        "if experiment.noise == 'never' and any(",
        (
            "tests/evaluation/test_comparison.py::"
            "test_where_a_target_is_to_be_kept_models_meet_some_noise_unless_none_is_asked_for",
        ),
    ),
)
