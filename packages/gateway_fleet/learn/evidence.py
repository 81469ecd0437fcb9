"""How much frames must say for what is claimed of them."""

import numpy as np

#: Chance explains what is claimed with a probability below one in 10^9: so many bits beyond what was free to be chosen.
LEAST_EVIDENCE = float(9.0 / np.log10(2.0))
