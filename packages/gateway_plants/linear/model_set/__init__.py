"""A linear plant whose parameters are not known exactly: one Kalman filter a hypothesis, and evidence between them."""
