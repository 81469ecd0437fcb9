"""Lengths of a record's arrays that have a name: said by its class, and said otherwise by one derived from it."""

from typing import Annotated

import numpy as np
import pytest

from gateway_fdi.jit import LINE, Record, f8, f8s, i8


class Cell(Record):
    volts: f8
    age: i8


class Pack(Record, lengths={"cells": 16, "words": 2}):
    amperes: f8
    charge: Annotated[f8s, "cells"]
    masks: Annotated[f8s, "cells", "words", 3]
    cell: Annotated[list[Cell], "cells"]
    fixed: Annotated[f8s, 5]


class Small(Pack, lengths={"cells": 4}):
    pass


@pytest.mark.parametrize(("cls", "cells"), [(Pack, 16), (Small, 4)])
def test_lengths(cls, cells):
    shapes = {name: cls.dtype[name].shape for name in cls.dtype.names}
    assert shapes == {"amperes": (), "charge": (cells,), "masks": (cells, 2, 3), "cell": (cells,), "fixed": (5,)}
    assert cls.dtype["cell"].base == Cell.dtype
    assert np.zeros(1, cls).dtype == cls.dtype


def test_a_length_that_nobody_says():
    with pytest.raises(TypeError, match=r"Wrong\.values: lengths say no cels"):

        class Wrong(Record, lengths={"cells": 3}):
            values: Annotated[f8s, "cels"]


def test_what_is_near_lies_first_and_rows_are_an_odd_number_of_lines():
    class Far(Record):
        old: Annotated[f8s, 9]
        count: i8

    class Row(Far, near=("count", "last")):
        last: f8

    offsets = {name: Row.dtype.fields[name][1] for name in Row.dtype.names}
    assert (offsets["count"], offsets["last"], offsets["old"]) == (0, 8, 16)
    assert Row.dtype.itemsize == 3 * LINE, "88 bytes would be two"
