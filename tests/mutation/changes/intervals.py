"""Intervals over trials."""

from tests.mutation.change import Change

UNCERTAINTY = "evaluation/transfer/uncertainty.py"
TESTS = "tests/evaluation/test_uncertainty.py"

CHANGES = (
    Change(
        "the degrees of a part are one more",
        UNCERTAINTY,
        "max(1.0, end - begin - 1.0)",
        "max(1.0, end - begin)",
        (TESTS,),
    ),
    Change(
        "the jackknife is not corrected",
        UNCERTAINTY,
        "adds = np.sqrt((trials - 1) / trials) *",
        "adds = 1.0 *",
        (TESTS,),
    ),
    Change(
        "trials of all sizes have the degrees of the longest",
        UNCERTAINTY,
        "            begin = end\n",
        "",
        (TESTS,),
    ),
    Change(
        "a ratio has the spread of its numerator",
        UNCERTAINTY,
        "(-share / other.value, other)",
        "(-0.0 * share, other)",
        (TESTS,),
    ),
)
