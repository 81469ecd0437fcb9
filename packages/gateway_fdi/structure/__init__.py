"""Structural analysis (paper 004): from a model's equations to the residual generators that it has.

`model` says what an analysis starts from, `relation` and `file` how it is written down. `incidence`, `matching`,
`blocks` and `steps` are its graph; `decomposition`, `mso`, `mtes`, `sequence`, `candidates`, `isolability`,
`selection` and `sensors` the questions asked of it; `generator` makes a kernel of an answer.
"""
