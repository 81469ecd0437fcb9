"""Changes of bytes and texts, drawn by a seed: what nobody sends on purpose."""

import json
import re

#: What parsers stumble over: ends, edges of numbers, other types, deep nesting, other encodings.
PIECES = (
    b"", b"\0", b"\xff" * 8, b"\n", b"\r\n", b'"', b"{", b"}", b"[", b"]", b"{}", b"[]", b"null", b"true", b"0", b"-1",
    b"1e999", b"nan", b"65536", b"4294967296", b"-9223372036854775809", b"9" * 400, b"%s", b"../", b"\xef\xbb\xbf",
    b"\xed\xa0\x80", b"[" * 200, b"<!--",
)  # fmt: skip
_WORD = re.compile(rb'[A-Za-z0-9_.+-]+|"[^"\n]*"')


def mutate(draw, data):
    """Change a bytearray in one place.

    Args:
        draw: a random.Random.
        data: which one; changed in place.
    """
    at = draw.randrange(len(data)) if data else 0
    match draw.randrange(8):
        case 0 if data:
            data[at] = draw.randrange(256)
        case 1:
            data[at:at] = draw.randbytes(draw.randint(1, 9))
        case 2:
            del data[at : at + draw.randint(1, 9)]
        case 3:
            data += data[at : at + 40]
        case 4 if data:
            data[at] ^= 1 << draw.randrange(8)
        case 5:
            data[at:at] = draw.choice(PIECES)
        case 6 if words := list(_WORD.finditer(bytes(data))):
            word = draw.choice(words)
            data[word.start() : word.end()] = draw.choice((*PIECES, draw.choice(words)[0]))
        case _:
            del data[at:]


def mutate_json(draw, text):
    """Return a document of JSON with one value changed for another, of any type; other bytes as they are."""
    try:
        whole = json.loads(text)
    except ValueError:
        return text
    places = []

    def look(value):
        if isinstance(value, dict | list):
            for key in value if isinstance(value, dict) else range(len(value)):
                places.append((value, key))
                look(value[key])

    look(whole)
    if places:
        value, key = draw.choice(places)
        others = (None, True, -1, 1e308, 1 << 70, "", "\0", "x" * 300, [], {}, [[]], {"a": {}}, draw.choice(places)[0])
        value[key] = draw.choice(others)
    try:
        return json.dumps(whole).encode()
    except (ValueError, RecursionError):  # it has itself as a part
        return text
