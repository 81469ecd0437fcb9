import pytest

from gateway_fdi.common.resources import shipped
from gateway_fdi.structure.file import load_model


@pytest.fixture(scope="session")
def truck():
    return load_model(shipped("models/truck.toml"))


@pytest.fixture(scope="session")
def load():
    """A shipped model by its name."""
    return lambda name: load_model(shipped(f"models/{name}.toml"))
