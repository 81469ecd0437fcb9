import pytest

from gateway.fdi.structure.file import load_model
from gateway.resources import shipped


@pytest.fixture(scope="session")
def truck():
    return load_model(shipped("models/hybrid_truck.toml"))


@pytest.fixture(scope="session")
def load():
    """A shipped model by its name."""
    return lambda name: load_model(shipped(f"models/{name}.toml"))
