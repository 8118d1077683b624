"""CMA-ES of the library ``cma`` with less around what it learns in every generation."""

from __future__ import annotations

import numpy as np
from cma import CMAEvolutionStrategy

from sysid_evo.arrays import Array

FAR = 1e6
"""How many times the first sigma the present one may be before the library itself must look after it."""


class CmaSearch(CMAEvolutionStrategy):  # type: ignore[misc]  # the library has no types
    """The search of ``cma`` where candidates have no bounds, are real numbers, and come from itself alone."""

    mean: Array
    pc: Array

    def learn(self, candidates: Array, costs: Array) -> None:
        """Learn from ``candidates`` (P, n), just asked for, and their ``costs`` (P,).

        The mean, paths, covariance and sigma become what `tell` makes them, bit by bit, in half of the time: `tell`
        also looks for candidates that were injected, repaired or rounded, and keeps what decides when to stop.
        The letters are those of Hansen's tutorial (2016, appendix A). The first generation, which prepares the later
        ones, is left to it, and so are small populations, in which it mirrors candidates, and what is rare.
        """
        injects = self.sp.lam_mirr or self.mean_shift_samples or self.opts["pc_line_samples"]
        if self.countiter < 1 or injects or not self.gp.isidentity or self.sigma > FAR * self.sigma0:
            self.tell(candidates, costs.tolist(), check_points=False)
            return
        self.number_of_solutions_asked = 0
        self.countiter += 1
        self.countevals += len(candidates)
        weights, scaling = self.sp.weights, self.sigma_vec.scaling
        best_first = candidates[np.argsort(costs)]
        old = self.mean_old = self.mean
        self.mean = np.dot(weights.positive_weights, best_first[: weights.mu])
        h_sigma = self.adapt_sigma.hsig(self)  # takes in p_sigma
        rates = self.sm.parameters(mueff=weights.mueff, lam=weights.lambda_)
        c_c, c_1, c_mu = self.sp.cc, rates["c1"], rates["cmu"]
        c_1a = c_1 * (1 - (1 - h_sigma**2) * c_c * (2 - c_c))
        length = (c_c * (2 - c_c) * weights.mueff) ** 0.5 / self.sigma / self.sp.cmean
        self.pc = (1 - c_c) * self.pc + h_sigma * length * (self.mean - old) / scaling
        steps = (best_first - old) / (self.sigma * scaling)
        shares = np.array([c_1a, *(c_mu * weight for weight in weights(len(steps)))])
        self.sm.update(np.concatenate([[(c_1 / (c_1a + 1e-23)) ** 0.5 * self.pc], steps]), shares)
        self._updateBDfromSM(self.sm)
        self.sigma *= self.adapt_sigma.update2(self, function_values=costs)
        self._stds_into_limits()
        self._flgtelldone = True
