"""What is drawn of a state without a motion."""

import numpy as np

from evaluation.plot_style import new_figure
from evaluation.plots import plot_state, plotted_states
from evaluation.transfer.matrix import Trace
from sysid_evo.data import Trajectory
from sysid_evo.system import Channel
from sysid_evo.tasks import Target
from sysid_evo.testing.examples import pendulum


def test_an_angle_is_drawn_beside_its_target_and_its_line_breaks_where_it_jumps():
    system = pendulum()
    states = np.array([[0.1, 0.0], [2.0, 0.0], [4.0, 0.0], [7.0, 0.0]])
    target = Target(Channel("angle", "rad", period=2 * np.pi), 0, np.array([np.pi]), 0.5)
    trace = Trace(Trajectory(states, np.zeros((3, 1)), 0.02), 1.0, targets=(target,))
    assert plotted_states(trace, system) == (0,)
    wanted, drawn = plot_state(trace, system, 0, new_figure(3.4, 1.6).add_subplot()).get_lines()
    np.testing.assert_array_equal(wanted.get_ydata(), np.pi)
    np.testing.assert_allclose(drawn.get_ydata(), [0.1, 2.0, 4.0, np.nan], atol=1e-12)
    assert plotted_states(Trace(trace.trajectory, 1.0), system) == (0, 1)
