"""Adaptation: what is held back, what the gate believes, and how that is told."""

from tests.mutation.change import Change

GATE = "sysid_evo/models/adaptation/selection.py"
ADAPTING = "sysid_evo/models/adaptation/selection.py"
TEST_WHAT_THE_GATE_SAYS = "tests/sysid_evo/adaptation/test_what_the_gate_says.py"
TEST_ADAPTED = "tests/model_zoo/test_adapted.py"
TEST_GIVEN_UP = "tests/model_zoo/test_given_up.py"
TEST_GATE = "tests/sysid_evo/adaptation/test_gate.py"
HOME, TEST_HOME = "sysid_evo/models/adaptation/selection.py", "tests/sysid_evo/adaptation/test_home.py"

CHANGES = (
    Change(
        "what is only a little farther off than at home is adapted",
        ADAPTING,
        "        if times <= AS_AT_HOME:",
        "        if times <= 1.0:",
        (TEST_HOME,),
    ),
    Change(
        "errors at home are those of standard deviations",
        HOME,
        "squares.append(((wrong * pieces.scale) ** 2)",
        "squares.append((wrong**2)",
        (TEST_HOME,),
    ),
    Change(
        "the scale of a state does not matter beside home",
        HOME,
        "axis=(0, 1))) * scale",
        "axis=(0, 1)))",
        (TEST_HOME,),
    ),
    Change(
        "the states are compared with home on average",
        HOME,
        "float(np.max(found",
        "float(np.mean(found",
        (TEST_HOME,),
    ),
    Change(
        "all pieces of a long recording are run",
        HOME,
        "evenly_spaced(len(pieces), MOST_PIECES",
        "evenly_spaced(len(pieces), len(pieces)",
        (TEST_HOME,),
    ),
    Change(
        "auto knows how far off it is on what it has learned from",
        "model_zoo/auto/model.py",
        "nothing_held_out = any(seen is held for seen, held in pairs)",
        "nothing_held_out = False",
        ("tests/model_zoo/test_auto.py",),
    ),
    Change(
        "better in one block is enough",
        "sysid_evo/validation/acceptance.py",
        "return max(self.each) <= 1.0 - IN_EACH",
        "return min(self.each) <= 1.0 - IN_EACH",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "a tenth is enough",
        "sysid_evo/validation/acceptance.py",
        "BETTER = 0.15",
        "BETTER = 0.14",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "three percent in each block are enough",
        "sysid_evo/validation/acceptance.py",
        "IN_EACH = 0.05",
        "IN_EACH = 0.045",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "a correction is sure at 97 % of Student's t",
        "sysid_evo/validation/acceptance.py",
        "CONFIDENCE = 0.975",
        "CONFIDENCE = 0.97",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "two seconds are sure",
        "sysid_evo/validation/acceptance.py",
        "if len(gains) < 3:",
        "if len(gains) < 2:",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the error of a mean is that of n",
        "sysid_evo/validation/acceptance.py",
        "gains.std(ddof=1)",
        "gains.std()",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "chance and blocks are exchanged in what is said",
        GATE,
        '"which may be chance" if best.everywhere',
        '"which may be chance" if not best.everywhere',
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "worse is better in what is said",
        GATE,
        "'better' if change > 0 else 'worse'",
        "'better' if change < 0 else 'worse'",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the best is said, not what was taken",
        GATE,
        "if taken is None else taken",
        "if taken is None else min(self.trials, key=lambda trial: trial.error)",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "a window that reaches over the edge is held back",
        "sysid_evo/validation/folds.py",
        "(first >= self.low) & (first + self.horizon <= self.high)",
        "(first >= self.low) & (first <= self.high)",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "a window that reaches into the block is learned from",
        "sysid_evo/validation/folds.py",
        "(first + self.horizon <= self.low) | (first >= self.high)",
        "(first <= self.low) | (first >= self.high)",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the second episode counts from the first",
        "sysid_evo/validation/folds.py",
        "begin += len(episode)",
        "begin += 0",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the part before a block is left out",
        "sysid_evo/validation/folds.py",
        "((0, low), (high, len(episode))) if b > a",
        "((high, len(episode)),) if b > a",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "blocks begin where the first window does",
        "sysid_evo/validation/folds.py",
        "edges[0], edges[-1] = 0, int(first.max()) + horizon",
        "edges[0], edges[-1] = int(first.min()), int(first.max())",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "blocks without windows are blocks",
        "sysid_evo/validation/folds.py",
        "if all(block.held(first).any() and block.learned(first).any() for block in blocks) else []",
        "",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "seconds that one of both has count",
        "sysid_evo/validation/acceptance.py",
        "first.keys() & second.keys()",
        "first.keys()",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the last that is about as good is taken",
        GATE,
        "if trial.error <= (1.0 + AS_GOOD) * least][:1]",
        "if trial.error <= (1.0 + 3 * AS_GOOD) * least][:1]",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "training further is never better",
        GATE,
        'for trial in good if trial.kind in ("further", "mean"))]',
        'for trial in good if trial.kind == "mean")]',
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "rest counts as motion",
        ADAPTING,
        "int(rows[:-1].sum())",
        "len(rows[:-1])",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "new seconds count once",
        ADAPTING,
        "copies = max(1, round(training.n_steps / new.n_steps))",
        "copies = 1",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "the old data are left out of a refit",
        ADAPTING,
        "training.with_episodes([*training, *again])",
        "training.with_episodes(again)",
        (
            TEST_WHAT_THE_GATE_SAYS,
            TEST_GATE,
        ),
    ),
    Change(
        "more training is believed as a correction is",
        "sysid_evo/validation/acceptance.py",
        "CONFIDENCE_OF_TRAINING = 1.0, 0.99",
        "CONFIDENCE_OF_TRAINING = 1.0, 0.985",
        (TEST_GATE,),
    ),
    Change(
        "a mean is believed as a correction is",
        "sysid_evo/validation/acceptance.py",
        'if kind in ("further", "mean"):',
        'if kind == "further":',
        (TEST_GATE,),
    ),
    Change(
        "what is asked of more training shrinks with the seconds",
        "sysid_evo/validation/acceptance.py",
        "/ np.sqrt(max(1, len(gains)))",
        "/ max(1, len(gains))",
        (TEST_GATE,),
    ),
    Change(
        "what is asked of more training is asked of it alone",
        "sysid_evo/validation/acceptance.py",
        "self.error <= 1.0 - self.asked",
        "self.error <= 1.0 - BETTER",
        (TEST_GATE,),
    ),
    Change(
        "a trial that was given up is the best",
        GATE,
        "[trial for trial in self.trials if len(trial.each) == self.blocks]",
        "self.trials",
        (TEST_WHAT_THE_GATE_SAYS,),
    ),
    Change(
        "what has failed must have done so in all blocks",
        "sysid_evo/validation/acceptance.py",
        "return any(after.share_of(before)",
        "return all(after.share_of(before)",
        (TEST_GATE,),
    ),
    Change(
        "a way is given up though its mean may be good",
        ADAPTING,
        "if failed(plain, of_way) and (not beside or failed(plain, of_mean)):",
        "if failed(plain, of_way):",
        (TEST_GIVEN_UP,),
    ),
    Change(
        "a way is never given up",
        ADAPTING,
        "if failed(plain, of_way) and (not beside or failed(plain, of_mean)):",
        "if False:",
        (TEST_GIVEN_UP,),
    ),
    Change(
        "means are never better",
        GATE,
        'for trial in good if trial.kind in ("further", "mean"))]',
        'for trial in good if trial.kind == "further")]',
        (TEST_GATE,),
    ),
    Change(
        "a fit anew never gives way",
        GATE,
        "return safer[0].name if safer else best.name",
        "return best.name",
        (TEST_GATE,),
    ),
    Change(
        "a fit anew always gives way",
        GATE,
        "for trial in beside if trial.error <= (1.0 + AS_GOOD) * best.error]",
        "for trial in beside]",
        (TEST_GATE,),
    ),
    Change(
        "another fit gives way to the mean of a fit that is not taken",
        GATE,
        'if trial.kind == "beside" and trial.other == best.name]',
        'if trial.kind == "beside"]',
        (TEST_GATE,),
    ),
    Change(
        "a model that draws noise is put beside another",
        ADAPTING,
        "apart.get(best, []) if not model.n_noise else []",
        "apart.get(best, [])",
        (TEST_ADAPTED,),
    ),
)
