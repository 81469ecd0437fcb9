"""What changes slowly without a fault: relative errors of parameters, gains and biases of sensors, lags.

`filter` follows them, a Kalman filter over the sensitivities of equations that hold without a fault. `shares` does so
for a model that is moved along with what is found, and whose sensitivities are measured beside it. `lag` finds by how
much one reading of a quantity is behind another. All are mathematics: what the equations are is a monitor's business.
"""
