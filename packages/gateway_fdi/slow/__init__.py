"""What changes slowly without a fault: relative errors of parameters, gains and biases of sensors, lags.

`filter` follows them, a Kalman filter over sensitivities: of equations that hold without a fault, or of residuals.
`lag` finds by how much one reading of a quantity is behind another. Both are mathematics: what the equations are is a
monitor's business.
"""
