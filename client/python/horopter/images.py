"""Images as the server takes them."""
from __future__ import annotations

import os
import struct
import zlib
from typing import Union

import numpy as np

ImageLike = Union[str, "os.PathLike[str]", bytes, np.ndarray]


def encode_image(image: ImageLike) -> bytes:
    """The encoded file of an image.

    image: path of an encoded image file; its bytes; or an array of uint8 or uint16, (h, w) grey or (h, w, 3) red, green,
    blue, which becomes a PNG without loss. Arrays of OpenCV are blue, green, red: pass `array[:, :, ::-1]`.

    Raises OSError (file), TypeError, ValueError (array of another shape or type).
    """
    if isinstance(image, bytes):
        return image
    if isinstance(image, (str, os.PathLike)):
        with open(image, "rb") as file:
            return file.read()
    if not isinstance(image, np.ndarray):
        raise TypeError("an image is a path, bytes or an array, not %s" % type(image).__name__)
    if image.dtype not in (np.uint8, np.uint16):
        raise ValueError("an image array holds uint8 or uint16, not %s" % image.dtype)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or 0 in image.shape:
        raise ValueError("an image array has shape (h, w) or (h, w, 3), not %s" % (image.shape,))
    return _png(image)


def _png(image: np.ndarray) -> bytes:
    height, width = image.shape[:2]
    rows = np.ascontiguousarray(image, dtype=image.dtype.newbyteorder(">")).view(np.uint8).reshape(height, -1)
    # Filter 0 (none) before each row: fast, and lossless all the same.
    raw = np.concatenate([np.zeros((height, 1), np.uint8), rows], axis=1).tobytes()

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8 * image.dtype.itemsize, 2 if image.ndim == 3 else 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw, 1)) + chunk(b"IEND", b"")
