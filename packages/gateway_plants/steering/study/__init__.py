"""Steering (paper 001): estimators and tests side by side, Figs. 4 to 7, Table 1, detection."""
