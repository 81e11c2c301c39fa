"""Changes what a model file says of itself, without training it anew.

    python models/training/metadata.py MODEL.onnx                    prints all of it
    python models/training/metadata.py MODEL.onnx tendon.unit=mV …   sets keys; an empty value removes one

An ONNX file is a protobuf message whose field 14 repeats key (1) and value (2) of the metadata (onnx.proto3). Everything
else is copied as it is. Needs nothing but Python.
"""

import sys
from pathlib import Path

METADATA = 14


def read_varint(data: bytes, at: int) -> tuple[int, int]:
    """A number and where it ends."""
    value = shift = 0
    while True:
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        shift += 7
        if byte < 0x80:
            return value, at


def varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def fields(data: bytes) -> list[tuple[int, bytes, bytes]]:
    """Number, content and all bytes of each field of a message; the content only of those with a length."""
    found, at = [], 0
    while at < len(data):
        start = at
        tag, at = read_varint(data, at)
        content = b""
        if tag & 7 == 0:
            _, at = read_varint(data, at)
        elif tag & 7 == 1:
            at += 8
        elif tag & 7 == 2:
            length, at = read_varint(data, at)
            content = data[at : at + length]
            at += length
        elif tag & 7 == 5:
            at += 4
        else:
            raise SystemExit("this is no ONNX file")
        if at > len(data):
            raise SystemExit("the file breaks off")
        found.append((tag >> 3, content, data[start:at]))
    return found


def entry(content: bytes) -> tuple[str, str]:
    """Key and value of an entry of the metadata."""
    texts = {number: text.decode() for number, text, _ in fields(content)}
    return texts.get(1, ""), texts.get(2, "")


def encoded(number: int, content: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(content)) + content


def main() -> None:
    if len(sys.argv) < 2:
        raise SystemExit(__doc__)
    path = Path(sys.argv[1])
    changes = {}
    for argument in sys.argv[2:]:
        key, equals, value = argument.partition("=")
        if not equals:
            raise SystemExit(f"{argument}: give KEY=VALUE")
        changes[key] = value
    try:
        model = fields(path.read_bytes())
    except (OSError, IndexError) as error:
        raise SystemExit(f"{path}: cannot be read: {error or 'it breaks off'}") from error
    metadata = {}
    out = bytearray()
    for number, content, all_bytes in model:
        if number == METADATA:
            key, value = entry(content)
            metadata[key] = value
        else:
            out += all_bytes
    metadata |= changes
    for key, value in metadata.items():
        if value:
            out += encoded(METADATA, encoded(1, key.encode()) + encoded(2, value.encode()))
    if changes:
        path.write_bytes(bytes(out))
    for key, value in metadata.items():
        if value:
            print(f"{key} = {value}")


if __name__ == "__main__":
    main()
