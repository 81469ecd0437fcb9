"""Slow changes without a fault: relative errors of parameters, gains and biases of sensors, lags.

`filter` follows them, a Kalman filter over sensitivities: of equations that hold without a fault, or of residuals.
`lag` finds by how much one reading of a quantity is later than another. Both are mathematics: the equations are a
monitor's business.
"""
