"""Pictures of floor plans, decoded in bands of rows: PGM by ourselves, all else that Pillow reads by Pillow."""

from __future__ import annotations

import io
import math
import re
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError, missing
from tasklift.plans.foreign import by_signature
from tasklift.plans.plan import FINEST_M, LARGEST_PIXELS, Plan
from tasklift.plans.source import Source

LARGEST_SHEET = 400_000_000  # pixels of one byte each
LARGEST_SHEET_BYTES = 400_000_000
BAND_PIXELS = 4_000_000
MARGIN = 10  # pixels of background to keep around what is drawn
# Formats that decode by themselves: EPS and WMF would start other programs
FORMATS = ("BMP", "DIB", "GIF", "JPEG", "JPEG2000", "PCX", "PNG", "PPM", "SGI", "TIFF", "WEBP")
PICTURE_ENDINGS = (".pgm", ".png", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff", ".ppm", ".pbm", ".gif", ".webp")
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_SIGNATURES = (_PNG, _JPEG, b"II*\0", b"MM\0*", b"GIF87a", b"GIF89a", b"BM", b"\0\0\0\x0cjP  ")
_BYTES_PER_PIXEL = {"1": 1, "L": 1, "P": 1, "LA": 4, "PA": 4, "I;16": 2, "I;16B": 2, "I": 4}

Classify = Callable[
    [NDArray[np.float32], NDArray[np.float32] | None], tuple[NDArray[np.bool_], NDArray[np.bool_]]
]


def is_picture(head: bytes) -> bool:
    """Whether a file with these first bytes is a picture that is read."""
    return head.startswith(_SIGNATURES) or (head[:1] == b"P" and head[1:2] in b"123456" and head[2:3].isspace()) or (
        head[:4] == b"RIFF" and head[8:12] == b"WEBP"
    )


class Picture:
    """A picture: its size, and its grey values and transparency in bands of rows.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    TaskliftError
        If it is not a picture that can be read, damaged, or too large.
    """

    def __init__(self, path: Path):
        self.path = path
        source = Source(path)
        try:
            head = source.head
        except TaskliftError as error:
            raise (source.fault("is not a picture (it is empty)") if "is empty" in str(error) else error) from error
        if not is_picture(head):
            known = by_signature(source)
            if known:
                raise source.fault(known)
            raise source.fault("is not a picture in PGM, PNG or another format that is read; convert it")
        self.is_jpeg = head.startswith(_JPEG)
        if head[:2] in (b"P2", b"P5"):
            self._values, self._scale = _read_pgm(source)
            self.height, self.width = self._values.shape
            self._image = None
        else:
            self._image = _open(source)
            self.width, self.height = self._image.size

    def band(self, top: int, bottom: int) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Rows ``top`` to ``bottom``: the mean of the colours, 0 to 255, and the alpha channel or ``None``."""
        if self._image is None:
            return self._values[top:bottom].astype(np.float32) * self._scale, None
        piece = self._image.crop((0, top, self.width, bottom))
        if piece.mode.startswith("I"):  # 16 bits of grey
            return np.asarray(piece, np.float32) * np.float32(255 / 65535), None
        has_alpha = piece.mode in ("LA", "RGBA", "PA", "La", "RGBa") or "transparency" in self._image.info
        if piece.mode in ("1", "L") and not has_alpha:
            return np.asarray(piece.convert("L"), np.float32), None
        pixels = np.asarray(piece.convert("RGBA"), np.uint8)
        mean = pixels[..., :3].mean(axis=2, dtype=np.float32)
        return mean, pixels[..., 3].astype(np.float32) if has_alpha else None

    def bands(self) -> list[tuple[int, int]]:
        """All rows, in bands of a few million pixels."""
        rows = max(1, BAND_PIXELS // self.width)
        return [(top, min(top + rows, self.height)) for top in range(0, self.height, rows)]

    def drawn_box(self) -> tuple[int, int, int, int]:
        """``(top, bottom, left, right)`` of what differs from the picture's corners, with a margin; or all of it."""
        corners = [float(self.band(row, row + 1)[0][0, column]) for row in (0, self.height - 1) for column in (0, -1)]
        if max(corners) - min(corners) > 1:
            return 0, self.height, 0, self.width
        rows: list[int] = []
        columns = np.zeros(self.width, bool)
        for top, bottom in self.bands():
            drawn = np.abs(self.band(top, bottom)[0] - corners[0]) > 1
            rows += (np.flatnonzero(drawn.any(axis=1)) + top).tolist()
            columns |= drawn.any(axis=0)
        if not rows:
            return 0, self.height, 0, self.width
        across = np.flatnonzero(columns)
        top, bottom = max(0, rows[0] - MARGIN), min(self.height, rows[-1] + 1 + MARGIN)
        left, right = max(0, int(across[0]) - MARGIN), min(self.width, int(across[-1]) + 1 + MARGIN)
        return top, bottom, left, right


def plan_from(
    picture: Picture,
    classify: Classify,
    *,
    name: str,
    resolution_m: float,
    origin: tuple[float, float, float],
    inverted: bool = False,
    doubts: tuple[str, ...] = (),
) -> Plan:
    """The plan of a picture, band by band; of a very large sheet what is drawn on it, and if need be coarser.

    Parameters
    ----------
    classify
        Which pixels are free, and which unknown, of their means (0 to 255) and their alpha.
    inverted
        Whether dark is free, for the greys to draw on.
    """
    box = (0, picture.height, 0, picture.width)
    if picture.width * picture.height > LARGEST_PIXELS:
        box = picture.drawn_box()
    top, bottom, left, right = box
    factor = 1
    if (bottom - top) * (right - left) > LARGEST_PIXELS:
        factor = max(1, int(FINEST_M / resolution_m + 1e-6))
    height, width = -(-(bottom - top) // factor), -(-(right - left) // factor)
    if height * width > LARGEST_PIXELS:
        raise TaskliftError(
            f"{picture.path}: {right - left} x {bottom - top} pixels are more than the limit of {LARGEST_PIXELS:,}; "
            "make it coarser, for example with ImageMagick's 'convert … -resize 50% …', and double the resolution"
        )
    free, unknown, grey = (np.zeros((height, width), dtype) for dtype in (bool, bool, np.uint8))
    rows = factor * max(1, BAND_PIXELS // (factor * picture.width))
    for row in range(top, bottom, rows):
        mean, alpha = picture.band(row, min(row + rows, bottom))
        mean, alpha = mean[:, left:right], None if alpha is None else alpha[:, left:right]
        is_free, is_unknown = classify(mean, alpha)
        shade = np.clip(255 - mean if inverted else mean, 0, 255).astype(np.uint8)
        into = slice((row - top) // factor, -(-(min(row + rows, bottom) - top) // factor))
        free[into] = _blocks(is_free, factor, True).all(axis=(1, 3))
        unknown[into] = _blocks(is_unknown, factor, False).all(axis=(1, 3))
        grey[into] = _blocks(shade, factor, 255).min(axis=(1, 3))
    x, y, yaw = origin
    # the picture's lower left corner moved by what was cut off, and by the last row's padding
    across, up = left * resolution_m, (picture.height - top - height * factor) * resolution_m
    x, y = x + math.cos(yaw) * across - math.sin(yaw) * up, y + math.sin(yaw) * across + math.cos(yaw) * up
    return Plan(name, free, unknown & ~free, grey, resolution_m * factor, (x, y, yaw), doubts)


def _blocks(values: NDArray[Any], factor: int, fill: Any) -> NDArray[Any]:
    """``values`` in blocks, ``(rows, factor, columns, factor)``, filled up at the lower and right edge."""
    padded = np.pad(values, [(0, -n % factor) for n in values.shape], constant_values=fill) if factor > 1 else values
    return padded.reshape(padded.shape[0] // factor, factor, padded.shape[1] // factor, factor)


def _check_size(source: Source, width: int, height: int, bytes_per_pixel: int = 1) -> None:
    if width < 1 or height < 1:
        raise source.fault(f"a picture of {width} x {height} pixels holds no plan")
    if width * height > LARGEST_SHEET or width * height * bytes_per_pixel > LARGEST_SHEET_BYTES:
        most = LARGEST_SHEET_BYTES // bytes_per_pixel
        raise source.fault(f"{width} x {height} pixels are more than the limit of {most:,}; make it coarser or grey")


def _read_pgm(source: Source) -> tuple[NDArray[Any], np.float32]:
    """The values of a PGM (P2, P5), and what to multiply them with for 0 to 255."""
    data = source.data
    gap = rb"(?:\s|#[^\n]*\n)+"
    header = re.compile(rb"P[25]" + (gap + rb"(\d{1,9})") * 3 + rb"(?:#[^\n]*\n)?\s").match(data[:65536])
    if header is None:
        raise source.fault("damaged PGM header; expected P2 or P5, width, height, largest value")
    width, height, largest = (int(v) for v in header.groups())
    _check_size(source, width, height)
    if not 1 <= largest <= 65535:
        raise source.fault(f"largest value {largest} of a PGM; expected 1 to 65535")
    n = width * height
    if data[:2] == b"P5":
        dtype = np.dtype(">u2" if largest > 255 else "u1")
        found = (len(data) - header.end()) // dtype.itemsize
        values: NDArray[Any] = np.frombuffer(data, dtype, min(n, found), header.end())
    else:
        _check_size(source, width, height, 8)
        if len(data) > 8 * n + 65536:
            raise source.fault(f"{len(data):,} bytes of text for {n:,} pixels; is it damaged?")
        body = re.sub(rb"#[^\n]*", b"", data[header.end() :])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                values = np.fromstring(body, np.int64, sep=" ")
            except (DeprecationWarning, ValueError) as error:
                raise source.fault("a P2 picture holds whole numbers only, found other text") from error
    if len(values) < n:
        raise source.fault(f"cut short: {n} pixels announced, {len(values)} found")
    values = values[:n].reshape(height, width)
    if int(values.max()) > largest or int(values.min()) < 0:
        raise source.fault(f"a pixel lies outside the announced range 0 to {largest}")
    return values, np.float32(255 / largest)


def _open(source: Source) -> Any:
    """A picture decoded by Pillow; its size is looked at first."""
    try:
        from PIL import Image
    except ImportError as error:
        raise missing("Pillow", "plans", "reading a picture") from error
    data = source.data
    most, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None  # we state our own limit below
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            image = Image.open(io.BytesIO(data), formats=FORMATS)
            _check_size(source, *image.size, _BYTES_PER_PIXEL.get(image.mode, 4))
            if image.mode in ("F", "I") and image.format not in ("PNG", "PPM"):
                raise source.fault("has 32 bits a pixel; save it with 8 or 16 bits of grey")
            image.load()
    except TaskliftError:
        raise
    except Exception as error:  # Pillow's decoders raise all sorts on damaged files
        kind = source.path.suffix.lstrip(".").upper() or "picture"
        raise source.fault(f"damaged or cut short {kind:.10} ({' '.join(str(error).split()):.80})") from error
    finally:
        Image.MAX_IMAGE_PIXELS = most
    return image
