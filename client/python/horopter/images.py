"""Images as the server takes them."""
from __future__ import annotations

import dataclasses
import os
import struct
import zlib
from typing import Iterable, Optional, Union

import numpy as np

from horopter.v1 import recognition_pb2


@dataclasses.dataclass
class RawFrame:
    """Pixels as a camera delivers them, row by row from the top: no encoding, no loss.

    format: "GRAY8", "BGR8", "RGB8", "BAYER_RG8" (named by the first two colours of the first row; also BG, GB, GR),
    "GRAY16" and "BAYER_RG16" .. (words of two bytes, the lower one first), "NV12", "NV21", "UYVY" or "YUYV"; data: bytes, or an
    array whose bytes are taken as they lie (words of the other order are turned); stride_bytes: from row to row, 0: no padding;
    bits_in_use: of words of 16 how many the camera fills, None: told by the largest.
    """
    format: str
    width_px: int
    height_px: int
    data: "Union[bytes, bytearray, memoryview, np.ndarray]" = dataclasses.field(repr=False)
    stride_bytes: int = 0
    bits_in_use: Optional[int] = None

    def to_proto(self) -> recognition_pb2.RawFrame:
        """Raises ValueError (no such format); the server checks sizes."""
        name = "PIXEL_FORMAT_" + self.format
        if name not in recognition_pb2.RawFrame.PixelFormat.keys() or self.format == "UNSPECIFIED":
            known = (f[len("PIXEL_FORMAT_"):] for f in recognition_pb2.RawFrame.PixelFormat.keys())
            raise ValueError("a raw frame's format is one of %s, not %r" % (
                ", ".join(f for f in known if f != "UNSPECIFIED"), self.format))
        data = self.data
        if isinstance(data, np.ndarray):
            data = np.ascontiguousarray(data, dtype=data.dtype.newbyteorder("<")).tobytes()
        return recognition_pb2.RawFrame(
            format=recognition_pb2.RawFrame.PixelFormat.Value(name), width_px=int(self.width_px), height_px=int(self.height_px),
            stride_bytes=int(self.stride_bytes), data=bytes(data), bits_in_use=int(self.bits_in_use or 0))


ImageLike = Union[str, "os.PathLike[str]", bytes, bytearray, memoryview, np.ndarray, RawFrame]


def check_images(images: "Iterable[ImageLike]") -> None:
    """Raises TypeError: one image where a list of images is wanted, whose parts would be taken for images."""
    if isinstance(images, np.ndarray) and images.ndim >= 4 and images.dtype.kind in "ui":
        return  # a stack of colour images
    if isinstance(images, (str, bytes, bytearray, memoryview, os.PathLike, RawFrame, np.ndarray)) or \
            hasattr(images, "__array_interface__"):
        raise TypeError("images is a list, also of one image: [image], not %s" % type(images).__name__)


def encode_image(image: ImageLike) -> bytes:
    """The encoded file of an image.

    image: path of an encoded image file; its bytes; or an array of uint8 or uint16 of either byte order, (h, w) grey or
    (h, w, 3) red, green, blue, which becomes a PNG without loss. Of 16 bits those that are in use count: cameras of 10, 12 and
    14 bits leave the upper ones empty. Arrays of OpenCV are blue, green, red: pass `array[:, :, ::-1]`.

    Raises OSError (file), TypeError, ValueError (array of another shape or type).
    """
    if isinstance(image, (bytes, bytearray, memoryview)):
        return bytes(image)
    if isinstance(image, (str, os.PathLike)):
        with open(image, "rb") as file:
            return file.read()
    if not isinstance(image, np.ndarray) and hasattr(image, "__array_interface__"):
        image = np.asarray(image)  # e.g. an image of Pillow
    if not isinstance(image, np.ndarray):
        raise TypeError("an image is a path, bytes, an array or a RawFrame, not %s" % type(image).__name__)
    if image.dtype.kind != "u" or image.dtype.itemsize > 2:
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
