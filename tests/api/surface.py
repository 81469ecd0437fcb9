"""Prints the public surface, as docs/api.txt has it: ``python tests/api/surface.py > docs/api.txt``."""

import importlib
import inspect
import re
import sys
from collections.abc import Iterator
from types import GenericAlias

MODULES = (
    "gateway_api",
    "gateway_fdi",
    "gateway_plants.crank.arrays",
    "gateway_plants.pedal.arrays",
    "gateway_plants.linear.arrays",
)


#: Made by functions, not by users.
MADE = {"Analysis", "Calibrated", "Config", "Found", "Learned", "Run", "Series", "SeriesSet"}
MADE |= {"Session", "Setup", "Teeth", "Voted"}


def _named(kinds) -> str:
    """Return annotations as text; the types of named tuples are references up to Python 3.13, or not."""
    return re.sub(r"ForwardRef\('(.*?)'\)", r"\1", str(kinds))


def _signature(thing) -> str:
    if isinstance(thing, GenericAlias):  # Python 3.13 would say (*args, **kwargs)
        return "(...)"
    try:
        return _named(inspect.signature(thing)).replace("'", "")
    except ValueError:
        return "(...)"


def _members(cls) -> Iterator[str]:
    """Yield the public members of a class of ours, one line each; those of a configuration are in its schema."""
    if not cls.__module__.startswith("gateway") or cls.__name__ == "Config":
        return
    fields = inspect.get_annotations(cls)
    yield from (f"  {name}: {_named(kind)}" for name, kind in sorted(fields.items()) if not name.startswith("_"))
    for name, member in sorted(vars(cls).items()):
        if (name.startswith("_") and name not in ("__getitem__", "__enter__", "__arrow_c_stream__")) or name in fields:
            continue
        function = member.__func__ if isinstance(member, classmethod | staticmethod) else member
        if inspect.isfunction(function):
            yield f"  {name}{_signature(function)}"
        else:
            yield f"  {name}"


def surface() -> str:
    """Return the public names of all modules with their arguments."""
    lines = []
    for module in MODULES:
        lines += [f"{module}", "=" * len(module)]
        found = importlib.import_module(module)
        for name in sorted(found.__all__):
            thing = getattr(found, name)
            if inspect.isclass(thing):
                lines += [f"class {name}{'' if name in MADE else _signature(thing)}", *_members(thing)]
            elif callable(thing):
                lines.append(f"{name}{_signature(thing)}")
            else:
                lines.append(f"{name}")
        lines.append("")
    return "\n".join(lines)


if __name__ == "__main__":
    sys.stdout.write(surface())
