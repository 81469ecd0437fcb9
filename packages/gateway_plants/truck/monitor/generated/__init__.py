"""Residual generators of ``models/truck.toml``: change the model, not these.

``scripts/generate-residuals`` writes them.
"""

#: Module -> residual of the model, and what it shows beside it.
GENERATED = {
    "t1": ("T1", ()),
    "t2": ("T2", ()),
    "t5": ("T5", ()),
    "t6": ("T6", ()),
    "t7": ("T7", ("T_em", "T_c", "eta_gb", "u_gb", "J_tot", "m_v")),
}
