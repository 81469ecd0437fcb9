"""The paper's own speed estimators, which need the sensor's angle: compared here, shipped by no monitor."""
