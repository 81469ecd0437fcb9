"""An FMU by FMPy, stepped with a fixed step.

Source: FMI 2.0.4 and 3.0.1, co-simulation: parameters and start values before initialisation, outputs of the last
communication point read before inputs are set for the next step.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping
from pathlib import Path
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any, Protocol

from fmpy import read_model_description
from fmpy.simulation import instantiate_fmu

from gateway.common.archives import refuse_large_xml, unpack
from gateway.common.trust import verified
from gateway_fdi.common.log import get_logger
from gateway_fdi.common.tomlfile import key_path
from gateway_fdi.errors import InputError, named

if TYPE_CHECKING:
    from gateway_bench.vecu.fmu.params import FmuParams

_log = get_logger(__name__)

#: Type of a variable -> how FMPy's functions for it end; of FMI 2, of FMI 3 those that are called otherwise.
_REAL = ("Real", "Float64", "Float32")
_WHOLE = ("Integer", "Enumeration", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64")


class _Variable(Protocol):
    name: str
    type: str
    causality: str
    variability: str
    valueReference: int  # noqa: N815 - FMPy's


class FmuModel:
    """A running FMU.

    Args:
        params: of the ECU.
        duration_s: length of the run [s].

    Raises:
        InputError: no FMU, none for co-simulation by FMI 2 or 3, or not for this machine; variables that are not there.
    """

    def __init__(self, params: FmuParams, duration_s: float) -> None:
        self._file, self._step_s = params.file, params.step_ms * 1e-3
        self._instance: Any = None
        self._folder = Path(mkdtemp(prefix="gateway-fmu-"))
        try:
            self._begin(params, duration_s)
        except BaseException:
            self.close()
            raise

    def _begin(self, params: FmuParams, duration_s: float) -> None:
        described = self._described()
        self._three = str(described.fmiVersion).startswith("3")
        self._variables: dict[str, _Variable] = {variable.name: variable for variable in described.modelVariables}
        for key, names, causalities in (
            ("inputs", params.inputs, ("input",)),
            ("start", params.start, ("input",)),
            ("parameters", params.parameters, ("parameter",)),
        ):
            for name in names:
                self._check(name, causalities, key_path((key, name)))
        for own, name in params.outputs.items():
            self._check(name, ("output", "local", "calculatedParameter"), key_path(("outputs", own)))
        self._outputs = tuple(dict.fromkeys(params.outputs.values()))
        try:
            self._instance = instantiate_fmu(str(self._folder), described, "CoSimulation")
            for name, value in params.parameters.items():
                self._set(name, value)
            for name in params.names:
                self._set(name, params.start.get(name, 0.0))
            if self._three:
                self._instance.enterInitializationMode(startTime=0.0)
            else:
                self._instance.setupExperiment(startTime=0.0)
                self._instance.enterInitializationMode()
            self._instance.exitInitializationMode()
        except InputError:
            raise
        except Exception as error:  # FMPy raises what it likes where a library cannot be loaded
            raise InputError(
                f"the FMU cannot be started: {_text_of(error)}", key="file", value=str(self._file)
            ) from error

    def _described(self) -> Any:
        """Return the model description of the file, which is unpacked.

        Raises:
            InputError: it is no FMU for co-simulation by FMI 2 or 3.
        """
        value = str(self._file)
        try:
            verified(self._file, "its machine code")
            unpack(self._file, self._folder)
            description = self._folder / "modelDescription.xml"
            if not description.is_file():
                raise InputError("this is no FMU: it has no modelDescription.xml")
            refuse_large_xml(description.read_bytes(), self._file, description.name)
            described = read_model_description(str(self._folder))
        except InputError as error:
            raise InputError(error.message, key="file", value=value) from error
        except Exception as error:  # FMPy raises plain Exception for what is wrong with a description
            raise InputError(f"this FMU cannot be read: {_text_of(error)}", key="file", value=value) from error
        if not str(described.fmiVersion).startswith(("2", "3")):
            raise InputError(f"an FMU of FMI 2 or 3, this is {described.fmiVersion}", key="file", value=value)
        if described.coSimulation is None:
            text = "an FMU for co-simulation; this one is for model exchange: export it with its solver"
            raise InputError(text, key="file", value=value)
        return described

    def _check(self, name: str, causalities: tuple[str, ...], key: str) -> None:
        having = {v.name: v for v in self._variables.values() if v.causality in causalities}
        if name not in having:
            text = named(f"the FMU's variables of causality {' or '.join(causalities)} are", name, having)
            raise InputError(text, key=key, value=name)
        if having[name].type not in (*_REAL, *_WHOLE, "Boolean", "String"):
            raise InputError(f"a variable of type {having[name].type} cannot be carried", key=key, value=name)
        if having[name].type == "String" and causalities != ("parameter",):
            raise InputError("a text cannot be carried by a signal", key=key, value=name)

    def _function(self, what: str, variable: _Variable) -> Any:
        type_ = variable.type
        if type_ == "Enumeration":
            type_ = "Int64" if self._three else "Integer"
        return getattr(self._instance, f"{what}{type_}")

    def _set(self, name: str, value: bool | float | str) -> None:
        variable = self._variables[name]
        if variable.type in _WHOLE:
            value = round(float(value))
        elif variable.type == "Boolean":
            value = bool(round(float(value)))
        elif variable.type in _REAL:
            value = float(value)
        self._function("set", variable)([variable.valueReference], [value])

    def _get(self, name: str) -> float:
        variable = self._variables[name]
        return float(self._function("get", variable)([variable.valueReference])[0])

    def step(self, t: float, inputs: Mapping[str, float]) -> Mapping[str, float]:
        """Return the outputs at a time [s], and let the FMU go on by a step with these inputs.

        Raises:
            InputError: it fails, or ends the simulation.
        """
        try:
            said = {name: self._get(name) for name in self._outputs}
            for name, value in inputs.items():
                self._set(name, value)
            self._go_on(t)
        except InputError:
            raise
        except Exception as error:  # FMPy's own errors, and those of its functions for C
            raise InputError(f"at {t:.4f} s: {_text_of(error)}", key="file", value=str(self._file)) from error
        return said

    def _go_on(self, t: float) -> None:
        end = t + self._step_s
        if not self._three:
            self._instance.doStep(currentCommunicationPoint=t, communicationStepSize=self._step_s)
            return
        while end - t > 1e-9 * self._step_s:  # it may return early, at an event
            _, terminate, early, last = self._instance.doStep(
                currentCommunicationPoint=t, communicationStepSize=end - t
            )
            if terminate:
                raise InputError(f"the FMU ends the simulation at {last:.4f} s", key="file", value=str(self._file))
            if not early or not math.isfinite(last) or last <= t:
                return
            t = last

    def close(self) -> None:
        """End it, and take away what was unpacked."""
        instance, self._instance = self._instance, None
        if instance is not None:
            try:
                instance.terminate()
                instance.freeInstance()
            except Exception as error:  # it is over anyway
                _log.warning("an FMU did not end cleanly", file=str(self._file), error=_text_of(error))
        shutil.rmtree(self._folder, ignore_errors=True)


def _text_of(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
