"""Residual generators as C99: strict compilers take them, and they give what the kernels give, to 1e-12."""

import ctypes
import re
import subprocess

import numpy as np
import pytest
import truck_data
from command import command
from debian import program
from residual_runner import Runner

from gateway_fdi.structure.analysis import analyse
from gateway_fdi.structure.generator.c_code import c_source
from gateway_fdi.structure.generator.loading import residual_generator
from gateway_fdi.structure.generator.solver import NotSolvableError

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")


@pytest.fixture(autouse=True)
def _needs_gcc():
    program("gcc", "gcc", "libc6-dev")


def verdict(folder, source):
    """Compile a file with its test and run that; returns exit code and what it said."""
    name = re.search(r"#ifdef (\w+_TEST)", source)[1]
    (folder / "residual.c").write_text(source)
    made = ["gcc", *STRICT, f"-D{name}", folder / "residual.c", "-o", folder / "residual", "-lm"]
    subprocess.run(made, check=True, capture_output=True, text=True)
    subprocess.run(["gcc", *STRICT, "-c", folder / "residual.c", "-o", folder / "library.o"], check=True)
    ended = subprocess.run([folder / "residual"], check=False, capture_output=True, text=True)
    return ended.returncode, ended.stdout


@pytest.mark.long
@pytest.mark.parametrize(
    ("model", "count"), [("motor", 4), ("three_tanks", 4), ("servo_valve", 6), ("series_machine", 1), ("truck", 6)]
)
def test_c_is_the_kernel(load, tmp_path, model, count):
    """Generators of all kinds: states, filters of one and two derivatives, loops, several solutions, tables."""
    loaded = load(model)
    choices = [(name, c.equations, c.consistency) for name, c in loaded.residuals.items()]
    if not choices:
        found = analyse(loaded)
        usable = np.flatnonzero(found.candidates.chosen("SDI", "unique"))
        choices = [
            (f"set {k}", frozenset(found.structure.names(found.msos[found.candidates.mso[k]])),
             found.structure.equations[found.candidates.equation[k]])
            for k in usable
        ]  # fmt: skip
    done = 0
    for name, equations, consistency in choices:
        try:
            generator = residual_generator(
                loaded, equations, consistency, start={x: 0.2 for x in loaded.states if x not in ("SoC", "m_f")}
            )
        except NotSolvableError:
            continue
        source = c_source(generator, name)
        code, said = verdict(tmp_path, source)
        assert code == 0, said
        assert "50 samples, 0 wrong" in said
        expected = source.partition("expected[50] = {")[2].partition("};")[0]
        assert any(abs(float(x)) > 1e-3 for x in expected.replace("NAN", "0").split(","))
        done += 1
        if done == count:
            return
    raise AssertionError(f"{done} of {count}")


def test_its_test_can_fail(load, tmp_path):
    model = load("motor")
    source = c_source(residual_generator(model, frozenset({"e1", "e4", "e5"}), "e1"), "e1")
    assert verdict(tmp_path, source)[0] == 0
    assert ".R = 0.5," in source
    code, said = verdict(tmp_path, source.replace(".R = 0.5,", ".R = 0.5000001,"))
    assert code == 1
    assert "50 wrong" in said


@pytest.mark.parametrize("name", ["T4_ICDS", "T3_MCDS"])
def test_on_a_drive(load, tmp_path, name):
    """The truck's residuals over a faulty and noisy drive, the C file as a library."""
    model = load("truck")
    choice = model.residuals[name]
    loaded = residual_generator(model, choice.equations, choice.consistency)
    (tmp_path / "r.c").write_text(c_source(loaded, "r"))
    library = tmp_path / "r.so"
    subprocess.run(["gcc", *STRICT, "-O2", "-fPIC", "-shared", tmp_path / "r.c", "-o", library, "-lm"], check=True)
    functions = ctypes.CDLL(str(library))
    functions.r_step.restype = ctypes.c_double
    rows = truck_data.drive(5, 7, noise=0.3, f_R=-0.2, f_pe=-0.01, f_eta=-0.1)
    expected = Runner(loaded).run(rows, truck_data.DT)
    state = np.zeros(loaded.state.itemsize // 8)
    const = ctypes.byref(ctypes.c_char.in_dll(functions, "r_default"))
    found = []
    for k, row in enumerate(rows):
        inputs = np.array([row.get(z, 0.0) for z in loaded.inputs.names])
        u, s = inputs.ctypes.data_as(ctypes.c_void_p), state.ctypes.data_as(ctypes.c_void_p)
        if k == 0:
            functions.r_reset(s, const)
            functions.r_start(s, const, u)
        found.append(functions.r_step(s, const, u, ctypes.c_double(truck_data.DT if k else 0.0)))
    assert np.abs(expected).max() > 1e-2
    assert np.abs(np.array(found) - expected).max() <= 1e-12 * max(1.0, np.abs(expected).max())


def test_names_that_c_has(tmp_path):
    """Unknowns and parameters that are words of C, or of <math.h>."""
    from gateway_fdi.structure.file import load_model

    (tmp_path / "odd.toml").write_text(
        """
        [unknown]
        double = {}
        y1 = {}
        [known]
        pow = {}
        int = {}
        [parameter]
        float = { value = 2.0 }
        [equation.e1]
        relation = "der(double) = float * pow - double ** 3"
        unique = ["der(double)"]
        [equation.e2]
        relation = "y1 = double"
        unique = ["y1", "double"]
        [equation.e3]
        relation = "int = y1 if y1 > 0.7 else min(y1, 0.5)"
        unique = ["y1"]
        """
    )
    model = load_model(tmp_path / "odd.toml")
    loaded = residual_generator(model, frozenset({"e1", "e2", "e3"}), "e3", start={"double": 0.5})
    code, said = verdict(tmp_path, c_source(loaded, "9 lives"))
    assert code == 0, said


@pytest.mark.costly
def test_the_command(tmp_path, capsys, monkeypatch):
    out = tmp_path / "t1.c"
    ended = command(capsys, monkeypatch, "structure", "truck", "--residual", "T1", "--export", "c", "-o", out)
    assert ended.code == 0
    assert verdict(tmp_path, out.read_text())[0] == 0
    for options, said in (
        (("--export", "c"), "of a residual generator: --residual NAME"),
        (("--residual", "T1", "--export", "ada"), "--export = 'ada': there is c"),
        (("--residual", "T1", "-o", out), "goes with --export"),
        (("--residual", "T1", "--export", "c", "-o", tmp_path / "no" / "x.c"), "cannot be written"),
    ):
        ended = command(capsys, monkeypatch, "structure", "truck", *options)
        assert ended.code == 2
        assert said in ended.err
