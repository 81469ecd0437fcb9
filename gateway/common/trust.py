"""Code that is not of the installation runs only after a person has trusted it, by the hash of what it is.

A configuration, a scenario or a model may name code that lies beside it: modules of monitors, virtual ECUs, key
functions and protections, methods of the arena and what they have learned (pickles), FMUs. A user who opens a file of
others has not read that code, though the file belongs to him. So nothing of it is imported, unpickled or loaded before
its hash stands in a list of this user's or of the administrator's; ``--trust`` takes all for one run. Code of the
installation (the folders of packages, what is installed as editable) is the user's own, and needs no more.

Modules beside a configuration come by :class:`_Finder`, and not by ``sys.path``: each is read, hashed and compiled
from the same bytes, without the compiled copy that may lie beside it, and none hides an installed one.
"""

from __future__ import annotations

import ast
import hashlib
import os
import re
import site
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

from gateway_fdi.common.log import get_logger
from gateway_fdi.errors import InputError

#: Variable of the environment that takes all code, with this value: what ``--trust`` sets, for this process and those
#: that it starts.
VARIABLE, ALL = "GATEWAY_TRUST", "all"
#: The administrator's list, for every user of this machine; Windows has no folder that only he can make.
SYSTEM: Path | None = Path("/etc/gateway/trusted") if hasattr(os, "geteuid") else None
#: Bytes of a module that are looked through at most.
_LONGEST = 1 << 22
#: How lines of a .pth file begin that are no folder.
_CODE = ("import ", "import\t", "#")
_LINE = re.compile(r"([0-9a-f]{64})  (.*)")

#: Folders of configurations and scenarios that were read, in which modules are looked for; of these top-level modules
#: one is asked for by its name.
_folders: list[Path] = []
_claimed: dict[str, Path] = {}
#: Folders whose code runs already (pytest's).
_running: set[Path] = set()


def user_list() -> Path:
    """Return the file with this user's list."""
    import platformdirs  # noqa: PLC0415 - few starts need it

    return Path(platformdirs.user_config_dir("ecu-gateway")) / "trusted"


def entries(file: Path) -> dict[str, str]:
    """Return the hashes of a list and the paths that they were of, none where there is no list.

    Raises:
        InputError: others can write it, or it cannot be read.
    """
    from gateway_fdi.jit import ownership  # noqa: PLC0415 - brings NumPy and the kernels

    try:
        lines = ownership.read_own(file).decode("utf-8", "replace").splitlines()
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise InputError(f"this list of trusted code is not used: {error.strerror}", file=file) from error
    found = (_LINE.fullmatch(line) for line in lines)
    return {match[1]: match[2] for match in found if match}


def digest(data: bytes) -> str:
    """Return what names code."""
    return hashlib.sha256(data).hexdigest()


def is_trusted(path: Path, data: bytes) -> bool:
    """Return whether code may run.

    Raises:
        InputError: a list cannot be used.
    """
    if os.environ.get(VARIABLE) == ALL or is_installed(path) or _running.intersection(path.absolute().parents):
        return True
    name = digest(data)
    return any(name in entries(file) for file in filter(None, (SYSTEM, user_list())))


def verified(path: Path, what: str = "its code") -> bytes:
    """Return the bytes of a file of code that may run.

    Args:
        path: of the file.
        what: it is, for the error.

    Raises:
        InputError: it may not; with the command that trusts it.
        OSError: it cannot be read.
    """
    data = path.read_bytes()
    if not is_trusted(path, data):
        raise untrusted(path, what)
    return data


def untrusted(path: Path, what: str = "its code") -> InputError:
    """Return the error of code that may not run."""
    path = path.absolute()
    text = (
        f"not checked, and not run: {what}, {path}, is not trusted, or has changed; after a look at it:"
        f" gateway trust {path} (or --trust for one run)"
    )
    return InputError(text)


def trust_all() -> None:
    """Take all code, in this process and those that it starts."""
    os.environ[VARIABLE] = ALL


def runs_already(folder: Path) -> None:
    """Take the code of a folder: its user has run it (pytest)."""
    _running.add(folder.absolute())


