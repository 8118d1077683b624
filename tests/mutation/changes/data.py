"""Reading, units, preparation, windows, advice."""

from tests.mutation.change import Change

TEST_ADVICE = ("tests/data/test_suggestions.py", "tests/data/test_advice.py")
TEST_PREPARATION = ("tests/data/test_preparation.py",)
TEST_WINDOWS = ("tests/data/test_dataset.py",)

CHANGES = (
    Change(
        "the vertex of the delay search lies on the wrong side of the peak",
        "sysid_evo/data/response.py",
        "float(0.5 * (before - after) / bend)",
        "float(0.5 * (after - before) / bend)",
        TEST_ADVICE,
    ),
    Change(
        "the largest peak is the delay, however late",
        "sysid_evo/data/response.py",
        "FIRST = 0.5",
        "FIRST = 1.0",
        TEST_ADVICE,
    ),
    Change(
        "a smooth control smears its delay",
        "sysid_evo/data/response.py",
        "whitening = np.concatenate([[1.0], -weights])",
        "whitening = np.concatenate([[1.0], 0.0 * weights])",
        TEST_ADVICE,
    ),
    Change(
        "a unit below the line multiplies",
        "sysid_evo/data/units.py",
        "power = power if i == 0 else -power",
        "power = power if i == 0 else +power",
        ("tests/data/test_units.py",),
    ),
    Change(
        "degrees are gradians",
        "sysid_evo/data/units.py",
        '"deg": ({"rad": 1}, math.pi / 180.0)',
        '"deg": ({"rad": 1}, math.pi / 200.0)',
        ("tests/data/test_units.py",),
    ),
    Change(
        "velocities have the wrong sign",
        "sysid_evo/data/preparation.py",
        "np.array([-1.0, 8.0, 0.0, -8.0, 1.0])",
        "np.array([1.0, -8.0, 0.0, 8.0, -1.0])",
        TEST_PREPARATION,
    ),
    Change(
        "prepared states are a row late",
        "sysid_evo/data/preparation.py",
        "states=smooth[ticks - samples[0] - margin],",
        "states=smooth[ticks - samples[0] - margin - (ticks > ticks[0])],",
        TEST_PREPARATION,
    ),
    Change(
        "the filter lets noise above half the control rate pass",
        "sysid_evo/data/preparation.py",
        "count = math.ceil((ATTENUATION - 7.95)",
        "count = math.ceil((0.5 * ATTENUATION - 7.95)",
        TEST_PREPARATION,
    ),
    Change(
        "a window leads to the state it starts from",
        "sysid_evo/data/trajectory.py",
        "_cut(self.states, place, ahead + 1),",
        "_cut(self.states, place, ahead),",
        TEST_WINDOWS,
    ),
    Change(
        "the history of a window is made up",
        "sysid_evo/data/trajectory.py",
        "max(first, history)",
        "first",
        TEST_WINDOWS,
    ),
)
