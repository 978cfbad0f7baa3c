"""Inputs of the fields' table: those of `priors stress`, and what only rays and densities have."""

from priors.stress import inputs as shared
from priors.stress.inputs import Input
from priors.stress.routine import without

THIN = Input("sigma 1e-6", "a density of 1e-6 1/m: nothing", lambda precision: (1e-6,))
SOLID = Input("sigma 1e9", "a density of 1e9 1/m: a wall", lambda precision: (1e9,))
LONG = Input("4096 samples", "4096 samples on a ray")
CENTRAL = Input("central rays", "rays through the origin of the space")
PARALLEL = Input("parallel rays", "rays parallel to a face of the space")
INPUTS = (*shared.INPUTS, THIN, SOLID, LONG, CENTRAL, PARALLEL)

NO_SIGMA = without(THIN.name, SOLID.name, why="it sees no density")
NO_SAMPLES = without(LONG.name, why="it sees no rays of samples")
NO_RAYS = without(CENTRAL.name, PARALLEL.name, why="it does not see where rays go")
