"""One debounce for every fault of an engine."""

from collections.abc import Mapping
from dataclasses import asdict


class _Everywhere(Mapping):
    def __init__(self, settings):
        self._settings = settings

    def get(self, _fault, _default=None):
        return self._settings

    def __getitem__(self, _fault):
        return self._settings

    def __iter__(self):
        return iter(())

    def __len__(self):
        return 1


def everywhere(debounce):
    """Return settings that make any fault's debounce this one; None: as its monitor has it."""
    return _Everywhere({} if debounce is None else asdict(debounce))
