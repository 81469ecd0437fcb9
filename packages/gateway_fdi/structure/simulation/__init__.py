"""A structural model simulated: from its equations, in any order, to its variables over time.

``reduction`` differentiates what must be (Pantelides) and chooses the states that are left (dummy derivatives);
``system`` orders the equations into blocks and writes them as functions; ``plant`` runs them with SciPy's solver.
"""
