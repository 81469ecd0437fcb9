"""What a configuration says of causes: how often parts fail, and what hangs on one supply."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from gateway_fdi.common.tomlfile import StrictModel


class SupplyParams(StrictModel):
    """A supply or a ground that several parts share."""

    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", description="of it alone")
    kind: Literal["supply", "ground"] = Field("supply", description="what it is")
    feeds: tuple[str, ...] = Field(
        min_length=1, description='what hangs on it: an ECU or a message of a database, or "Message.Signal"'
    )
    share: float = Field(
        0.9, gt=0, lt=1, description="how likely a test fails by it, against its failing by what it feeds"
    )

    @model_validator(mode="after")
    def _once(self) -> Self:
        for k, name in enumerate(self.feeds):
            if name in self.feeds[:k]:
                raise ValueError(f"feeds names {name} twice")
        return self


class DiagnosisParams(StrictModel):
    """What causes are weighed by."""

    priors: dict[str, float] = Field(
        default_factory=dict,
        description="how often parts are faulty, above 0, at most 0.5: by kind (sensor, ecu, ...), or by the name that"
        ' a diagnosis has ("ecu chassis.Brakes")',
    )
    supply: tuple[SupplyParams, ...] = Field((), description="supplies and grounds that parts share")

    @model_validator(mode="after")
    def _fit(self) -> Self:
        for name, prior in self.priors.items():
            if not 0.0 < prior <= 0.5:
                raise ValueError(f"priors.{name} = {prior}: above 0, at most 0.5")
        names = [one.name for one in self.supply]
        for k, name in enumerate(names):
            if name in names[:k]:
                raise ValueError(f"two supplies are called {name}")
        return self
