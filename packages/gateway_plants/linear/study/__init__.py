"""Study of the bank of PI observers: the paper's example, its figures, and faults that it was not made for."""
