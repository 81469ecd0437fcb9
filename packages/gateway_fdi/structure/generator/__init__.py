"""Residual generators that run: from a computation sequence and the equations to a kernel.

`symbols` reads equations into algebra, `solving` solves a step, `realisation` puts the steps, the states and the
residual together, `initial` finds where states begin (24), `conditioning` whether they forget that, `code` writes the
kernel, `sources` makes a module of it, `loading` both at once, `records` fills its constants, `runtime` is what it
calls.
"""
