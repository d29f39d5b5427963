#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""An OpenIGTLink client written from the protocol's description alone: reads messages until the server ends, checks each
header and CRC-64, prints each as one line of JSON. What it does not know ends it.

Usage: igtl_client.py PORT [TEXT that is sent first]"""
import json
import socket
import struct
import sys

HEADER = struct.Struct(">H12s20sQQQ")
POLYNOMIAL, MASK = 0x42F0E1EBA9EA3693, (1 << 64) - 1


def shifted(crc):
    for _ in range(8):
        crc = (crc << 1 ^ (POLYNOMIAL if crc >> 63 else 0)) & MASK
    return crc


TABLE = [shifted(byte << 56) for byte in range(256)]


def crc64(data):
    crc = 0
    for byte in data:
        crc = (crc << 8 & MASK) ^ TABLE[crc >> 56 ^ byte]
    return crc


def receive(connection, count):
    data = b""
    while len(data) < count:
        more = connection.recv(count - len(data))
        if not more:
            sys.exit(0)
        data += more
    return data


def text(field):
    return field.split(b"\0", 1)[0].decode("ascii")


def content(kind, body):
    if kind == "TRANSFORM":
        v = struct.unpack(">12f", body)
        return {"matrix": [[v[row], v[3 + row], v[6 + row], v[9 + row]] for row in range(3)]}
    if kind == "STATUS":
        code, sub_code, name = struct.unpack(">Hq20s", body[:30])
        return {"code": code, "sub_code": sub_code, "name": text(name), "text": text(body[30:])}
    if kind == "IMAGE":
        version, components, scalar, _, coordinates, *rest = struct.unpack(">H4B3H12f6H", body[:72])
        size, v, part = rest[:3], rest[3:15], rest[15:]
        pixels, count = body[72:], size[0] * size[1] * size[2] * components
        if version != 1 or part != [0, 0, 0, *size] or len(pixels) != count or scalar != 3:
            sys.exit(f"IMAGE of {size}, part {part}, {len(pixels)} bytes, scalar type {scalar}")
        middle = size[0] * components * (size[1] // 2)
        return {"size": size, "components": components, "coordinates": coordinates,
                "matrix": [[v[row], v[3 + row], v[6 + row], v[9 + row]] for row in range(3)],
                "left": pixels[middle], "right": pixels[middle + size[0] * components - 1]}
    sys.exit(f"unknown type {kind}")


def main():
    assert crc64(b"123456789") == 0x6C40DF5F0B497347  # the catalogue's check value of CRC-64/ECMA-182
    connection = socket.create_connection(("127.0.0.1", int(sys.argv[1])))
    for words in sys.argv[2:]:
        connection.sendall(words.encode())
    while True:
        version, kind, device, stamp, size, crc = HEADER.unpack(receive(connection, HEADER.size))
        body = receive(connection, size)
        if version != 1 or crc64(body) != crc:
            sys.exit(f"version {version}, CRC {crc:x} against {crc64(body):x}")
        message = {"type": text(kind), "device": text(device), "t_utc_s": stamp / 2**32}
        print(json.dumps(message | content(message["type"], body)), flush=True)


if __name__ == "__main__":
    main()
