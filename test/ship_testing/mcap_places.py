"""Positions of the records in an MCAP file, read without code of the suite."""

import struct


def places(data):
    """Return (offset, opcode, length) of each record, in a sequential scan."""
    offset, found = 8, []
    while offset < len(data):
        opcode, length = struct.unpack_from("<BQ", data, offset)
        found.append((offset, opcode, 9 + length))
        offset += 9 + length
    return found
