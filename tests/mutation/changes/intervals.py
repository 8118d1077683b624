"""Intervals over evolution seeds and trials."""

from tests.mutation.change import Change

NESTED = "evaluation/transfer/nested.py"
TEST_NESTED = "tests/evaluation/test_nested.py"

CHANGES = (
    Change(
        "variances count alike whatever their degrees",
        NESTED,
        "np.average(variances, weights=degrees)",
        "np.average(variances)",
        (TEST_NESTED,),
    ),
    Change(
        "the degrees of a part are one more",
        NESTED,
        "max(1.0, end - begin - 1.0)",
        "max(1.0, end - begin)",
        (TEST_NESTED,),
    ),
    Change(
        "the jackknife is not corrected",
        NESTED,
        "adds = np.sqrt((trials - 1) / trials) *",
        "adds = 1.0 *",
        (TEST_NESTED,),
    ),
    Change(
        "a prior is weighed once",
        NESTED,
        "variance=weight**2 * prior.variance",
        "variance=abs(weight) * prior.variance",
        (TEST_NESTED,),
    ),
    Change(
        "a prior stays with two figures",
        NESTED,
        "if sum(controller in other.seeds for _, other in parts) == 1:",
        "if True:",
        (TEST_NESTED,),
    ),
    Change("parts of the variance below zero count", NESTED, "if among > owed:", "if True:", (TEST_NESTED,)),
    Change(
        "own seeds that differ further lose to the prior",
        NESTED,
        "if variance <= self.variance:",
        "if True:",
        (TEST_NESTED,),
    ),
    Change("the variance is that of one seed", NESTED, "among = own / count", "among = own", (TEST_NESTED,)),
    Change(
        "trials of all sizes have the degrees of the longest", NESTED, "            begin = end\n", "", (TEST_NESTED,)
    ),
    Change(
        "the smallest number of seeds is the largest",
        NESTED,
        "return min(map(len, self.seeds.values()))",
        "return max(map(len, self.seeds.values()))",
        (TEST_NESTED,),
    ),
    Change(
        "a ratio has the spread of its numerator",
        NESTED,
        "(-share / other.value, other)",
        "(-0.0 * share, other)",
        (TEST_NESTED,),
    ),
)
