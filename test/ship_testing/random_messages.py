"""Messages of any type with extreme values: limits, NaN, the smallest numbers, texts of all kinds."""

import numpy as np
from rosbags.interfaces import Nodetype

TEXTS = (
    "", "ins", " a, b ", 'a "b"', "two\nlines", "and\r\nmore\r", "ψ in ″, 汉字 🚢", "tab\t'", "nan", "-0.0", "7",
)
FLOATS = (
    float("nan"), float("inf"), -float("inf"), 0.0, -0.0, 5e-324, -2.2250738585072014e-308, 1.7976931348623157e308,
)
FLOATS_32 = (*FLOATS[:5], 1e-45, -1.1754943508222875e-38, 3.4028234663852886e38, 0.1)
TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
LONGEST_ARRAY = 4


def random_message(type_name, store, rng):
    """Return a message of a type."""
    fields = {name: random_value(store, rng, *node) for name, node in store.fielddefs[type_name][1]}
    if type_name in TIMES:
        fields["nanosec"] = int(rng.integers(1_000_000_000))
    return store.types[type_name](**fields)


def random_value(store, rng, node, content):
    if node == Nodetype.NAME:
        return random_message(content, store, rng)
    if node == Nodetype.BASE:
        return random_base(rng, content[0])
    (element_node, element), length = content
    count = length if node == Nodetype.ARRAY else int(rng.integers(min(length or LONGEST_ARRAY, LONGEST_ARRAY) + 1))
    values = [random_value(store, rng, element_node, element) for _ in range(count)]
    if element_node == Nodetype.NAME or element[0] == "string":
        return values
    return np.array([value & 0xFF for value in values] if element[0] == "byte" else values, dtype(element[0]))


def dtype(base):
    return np.dtype({"byte": "uint8", "octet": "uint8", "char": "uint8"}.get(base, base))


def random_base(rng, base):
    if base == "string":
        return str(rng.choice(TEXTS))
    if base == "bool":
        return bool(rng.integers(2))
    if base == "byte":
        return int(rng.integers(-128, 128))  # rosbags reads and writes a byte as signed
    kind = dtype(base)
    if kind.kind == "f":
        special = FLOATS if kind.itemsize == 8 else FLOATS_32
        if rng.random() < 0.5:
            return float(kind.type(rng.choice(special)))
        # Any bit pattern, but all patterns of NaN become one NaN: a text does not distinguish them.
        value = float(np.frombuffer(rng.bytes(kind.itemsize), kind)[0])
        return float("nan") if value != value else value
    limits = np.iinfo(kind)
    edges = (limits.min, limits.max, 0, limits.max // 2, limits.max - 1)
    if rng.random() < 0.5:
        return int(edges[rng.integers(len(edges))])
    return int(rng.integers(limits.min, limits.max, dtype=kind))
