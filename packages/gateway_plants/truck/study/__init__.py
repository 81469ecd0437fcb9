"""Study of the hybrid powertrain's tests: firing table, disturbances, the figures of paper 004."""
