"""The residual generators of ``models/truck.toml`` that the monitor runs: written where the gateway is built.

A checkout that nobody has installed writes them when they are imported first.
"""

from __future__ import annotations

from pathlib import Path

#: Where they lie; module -> residual of the model, and what it shows beside it.
FOLDER = Path(__file__).parent / "monitor" / "generated"
MODULES = {
    "t1": ("T1", ()),
    "t2": ("T2", ()),
    "t5": ("T5", ()),
    "t6": ("T6", ()),
    "t7": ("T7", ("T_em", "T_c", "eta_gb", "u_gb", "J_tot", "m_v")),
}


def make() -> None:
    """Write the modules that are not there."""
    missing = [module for module in MODULES if not (FOLDER / f"{module}.py").exists()]
    if not missing:
        return
    from gateway_fdi.common.resources import shipped  # noqa: PLC0415 - only where they are written
    from gateway_fdi.structure.file import load_model  # noqa: PLC0415
    from gateway_fdi.structure.generator.code import write  # noqa: PLC0415
    from gateway_fdi.structure.generator.realisation import realise  # noqa: PLC0415

    model = load_model(shipped("models/truck.toml"))
    for module in missing:
        name, outputs = MODULES[module]
        choice = model.residuals[name]
        written = write(name, realise(model, choice.equations, choice.consistency, outputs=outputs))
        draft = FOLDER / f"{module}.draft"
        draft.write_text(written.source)
        draft.replace(FOLDER / f"{module}.py")  # another process finds all of it, or nothing


if __name__ == "__main__":
    make()
