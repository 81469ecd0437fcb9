"""Models of requests and answers: the OpenAPI document is made of them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

#: A whole number; JSON writes 5 and 5.0 for the same.
Whole = Annotated[int, BeforeValidator(lambda it: int(it) if isinstance(it, float) and it.is_integer() else it)]


class Model(BaseModel):
    """A JSON object; what is None is left out."""

    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    def as_json(self) -> dict[str, Any]:
        """Return it for JSON."""
        return self.model_dump(mode="json", by_alias=True, exclude_none=True)


class Body(Model):
    """The body of a request: no type is converted into another."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Described(Model):
    """An answer that has its own schema, where it is asked for (``include-schema=true``)."""

    schema_: dict[str, Any] | None = Field(None, alias="schema")


class Describing(Model):
    """Whether an answer is to have its schema."""

    include_schema: Literal["true", "false"] = Field("false", alias="include-schema")


class Nothing(Model):
    """No query parameters."""


class Item(Model):
    """An entry of a collection."""

    id: str
    name: str
    href: str


class Items(Model):
    """A collection."""

    items: list[Item]


class Value(Model):
    """A value, and its unit where it has one.

    Attributes:
        value: number or text; None: not known.
        unit: of the number.
        raw: hexadecimal digits, as by UDS.
    """

    value: float | str | None = None
    unit: str | None = None
    raw: str | None = None


class ReadValue(Described):
    """A value with the name of its resource."""

    id: str
    data: Value
