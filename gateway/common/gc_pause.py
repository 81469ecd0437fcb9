"""Work without the collector of cyclic garbage."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


class _Frozen:
    """Whether something was frozen when it was looked at: it stays so, and is not counted again, object by object."""

    seen = False


@contextmanager
def gc_paused() -> Iterator[None]:
    """Build something large without looking for garbage in it again and again; there is hardly any.

    The result is old at once: only a full collection looks through it. Where a daemon has frozen what it started
    with, that stays so.
    """
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            _Frozen.seen = _Frozen.seen or gc.get_freeze_count() > 0
            if not _Frozen.seen:
                gc.freeze()
                gc.unfreeze()
            gc.enable()
