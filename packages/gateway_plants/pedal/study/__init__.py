"""The voters side by side: the paper's Figs. 9 to 14, and the faults that it leaves out (paper 002)."""
