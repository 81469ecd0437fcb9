"""Random messages of a database: signals of every kind and order, multiplexed twice."""

import cantools.database.can as can_database
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion
from hypothesis import strategies as st

scales = st.one_of(
    st.just((1, 0)),
    st.tuples(st.integers(-9, 9).filter(bool), st.integers(-500, 500)),
    st.tuples(st.sampled_from([0.1, 0.5, 0.03125, 1e-3, -2.5]), st.sampled_from([0, -40.0, 0.1])),
)


def place(draw, free, length, order):
    """Return the start bit of a signal in a free run of bits, None if there is none."""
    size = len(free)
    starts = [k for k in range(size - length + 1) if all(free[k : k + length])]
    if not starts:
        return None
    first = draw(st.sampled_from(starts))
    for k in range(first, first + length):
        free[k] = False
    return first


@st.composite
def messages(draw):
    size = draw(st.sampled_from([1, 2, 3, 5, 7, 8, 8, 8, 12, 24, 64]))
    order = draw(st.sampled_from(["little_endian", "big_endian"]))
    made = []

    def add(name, free, parent=None, ids=None, multiplexer=False):
        is_float = not multiplexer and draw(st.integers(0, 5)) == 0
        length = draw(st.sampled_from([16, 32, 64]) if is_float else st.integers(1, 4 if multiplexer else 64))
        first = place(draw, free, length, order)
        if first is None:
            return None
        # Runs are counted from the payload's first bit: most significant first for big endian.
        start = first if order == "little_endian" else 8 * (first // 8) + 7 - first % 8
        scale, offset = (1, 0) if multiplexer else draw(scales)
        signal = Signal(
            name,
            start,
            length,
            byte_order=order,
            is_signed=not multiplexer and not is_float and draw(st.booleans()),
            conversion=BaseConversion.factory(scale=scale, offset=offset, is_float=is_float),
            is_multiplexer=multiplexer,
            multiplexer_signal=parent,
            multiplexer_ids=ids,
        )
        made.append(signal)
        return signal

    free = [True] * (8 * size)
    for k in range(draw(st.integers(0, 4))):
        add(f"plain{k}", free)
    if draw(st.booleans()):
        outer = add("outer", free, multiplexer=True)
        if outer is not None:
            # Branches share no value, so that their signals may lie in the same place.
            numbers = draw(st.permutations(range(2**outer.length)))
            for branch in range(draw(st.integers(1, min(3, len(numbers))))):
                ids = sorted(numbers[branch::3][: draw(st.integers(1, 3))])
                inside = list(free)
                inner = None
                if draw(st.booleans()):
                    inner = add(f"inner{branch}", inside, "outer", ids, multiplexer=True)
                if inner is not None:
                    number = draw(st.integers(0, 2**inner.length - 1))
                    add(f"deep{branch}", inside, inner.name, [number])
                add(f"branch{branch}", inside, "outer", ids)
    # A multiplexer nobody depends on is a plain signal to cantools.
    parents = {signal.multiplexer_signal for signal in made}
    made = [s for s in made if not s.is_multiplexer or s.name in parents]
    names = {s.name for s in made}
    made = [s for s in made if s.multiplexer_signal is None or s.multiplexer_signal in names]
    extended = draw(st.booleans())
    return can_database.Message(
        frame_id=draw(st.integers(0, 2**29 - 1 if extended else 2**11 - 1)),
        name="M",
        length=size,
        signals=made,
        is_extended_frame=extended,
        strict=False,
    )


@st.composite
def odd_messages(draw):
    """Messages as people write them: signals that overlap, lie beyond the end, have one name; scaled multiplexers."""
    size = draw(st.sampled_from([1, 4, 8, 8, 8, 12]))
    names = draw(st.lists(st.sampled_from("abcd"), min_size=1, max_size=7))
    outers = ["a", *draw(st.sampled_from([[], ["b"]]))]
    made = []
    for name in names:
        is_float = name not in outers and draw(st.integers(0, 5)) == 0
        length = draw(st.sampled_from([16, 32, 64]) if is_float else st.integers(1, 3 if name in outers else 64))
        order = draw(st.sampled_from(["little_endian", "big_endian"]))
        first = draw(st.integers(0, 8 * size + 8))
        scale, offset = draw(scales)
        parent = draw(st.sampled_from([None, *outers[: 1 if name == "b" else 2]])) if name != "a" else None
        made.append(
            Signal(
                name,
                first if order == "little_endian" else 8 * (first // 8) + 7 - first % 8,
                length,
                byte_order=order,
                is_signed=not is_float and draw(st.booleans()),
                conversion=BaseConversion.factory(scale=scale, offset=offset, is_float=is_float),
                is_multiplexer=name in outers,
                multiplexer_signal=parent,
                multiplexer_ids=None if parent is None else draw(st.lists(st.integers(0, 7), min_size=1, max_size=4)),
            )
        )
    return can_database.Message(0x123, "M", size, made, strict=False)
