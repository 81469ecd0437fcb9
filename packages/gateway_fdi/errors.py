"""Errors that a user can mend: each names the file, the key, the value and the right form."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from pathlib import Path
from typing import Any


def nearest(name: str, known: Iterable[str]) -> str:
    """Return "; did you mean ...?" with the names closest to one that is not there, "" if none is close."""
    names = list(dict.fromkeys(known))
    folded = {other.casefold(): other for other in names}
    same = folded.get(name.casefold())
    close = [same] if same else get_close_matches(name, names, n=3, cutoff=0.5)
    return f"; did you mean {' or '.join(close)}?" if close else ""


def named(what: str, name: str, known: Iterable[str], most: int = 16) -> str:
    """Return "<what> a, b, c; did you mean b?"; where there are many, only what is close to the name."""
    names = sorted(known)
    close = nearest(name, names)
    return f"{what} {', '.join(names)}{close}" if len(names) <= most else f"{what} {len(names)}{close}"


class GatewayError(Exception):
    """Base of every error that the command line reports without a traceback."""


class InputError(GatewayError):
    """One thing wrong in a file or an argument of the user.

    Args:
        message: the error, and the right form.
        file: the file it stands in.
        line: line number in that file, counted from 1.
        key: dotted path of the key, e.g. ``monitor[0].wheel``.
        value: the offending value.
    """

    def __init__(
        self,
        message: str,
        *,
        file: str | Path | None = None,
        line: int | None = None,
        key: str | None = None,
        value: object = None,
    ) -> None:
        self.message = message
        self.file = None if file is None else str(file)
        self.line = line
        self.key = key
        self.value = value
        super().__init__(str(self))

    def within(self, file: str | Path | None) -> InputError:
        """Return the same error, found in a file, unless it names one already."""
        return self if self.file is not None or file is None else self.replace(file=file)

    def replace(self, **changed: Any) -> InputError:
        """Return the same error, of the same cause, with other arguments."""
        of_this = {name: getattr(self, name) for name in ("message", "file", "line", "key", "value")}
        made = InputError(**{**of_this, **changed})
        made.__cause__ = self.__cause__
        return made

    def __str__(self) -> str:
        place = self.file or ""
        if self.line is not None:
            place = f"{place}:{self.line}" if place else f"line {self.line}"
        subject = self.key or ""
        if self.value is not None:
            shown = repr(self.value)
            if len(shown) > 120:
                shown = shown[:117] + "..."
            subject = f"{subject} = {shown}" if subject else shown
        return ": ".join(part for part in (place, subject, self.message) if part)


class MissingError(InputError, KeyError):
    """A name that is not there: also a KeyError, so that ``in`` and ``get`` of a mapping work."""

    __str__ = InputError.__str__


class InputErrors(GatewayError):
    """Several input errors found in one pass, so that a user can mend all of them at once."""

    def __init__(self, errors: list[InputError]) -> None:
        self.errors = errors
        super().__init__("\n".join(str(error) for error in errors))


def each_of(error: InputError | InputErrors) -> list[InputError]:
    """Return the single errors of an error."""
    return error.errors if isinstance(error, InputErrors) else [error]


@contextmanager
def under(key: str, value: object = None, *, whole: bool | None = None) -> Iterator[None]:
    """Put the path of a table before the keys of all errors raised within; their files and lines stay.

    An error that names both a file and a key is of a file of its own, such as a model, and stays as it is.

    Args:
        key: path of the table or the key, e.g. ``monitor[0]``.
        value: shown where an error has none.
        whole: the key is the whole path, because what is wrong is its own value; None: where there is a value.

    Raises:
        InputError, InputErrors: the error raised within, with its path.
    """
    whole = value is not None if whole is None else whole
    try:
        yield
    except InputErrors as errors:
        raise InputErrors([_under(error, key, value, whole) for error in errors.errors]) from errors
    except InputError as error:
        raise _under(error, key, value, whole) from error.__cause__ or error


@contextmanager
def as_input(key: str, value: object = None) -> Iterator[None]:
    """Say what mathematics refuses as an error of an argument.

    Raises:
        InputError: a ValueError, or a TypeError for an argument that is not there, was raised within.
    """
    try:
        yield
    except (TypeError, ValueError) as error:
        raise InputError(str(error), key=key, value=value) from error


def _under(error: InputError, key: str, value: object, whole: bool) -> InputError:
    if error.file is not None and error.key is not None:
        return error
    path = key if whole else ".".join(part for part in (key, error.key) if part) or None
    shown = value if error.value in (None, "") else error.value
    return error.replace(key=path, value=shown)


class Gathered:
    """The errors of several pieces of work, so that all of them are done before any is raised.

    Each piece is done ``with`` it, which takes its errors; :meth:`check` raises them.
    """

    def __init__(self) -> None:
        self._errors: list[InputError] = []

    def __enter__(self) -> None:
        """Begin a piece of work."""

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> bool:
        """Take its errors; returns whether it had any."""
        if not isinstance(error, InputError | InputErrors):
            return False
        self._errors += each_of(error)
        return True

    def check(self) -> None:
        """Raise what was wrong.

        Raises:
            InputError, InputErrors: one error, or several.
        """
        if len(self._errors) > 1:
            raise InputErrors(self._errors)
        if self._errors:
            raise self._errors[0]


class BusError(GatewayError):
    """A bus that cannot be opened, or that failed while in use."""


class UnsupportedError(BusError):
    """A kind of bus that this system does not have; waiting for it is no use."""


class KernelError(GatewayError):
    """A kernel that cannot be compiled, loaded or run."""
