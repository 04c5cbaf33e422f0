"""Floor plans as pictures: the map files of ROS (map_server, nav2), without ROS.

A map is a YAML file beside a picture (PGM or PNG). The rules by which a grey value becomes free, occupied or
unknown are those of map_server; ``docs/maps.md`` states them.
"""

from __future__ import annotations

import difflib
import io
import math
import os
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasklift.errors import TaskliftError
from tasklift.plans.read.yamls import read_yaml

LARGEST_PIXELS = 50_000_000
LARGEST_IMAGE_BYTES = 400_000_000
# map_saver writes unknown as grey 205, p = 50/255 = 0.19608: free for a reader whose threshold is above that
SAVED_UNKNOWN_GREY = 205
SAVED_UNKNOWN_P = 0.1961
MODES = ("trinary", "scale", "raw")


@dataclass(frozen=True, eq=False)
class Plan:
    """A floor plan as a picture, its top row first.

    Attributes
    ----------
    name
        For people: the name of the file.
    free, unknown
        ``bool (H, W)``: pixels a robot may be on; pixels of which the map says nothing. The rest is occupied.
    grey
        ``uint8 (H, W)``: the picture, for drawing upon.
    resolution_m
        Metres per pixel.
    origin
        ``(x, y, yaw)`` of the lower left corner of the picture (m, m, rad).
    doubts
        What the reader is not sure of, a sentence each.
    doors_m
        ``float64 (K, 2, 2)``: the two ends of every door (m), where the file tells; ``None`` where they have to
        be found.
    seeds_m
        ``float64 (n, 2)``: points (m) that lie in the building, or ``None``.
    """

    name: str
    free: NDArray[np.bool_]
    unknown: NDArray[np.bool_]
    grey: NDArray[np.uint8]
    resolution_m: float
    origin: tuple[float, float, float]
    doubts: tuple[str, ...] = ()
    doors_m: NDArray[np.float64] | None = None
    seeds_m: NDArray[np.float64] | None = None

    def to_world(self, rows: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
        """Metres ``(n, 2)``, x right and y up, of points given in pixels (row 0 is the picture's top edge)."""
        x = np.asarray(columns, float) * self.resolution_m
        y = (self.free.shape[0] - np.asarray(rows, float)) * self.resolution_m
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        return np.column_stack([self.origin[0] + cos * x - sin * y, self.origin[1] + sin * x + cos * y])

    def to_pixels(self, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """``(n, 2)`` rows and columns (fractions of pixels) of points in metres; undoes :meth:`to_world`."""
        x, y = (np.atleast_2d(points_m) - self.origin[:2]).T
        cos, sin = math.cos(self.origin[2]), math.sin(self.origin[2])
        columns = (cos * x + sin * y) / self.resolution_m
        rows = self.free.shape[0] - (cos * y - sin * x) / self.resolution_m
        return np.column_stack([rows, columns])


def read_ros(
    path: str | os.PathLike[str], *, allow_outside: bool = False, document: Mapping[str, Any] | None = None
) -> Plan:
    """Read a ROS map: the YAML file ``path`` and the picture that it names.

    Parameters
    ----------
    path
        The YAML file, with ``image``, ``resolution``, ``origin``, ``negate``, ``occupied_thresh``,
        ``free_thresh`` and perhaps ``mode``.
    allow_outside
        Follow an ``image`` that lies outside the folder of the YAML file.
    document
        What the YAML holds, if it was read already.
    """
    where = str(path)
    fields = read_yaml(path) if document is None else document
    if "image" not in fields:
        raise TaskliftError(f"{where}: field 'image' is missing; is this the YAML of a map?")
    resolution = _number(where, fields, "resolution", above=0.0, most=1000.0)
    origin = fields.get("origin")
    if not isinstance(origin, list) or len(origin) != 3 or not all(_is_number(v) for v in origin):
        raise TaskliftError(f"{where}: field 'origin': expected three numbers [x, y, yaw], found {_show(origin)}")
    if max(map(abs, origin)) > 1e6:
        raise TaskliftError(f"{where}: field 'origin': {_show(origin)} is farther than 1,000 km away")
    negate = fields.get("negate")
    if "negate" not in fields or not (isinstance(negate, bool) or negate in (0, 1)):
        raise TaskliftError(f"{where}: field 'negate': expected 0 or 1, found {_show(negate)}")
    occupied = _number(where, fields, "occupied_thresh", most=1.0)
    free = _number(where, fields, "free_thresh", most=1.0)
    if free > occupied:
        raise TaskliftError(f"{where}: free_thresh {free:g} is above occupied_thresh {occupied:g}; swap them")
    mode = fields.get("mode", "trinary")
    if mode not in MODES:
        raise TaskliftError(f"{where}: field 'mode': expected {', '.join(MODES)}, found {_show(mode)}")

    image = _find_image(Path(path), fields["image"], allow_outside)
    mean, alpha = read_image(image)
    value = (mean * 3 + alpha) / 4 if mode == "trinary" and alpha is not None else mean
    is_free, unknown = _classify(value, alpha, bool(negate), occupied, free, mode)
    doubts = []
    share = float(np.mean(np.abs(mean - SAVED_UNKNOWN_GREY) < 0.5))
    if mode != "raw" and not negate and free > SAVED_UNKNOWN_P and share > 0.01:
        doubts.append(
            f"unknown shown as free: {share:.0%} of the picture is grey 205, which map_saver writes for unknown, "
            f"and free_thresh {free:g} makes it free; 0.196 would not"
        )
    grey = np.clip(255 - mean if negate else mean, 0, 255).astype(np.uint8)
    name = Path(path).stem
    return Plan(name, is_free, unknown, grey, resolution, (origin[0], origin[1], origin[2]), tuple(doubts))


def _classify(
    value: NDArray[np.floating],
    alpha: NDArray[np.float32] | None,
    negate: bool,
    occupied: float,
    free: float,
    mode: str,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """map_server's rules: ``(free, unknown)`` of every pixel."""
    if mode == "raw":  # the grey value is the occupancy in percent, above 100 it is unknown
        percent = value / np.float32(100)
        known = percent <= 1
        return known & (percent < free), ~known | ((percent >= free) & (percent <= occupied))
    # 205 / 255 is a threshold that people write: keep the comparison exact
    p = (value if negate else 255 - value).astype(np.float64) / 255
    is_free, between = p < free, (p >= free) & (p <= occupied)
    if mode == "trinary":
        return is_free, between
    # scale: in between is a probability; nearer to free than to occupied counts as free
    seen = between if alpha is None else between & (alpha >= 255)
    return is_free | (seen & (p < (free + occupied) / 2)), between & ~seen


def _find_image(path: Path, image: Any, allow_outside: bool) -> Path:
    if not isinstance(image, str) or not image or "\0" in image:
        raise TaskliftError(f"{path}: field 'image': expected the name of a file, found {_show(image)}")
    try:
        folder = path.parent.resolve()
        target = (path.parent / image).resolve()
        inside = target.is_relative_to(folder)
        if not inside and not allow_outside:
            raise TaskliftError(
                f"{path}: image {image!r:.200} leaves the folder of the YAML file; pass --allow-outside if you trust it"
            )
        if target.is_file():
            return target
        pictures = sorted(p.name for p in target.parent.glob("*") if p.suffix.lower() in (".pgm", ".png"))
    except (OSError, RuntimeError) as error:
        raise TaskliftError(f"{path}: image {image!r:.200} cannot be opened ({error!s:.100})") from error
    near = difflib.get_close_matches(Path(image).name, pictures, n=1, cutoff=0.0)
    hint = f"there is {near[0]!r}: correct 'image'" if near else "there is no picture in that folder"
    raise TaskliftError(f"{path}: image {image!r:.200} does not exist; {hint}")


def read_image(path: Path) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Return the mean of the colour channels, 0 to 255, and the alpha channel (or ``None``), ``(H, W)`` each.

    PGM (P2, P5) and PNG, of at most 50 million pixels.
    """
    try:
        if path.stat().st_size > LARGEST_IMAGE_BYTES:
            raise TaskliftError(f"{path}: larger than {LARGEST_IMAGE_BYTES} bytes")
        data = path.read_bytes()
    except OSError as error:
        raise TaskliftError(f"{path}: cannot be read ({error.strerror})") from error
    if data[:2] in (b"P2", b"P5"):
        return _read_pgm(path, data), None
    if data[:8] == b"\x89PNG\r\n\x1a\n":
        return _read_png(path, data)
    raise TaskliftError(f"{path}: not a picture in PGM (P2, P5) or PNG; convert it")


def _check_size(path: Path, width: int, height: int) -> None:
    if width < 1 or height < 1:
        raise TaskliftError(f"{path}: a picture of {width} x {height} pixels holds no plan")
    if width * height > LARGEST_PIXELS:
        raise TaskliftError(
            f"{path}: {width} x {height} pixels are more than the limit of {LARGEST_PIXELS:,}; make it coarser"
        )


def _read_pgm(path: Path, data: bytes) -> NDArray[np.float32]:
    gap = rb"(?:\s|#[^\n]*\n)+"
    header = re.compile(rb"P[25]" + (gap + rb"(\d{1,9})") * 3 + rb"(?:#[^\n]*\n)?\s").match(data)
    if header is None:
        raise TaskliftError(f"{path}: damaged PGM header; expected P2 or P5, width, height, largest value")
    width, height, largest = (int(v) for v in header.groups())
    _check_size(path, width, height)
    if not 1 <= largest <= 65535:
        raise TaskliftError(f"{path}: largest value {largest} of a PGM; expected 1 to 65535")
    n = width * height
    if data[:2] == b"P5":
        dtype = np.dtype(">u2" if largest > 255 else "u1")
        found = (len(data) - header.end()) // dtype.itemsize
        values = np.frombuffer(data, dtype, min(n, found), header.end())
    else:
        body = re.sub(rb"#[^\n]*", b"", data[header.end() :])
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                values = np.fromstring(body, np.int64, sep=" ")
            except (DeprecationWarning, ValueError) as error:
                raise TaskliftError(f"{path}: a P2 picture holds whole numbers only, found other text") from error
    if len(values) < n:
        raise TaskliftError(f"{path}: cut short: {n} pixels announced, {len(values)} found")
    values = values[:n].reshape(height, width)
    if int(values.max()) > largest or int(values.min()) < 0:
        raise TaskliftError(f"{path}: a pixel lies outside the announced range 0 to {largest}")
    return values.astype(np.float32) * np.float32(255 / largest)


def _read_png(path: Path, data: bytes) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    try:
        from PIL import Image
    except ImportError as error:
        raise TaskliftError("Pillow is not installed; type: pip install 'tasklift[plans]'") from error
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)  # we state our own limit below
            with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
                _check_size(path, *image.size)
                if image.mode.startswith("I"):  # 16 bits of grey
                    return np.asarray(image, np.float32) * np.float32(255 / 65535), None
                pixels = np.asarray(image.convert("RGBA"), np.uint8)
                has_alpha = image.mode in ("LA", "RGBA", "PA") or "transparency" in image.info
    except TaskliftError:
        raise
    except (Image.DecompressionBombWarning, Image.DecompressionBombError) as error:
        raise TaskliftError(f"{path}: more pixels than the limit of {LARGEST_PIXELS:,}; make it coarser") from error
    except Exception as error:  # Pillow's decoders raise all sorts on damaged files
        raise TaskliftError(f"{path}: damaged or cut short PNG ({error!s:.100})") from error
    mean = pixels[..., :3].mean(axis=2, dtype=np.float32)
    return mean, pixels[..., 3].astype(np.float32) if has_alpha else None


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _show(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "…"


def _number(where: str, fields: Mapping[str, Any], key: str, most: float, above: float | None = None) -> float:
    if key not in fields:
        raise TaskliftError(f"{where}: field {key!r} is missing")
    value = fields[key]
    fits = _is_number(value) and value <= most and (value > above if above is not None else value >= 0)
    if not fits:
        low = f"above {above:g}" if above is not None else "from 0"
        raise TaskliftError(f"{where}: field {key!r}: expected a number {low} up to {most:g}, found {_show(value)}")
    return float(value)
