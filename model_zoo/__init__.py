"""Model families. Every file here is one family, and nothing else; start with `linear`, the shortest.

A family reaches the rest through the registry of models, by the name in its decorator and in the entry
points of pyproject.toml. What several families share stands in the folders beside them:

- ``channels``: features, centre and size of each channel, the mirror of a body, cells of commands;
- ``validation``: held-out blocks of time that choose hyper-parameters, and the spread of a prediction;
- ``sparse``: polynomials of few terms (`sindy`, `sindy_discrete`, `narx`);
- ``networks``: networks as arrays and their training on free runs (`mlp_ensemble`, the neural ODEs);
- ``flows``: differential equations with a network in them (`neural_ode`, `neural_ode_history`, `hybrid_ode`);
- ``selection``: candidates, folds, judging by free runs, gate and weights, and the mean of what is kept (`auto`);
- ``car``: the physics of a car (`parametrised`, `hybrid_ode`);
- ``kernels``: compiled forms of single families.

The carry with lags, `fit`, `simulate` and `score` are inherited from `sysid_evo.models`.
"""
