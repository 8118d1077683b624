"""Motions, the task, and both forms of the engine."""

from tests.mutation.change import Change

PLANAR = "sysid_evo/motion.py"
LOOPS = "sysid_evo/engine/compiled/loops.py"
REFERENCE = "sysid_evo/engine/reference.py"
TEST_MOTION = ("tests/sysid_evo/test_motion.py",)
TEST_TASK = ("tests/sysid_evo/test_point_to_point.py",)
TEST_REFERENCE = ("tests/sysid_evo/test_rollout.py",)
COMPILED = "tests/sysid_evo/engine/test_compiled_rollout.py"
EQUALITY = "tests/sysid_evo/engine/test_equality.py"
TEST_FIT = (f"{EQUALITY}::test_the_compiled_fit_has_the_error_of_the_plain_one",)
TEST_WAYPOINTS = (f"{EQUALITY}::test_the_waypoint_task_observes_and_advances_step_by_step",)

CHANGES = (
    Change(
        "the frame turns the wrong way in an acceleration",
        PLANAR,
        "after[..., forward], after[..., lateral], before[..., yaw_rate] * dt",
        "after[..., forward], after[..., lateral], -before[..., yaw_rate] * dt",
        TEST_MOTION,
    ),
    Change(
        "a pose is carried on with the heading of the start",
        PLANAR,
        "rotate(along, across, pose[..., 2] + 0.5 * turned)",
        "rotate(along, across, pose[..., 2])",
        TEST_MOTION,
    ),
    Change(
        "measured velocities are turned out of the body frame",
        PLANAR,
        "rotate(rate[..., 0], rate[..., 1], -pose[..., 2])",
        "rotate(rate[..., 0], rate[..., 1], pose[..., 2])",
        ("tests/sysid_evo/test_open_motion.py",),
    ),
    Change(
        "half a turn to the right is another angle than to the left",
        "sysid_evo/angles.py",
        "wrapped <= -0.5 * period",
        "wrapped < -0.5 * period",
        ("tests/sysid_evo/test_periodic.py",),
    ),
    Change(
        "the compiled form takes out one turn of an angle at most",
        "sysid_evo/motion_kernels.py",
        "angle = angle - TURN * nearest(angle * PER_TURN)",
        "angle = angle - TURN if angle > math.pi else angle",
        TEST_WAYPOINTS,
    ),
    Change(
        "a waypoint is passed from another distance",
        "sysid_evo/tasks/point_to_point.py",
        "near = dx * dx + dy * dy <= self.waypoint_radius**2",
        "near = dx * dx + dy * dy <= self.waypoint_radius",
        TEST_TASK,
    ),
    Change(
        "waypoints crowd in the middle of the arena",
        "sysid_evo/tasks/point_to_point.py",
        "arena_radius * np.sqrt(found[..., 0])",
        "arena_radius * found[..., 0]",
        TEST_TASK,
    ),
    Change(
        "the compiled task passes a waypoint from another distance",
        "sysid_evo/tasks/point_to_point.py",
        "radius_squared=self.waypoint_radius**2",
        "radius_squared=self.waypoint_radius",
        TEST_WAYPOINTS,
    ),
    Change(
        "steps of trials that are over count as clipped in the compiled form",
        LOOPS,
        "fresh, clipping = diverging & ~over, marked & ~diverging & ~over",
        "fresh, clipping = diverging & ~over, marked & ~diverging",
        (f"{COMPILED}::test_a_trial_that_is_over_is_clipped_no_more",),
    ),
    Change(
        "lanes that only pad a block count in the error of a compiled fit",
        "sysid_evo/engine/compiled/loops.py",
        "for lane in range(used):\n                    off = carry",
        "for lane in range(LANES):\n                    off = carry",
        TEST_FIT,
    ),
    Change(
        "a compiled fit forgets how much each state counts",
        "sysid_evo/engine/compiled/loops.py",
        "total += off * off * weight[row]",
        "total += off * off",
        TEST_FIT,
    ),
    Change(
        "a compiled simulation goes on beyond the envelope",
        LOOPS,
        "store(carry, row * LANES, min(max(load(carry, row * LANES), envelope[row]), envelope[nx + row]))",
        "store(carry, row * LANES, max(load(carry, row * LANES), envelope[row]))",
        (f"{COMPILED}::test_clipped_steps_are_counted_and_clipped_states_go_on",),
    ),
    Change(
        "the trial of a rollout is that of another candidate",
        LOOPS,
        "trial = rollout % n_trials",
        "trial = rollout // n_trials % n_trials",
        (f"{COMPILED}::test_every_number_of_rollouts_fills_its_blocks",),
    ),
    Change(
        "a trial that diverges scores as one that survives",
        "sysid_evo/engine/results.py",
        "task.worst - 1.0 + survived / task.horizon, fitness)",
        "fitness, fitness)",
        TEST_REFERENCE,
    ),
    Change(
        "steps of trials that are over count as clipped",
        REFERENCE,
        "clipped += touched & going",
        "clipped += touched",
        TEST_REFERENCE,
    ),
    Change(
        "a state that is not a number stays one although there is an envelope",
        "sysid_evo/carry.py",
        "np.maximum(np.fmin(value, most), least, out=value)",
        "np.maximum(np.minimum(value, most), least, out=value)",
        ("tests/sysid_evo/test_dynamics.py",),
    ),
    Change(
        "a switch closes at half instead of three tenths",
        "sysid_evo/engine/compiled/workspace.py",
        "np.arctanh(boundary) if before_tanh else boundary",
        "np.arctanh(1.5 * boundary) if before_tanh else 1.5 * boundary",
        (f"{COMPILED}::test_every_output_selects_the_level_that_the_system_says",),
    ),
)
