"""Evidence of faults: how likely each is, from signs and sizes, beside all that may be off without a fault.

Residuals of a plant are taken as

    r(t) = H(t) x(t) + sum over faults f of G_f(t) (1 + eps) s_f + e(t)

x: slow errors (parameters, gains and biases of sensors) with a prior, and a jitter from block to block for dynamics
that the model lacks; s_f: size of a fault; eps: error of its gain, one for each residual; e: noise, by its long-run
covariance. All is linear and Gaussian, so likelihoods are exact where the model is.

- :mod:`~gateway_fdi.evidence.model`: what is said of a plant;
- :mod:`~gateway_fdi.evidence.quadratic`: the one operation that everything is made of;
- :mod:`~gateway_fdi.evidence.blocks`: samples into statistics of blocks;
- :mod:`~gateway_fdi.evidence.hypotheses`: likelihood and size of each fault.

Willsky and Jones, "A generalized likelihood ratio approach to the detection and estimation of jumps in linear systems",
IEEE Transactions on Automatic Control 21, 1976; Basseville and Nikiforov, "Detection of abrupt changes", 1993.
"""
