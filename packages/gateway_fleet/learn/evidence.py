"""How much evidence frames must give for a claim."""

import numpy as np

#: Chance explains a claim with a probability below one in 10^9: bits of evidence beyond those free to be chosen.
LEAST_EVIDENCE = float(9.0 / np.log10(2.0))
