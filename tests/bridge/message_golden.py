#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Canonical bytes, CRC-32C and CDR bytes of one fixed message of each type, made from the IDL alone.

Prints `name crc hexbytes cdrbytes` per message. CDR: XCDR1, little-endian, with its encapsulation header, as it goes
over the wire; its crc32c is the message's own. The n-th scalar of a message, from 1, has the value: an integer
n * 0x9E3779B97F4A7C15 cut to its width; a double n + 0.125; a boolean n odd; a string "text n".
Usage: message_golden.py holdfast.idl
"""
import re
import struct
import sys

FORMATS = {"octet": "B", "boolean": "B", "unsigned long": "I", "long": "i", "long long": "q",
           "unsigned long long": "Q", "double": "d"}


def crc32c(data):
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x82F63B78 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def parse(text):
    structs = {}
    text = re.sub(r"//.*", "", text)
    for name, body in re.findall(r"struct (\w+) \{(.*?)\};", text, re.S):
        structs[name] = re.findall(r"\s*([\w ]+?(?:<\d+>)?)\s+(\w+)(?:\[(\d+)\])?;", body)
    return structs


def scalar(kind, n):
    if kind.startswith("string"):
        text = f"text {n}".encode()
        return struct.pack("<I", len(text)) + text
    code = FORMATS[kind]
    if kind == "double":
        return struct.pack("<d", n + 0.125)
    if kind == "boolean":
        return bytes([n % 2])
    width = struct.calcsize("<" + code)
    return (n * 0x9E3779B97F4A7C15 & (1 << 8 * width) - 1).to_bytes(width, "little")


def canonical(structs, name):
    fields = [f for f in structs["Protection"] if f[1] != "crc32c"]
    fields += [f for f in structs[name] if f[0] != "Protection"]
    data, n = b"", 0
    for kind, _, count in fields:
        for _ in range(int(count or 1)):
            n += 1
            data += scalar(kind, n)
    return data


def cdr_scalar(data, kind, n):
    """As scalar(), aligned to its size; a string with its NUL. Alignment counts from behind the encapsulation."""
    if kind.startswith("string"):
        text = f"text {n}".encode() + b"\0"
        return data + bytes(-len(data) % 4) + struct.pack("<I", len(text)) + text
    value = scalar(kind, n)
    return data + bytes(-len(data) % len(value)) + value


def cdr(structs, name, crc):
    data, n = b"", 0
    for kind, field, count in structs["Protection"] + [f for f in structs[name] if f[0] != "Protection"]:
        if field == "crc32c":
            data += bytes(-len(data) % 4) + struct.pack("<I", crc)
            continue
        for _ in range(int(count or 1)):
            n += 1
            data = cdr_scalar(data, kind, n)
    return b"\0\1\0\0" + data


def main():
    with open(sys.argv[1], encoding="utf-8") as file:
        structs = parse(file.read())
    for name in structs:
        if name != "Protection":
            data = canonical(structs, name)
            print(name, f"{crc32c(data):08x}", data.hex(), cdr(structs, name, crc32c(data)).hex())


if __name__ == "__main__":
    main()