@cache
def _installation() -> tuple[tuple[Path, ...], frozenset[Path]]:
    """Return the folders of the interpreter and its packages, and those that editable packages were installed from."""
    paths = sysconfig.get_paths()
    places = [paths[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")]
    packages = [paths["purelib"], paths["platlib"], *site.getsitepackages()]
    if site.ENABLE_USER_SITE:
        packages.append(site.getusersitepackages())
    editable = set()
    for folder in dict.fromkeys(map(Path, packages)):
        for file in sorted(folder.glob("*.pth")):
            lines = file.read_text("utf-8", "replace").splitlines()
            editable |= {
                (folder / line.strip()).resolve() for line in lines if line.strip() and not line.startswith(_CODE)
            }
    return tuple(Path(place).resolve() for place in dict.fromkeys([*places, *packages])), frozenset(editable)


def is_installed(path: Path) -> bool:
    """Return whether a file lies in the folders of the interpreter and its packages."""
    return any(path.resolve().is_relative_to(place) for place in _installation()[0])


def _spec(top: str) -> ModuleSpec | None:
    """Return where Python itself would find a top-level module; nothing is imported."""
    for finder in sys.meta_path:
        find = getattr(finder, "find_spec", None)
        if find is not None and not isinstance(finder, _Finder):
            spec: ModuleSpec | None = find(top, None)
            if spec is not None:
                return spec
    return None


def _is_of_installation(top: str) -> bool:
    """Return whether a top-level module is one of the installation."""
    loaded = sys.modules.get(top)
    if loaded is not None and not isinstance(getattr(loaded, "__loader__", None), _Loader):
        return True  # its code runs already
    spec = _spec(top)
    if spec is None:
        return False
    if spec.origin in ("built-in", "frozen"):
        return True
    places = [Path(spec.origin).parent] if spec.origin is not None else []
    if spec.submodule_search_locations is not None:
        places = [Path(place).parent for place in spec.submodule_search_locations] or places
    whole, editable = _installation()
    by_hook = PathFinder.find_spec(top) is None  # of an installed package, as some editable ones have
    return by_hook or all(
        place.resolve() in editable or any(place.resolve().is_relative_to(one) for one in whole) for place in places
    )


def _place_in(folder: Path, module: str) -> Path | None:
    """Return the file of a module in a folder, None: there is none."""
    stem = folder.joinpath(*module.split("."))
    return next((file for file in (stem / "__init__.py", stem.with_name(f"{stem.name}.py")) if file.is_file()), None)


def _local(module: str) -> tuple[Path, Path] | None:
    """Return the folder and the file of a module that is not of the installation, None: there is none."""
    top = module.partition(".")[0]
    on_path = [Path(place).absolute() for place in sys.path]
    for folder in dict.fromkeys([*filter(None, [_claimed.get(top)]), *on_path, *_folders]):
        if (file := _place_in(folder, module)) is not None:
            return folder, file
    return None


def file_of(module: str) -> Path | None:
    """Return the file of a module's code; nothing is imported.

    Args:
        module: its name, with dots.
    """
    if _is_of_installation(module.partition(".")[0]):
        for place in (Path(place).absolute() for place in sys.path):
            if (file := _place_in(place, module)) is not None:
                return file
    found = _local(module)
    return None if found is None else found[1]


def require(module: str, name: str) -> None:
    """Let a module be imported that a configuration names, if it may be.

    Args:
        module: its name, with dots.
        name: of what it is to have, with dots.

    Raises:
        InputError: it may not, or has no such name.
    """
    if any(not part.isidentifier() for part in module.split(".")) or _is_of_installation(module.partition(".")[0]):
        return
    found = _local(module)
    if found is None:
        return
    folder, file = found
    top = module.partition(".")[0]
    of_package = [_place_in(folder, ".".join(module.split(".")[:k])) for k in range(1, module.count(".") + 1)]
    for each in dict.fromkeys([*filter(None, of_package), file]):
        data = _read(each)
        if not is_trusted(each, data):
            lacks = _lacks(data, name.partition(".")[0]) if each == file else ""
            if lacks:
                raise InputError(f"{each} {lacks}")
            raise untrusted(file)
    _claimed[top] = folder
    _find_here()


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(error.strerror or str(error), file=path) from error


def _parsed(data: bytes) -> ast.Module | None:
    """Return what a module says, None where it is too long for a look.

    Raises:
        SyntaxError, ValueError, RecursionError, MemoryError: it is no Python.
    """
    return ast.parse(data) if len(data) <= _LONGEST else None


def _lacks(data: bytes, name: str) -> str:
    """Return what is wrong with a module that is to have a name, "": nothing that is seen without running it."""
    try:
        tree = _parsed(data)
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        return f"cannot be imported: {type(error).__name__}: {error}"
    if tree is None:
        return ""
    words: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            words.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            words.add(node.id)
        elif isinstance(node, ast.alias):
            words.add((node.asname or node.name).partition(".")[0])
    return "" if name in words or words & {"*", "__getattr__", "globals"} else f"has no {name}"


def _imports(file: Path) -> Iterator[Path]:
    """Yield the files of modules beside a file that it imports."""
    try:
        tree = _parsed(file.read_bytes())
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        return
    if tree is None:
        return
    for node in ast.walk(tree):
        names: list[str] = []
        base = file.parent
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = base.joinpath(*[".."] * (node.level - 1)) if node.level else base
            stem = [node.module] if node.module else []
            names = [*stem, *(".".join([*stem, alias.name]) for alias in node.names)]
        for name in names:
            parts = name.split(".")
            for k in range(1, len(parts) + 1):
                if (found := _place_in(base, ".".join(parts[:k]))) is not None:
                    yield found


def reachable(file: Path) -> list[Path]:
    """Return a file of code, its packages, and the modules beside it that it imports, as its text says."""
    found, waiting = [], [file]
    while waiting:
        one = waiting.pop()
        if one not in found:
            found.append(one)
            if one.suffix == ".py":
                package = one.parent.parent if one.name == "__init__.py" else one.parent
                waiting += [*_imports(one), *filter(Path.is_file, [package / "__init__.py"])]
    return found


def add(files: Iterable[Path], into: Path) -> list[tuple[str, Path]]:
    """Write files of code into a list; returns the hash and the path of each.

    Raises:
        InputError: a file cannot be read; the list cannot be written, or is not this user's.
    """
    from gateway_fdi.jit import ownership  # noqa: PLC0415 - brings NumPy and the kernels

    known = entries(into)
    new = [(digest(_read(file)), file.absolute()) for file in files]
    lines = known | {name: str(path).replace("\n", "?") for name, path in new}
    part = into.with_name(f".{into.name}.{os.getpid()}.part")
    try:
        into.parent.mkdir(parents=True, exist_ok=True, mode=0o755 if into == SYSTEM else 0o700)
        ownership.write_own(part, "".join(f"{name}  {path}\n" for name, path in lines.items()).encode())
        part.chmod(0o644 if into == SYSTEM else 0o600)
        part.replace(into)
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}", file=into) from error
    return new


def add_own(files: Iterable[Path]) -> None:
    """Trust code that this user has had written by a command, such as a copy of an example; told where it cannot be."""
    if os.environ.get(VARIABLE) == ALL:
        return
    try:
        add(files, user_list())
    except InputError as error:
        get_logger(__name__).warning("not trusted: the list cannot be written", error=str(error))


class _Loader(SourceFileLoader):
    """Loads a module from the bytes whose hash was looked at."""

    def get_code(self, fullname: str) -> CodeType:
        """Return the code of a module; a compiled copy beside it is not read."""
        data = verified(Path(self.path), "a module")
        code: CodeType = self.source_to_code(data, self.path)
        return code


class _Finder:
    """Finds modules beside configurations: first in the row those asked for by name, last those that they import."""

    def __init__(self, *, first: bool) -> None:
        self._first = first

    def find_spec(self, name: str, path: Sequence[str] | None, target: ModuleType | None = None) -> ModuleSpec | None:
        """Return where a module lies, None: not here, or it is not trusted."""
        top, _, last = name.rpartition(".")
        if path is not None:
            folders = [Path(place) for place in path] if top.partition(".")[0] in _claimed else []
        elif self._first:
            folders = [_claimed[name]] if name in _claimed else []
        else:
            folders = _folders
        for folder in folders:
            file = _place_in(folder, last)
            if file is not None and is_trusted(file, _read(file)):
                _claimed.setdefault(name.partition(".")[0], folder)
                inner = [str(file.parent)] if file.name == "__init__.py" else None
                loader = _Loader(name, str(file))
                return spec_from_file_location(name, file, loader=loader, submodule_search_locations=inner)
            if file is None and name.partition(".")[0] in _claimed and (folder / last).is_dir():
                spec = ModuleSpec(name, None, is_package=True)  # a folder without __init__.py
                spec.submodule_search_locations = [str(folder / last)]
                return spec
        if folders and name.partition(".")[0] in _claimed:  # another finder would run it
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


def _find_here() -> None:
    """Let Python find modules beside configurations."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        first: Any = _Finder(first=True)
        last: Any = _Finder(first=False)
        sys.meta_path.insert(0, first)
        sys.meta_path.append(last)


def beside(folder: Path) -> None:
    """Look for modules that files name in a folder, too."""
    place = folder.resolve()
    if place not in _folders:
        _folders.append(place)


def importable(folder: Path) -> None:
    """Let modules that lie in a folder be imported, if they may be; installed ones come first."""
    beside(folder)
    _find_here()


def lacking(error: BaseException) -> InputError | None:
    """Return that a module was not found because it is not trusted, None: it was not there."""
    if isinstance(error, ModuleNotFoundError) and error.name and (found := _local(error.name)) is not None:
        return None if is_trusted(found[1], _read(found[1])) else untrusted(found[1], "a module that it imports")
    return None
