"""Closed-loop rollouts of many candidates in many trials, and all that a kernel is written with.

`rollout` runs P candidates in E trials on a dynamics. It has two forms with one signature. The *reference*
form is NumPy in float64; it takes any object that keeps the contracts, and the other form is tested against
it. The *compiled* form runs dynamics, controller and task as kernels, where all three have one.
`Rollouts.engine` says which ran.

**Lanes.** A compiled rollout does not go through one trial after the other. It takes 64 of them side by
side, and every quantity is an array of rows of 64 numbers, one for each rollout, its *lane*: number i of
lane l stands at ``i * LANES + l``. A kernel is a function over one such block. It loops over the lanes in
its innermost loop, and the compiler turns that loop into vector instructions, eight or sixteen lanes at a
time::

    def decay(carry, control, noise, parameters, scratch):
        for row in range(3):
            here = view(carry, row * LANES)
            for lane in range(LANES):
                here[lane] *= parameters[row]

For this to work:

- The innermost loop has no branches that differ between lanes: write ``a if test else b``, ``min``, ``max``.
- ``view(array, n)`` is the array from element n on. A slice would count references in the loop, and an
  index ``start + lane`` would be tested for its sign; both keep the loop from becoming vectors.
- A sum over many rows is kept in registers with ``load``, ``splat`` and ``store``, which move a whole row. Short
  work on several arrays is faster with them too: a loop over lanes first tests whether its arrays overlap.
- Real numbers are written with a point: ``2 * x`` makes a float64 number of a float32 one. All literals,
  and ``math.sin`` and the like, are turned into the kernel's own precision (float32 unless told otherwise).
- Nothing is allocated. A kernel says how many rows of ``scratch`` it wants.

**Parameters.** A kernel gets one flat array. `Layout` names the numbers at its head; in the kernel,
``parameters[HEAD.dt]`` reads one, and ``HEAD.size`` is where its own begin. The arguments of each kind of
kernel are `DYNAMICS`, `CONTROLLER`, `OBSERVE` and `ADVANCE`, each a `Signature`.

**Three ways to a kernel of a model**, the shorter first: a predictor of this module (networks,
polynomials, neighbours) in `stepping_kernel`; a step of one sample, `Lifted` to all lanes; a block function
of one's own. Integration and the turning of the body's frame come from the system's motion. A motion
without a compiled form has none here either: shells then return None, and the model runs in NumPy.

**Where it is slow.** The first call compiles (a second or so, kept on disk). Less than 64 rollouts cost as
much as 64. Everything that follows is the same for any number of threads.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
