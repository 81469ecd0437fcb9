"""The steering motor's estimators and tests side by side: the paper's Figs. 4 to 7, its Table 1, and detection (paper 001)."""
