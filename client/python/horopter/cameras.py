"""From what ROS and OpenCV say of a camera to what a request says of it."""
from __future__ import annotations

import math
import warnings
from typing import Any, List, Optional, Sequence, Tuple

from .types import CameraHint

_SQUARE = 1e-3  # pixels whose sides differ by less count as square
_LEFT_OUT_PX = 1.0  # what may be left out of a lens moves no pixel by more
_BROWN = ("", "plumbbob", "rationalpolynomial", "rational", "radtan", "radialtangential", "brown", "brownconrady", "opencv",
          "fullopencv", "none", "pinhole")
_FISHEYE = ("equidistant", "fisheye", "opencvfisheye", "kannalabrandt", "kannalabrandt4", "kb4")

Size = Tuple[int, int]


def check_camera_matrix(matrix: Any, name: str = "K") -> List[float]:
    """Nine numbers, row-major, of a list, a list of rows or an array. Raises ValueError where it is not fx s cx, 0 fy cy,
    0 0 1; a transposed one is told as such."""
    k = _flat(matrix)
    if len(k) != 9 or not all(map(math.isfinite, k)):
        raise ValueError("%s needs nine finite numbers" % name)
    zero = 1e-6 * max(1.0, abs(k[0]), abs(k[4]))
    one = abs(k[8] - 1.0) <= 1e-6
    if one and max(abs(k[2]), abs(k[5])) <= zero < max(abs(k[6]), abs(k[7])):
        raise ValueError("%s is transposed: the centre stands in the last row; rows are fx s cx, 0 fy cy, 0 0 1" % name)
    if not one or max(abs(k[6]), abs(k[7])) > 1e-6 or abs(k[3]) > zero:
        raise ValueError("%s is not fx s cx, 0 fy cy, 0 0 1" % name)
    if not (k[0] > 0.0 and k[4] > 0.0 and 0.5 <= k[0] / k[4] <= 2.0):
        raise ValueError("%s: focal lengths %g and %g are not positive, or not within 0.5 to 2 of each other" % (name, k[0], k[4]))
    return k


def hint_from_camera_info(info: Any, image_size: Optional[Size] = None, rectified: bool = False,
                          cropped: bool = False) -> Optional[CameraHint]:
    """CameraHint of a sensor_msgs/CameraInfo (an object, or a mapping with its names); None of an uncalibrated camera (K all 0).

    Raw images are described by K and D (plumb_bob, rational_polynomial, equidistant; any model whose numbers are all 0),
    rectified ones by P, without distortion. image_size: width and height of the image. The region of interest is taken off
    first, then binning; an image that is all of the sensor, or one of both alone, is taken as such by its size. Without
    region and binning a K of another size and the same shape counts as scaled, with a warning. cropped: the image is a cut-out, whose centre may be
    outside. Raises ValueError: K is none (see check_camera_matrix), the image is of no such size, the lens is not taken.
    """
    width, height = int(_get(info, "width", "image_width") or 0), int(_get(info, "height", "image_height") or 0)
    if rectified:
        p = _flat(_get(info, "p", "P", "projection_matrix"))
        if not any(p):
            return None
        if len(p) != 12:
            raise ValueError("P needs twelve numbers")
        k, d, model = check_camera_matrix(p[0:3] + p[4:7] + p[8:11], "P"), [], ""
    else:
        k = _flat(_get(info, "k", "K", "camera_matrix", "mtx", "CameraMatrix", "cam_K"))
        if not any(k):
            return None
        k = check_camera_matrix(k)
        d = _flat(_get(info, "d", "D", "distortion_coefficients", "dist", "dist_coeffs", "dist_coeff"))
        model = str(_get(info, "distortion_model") or "")
    (fx, fy), (cx, cy) = _placed(info, (width, height), image_size, (k[0], k[4]), (k[2], k[5]))
    size = image_size or ((width, height) if width and height and not _region(info) else None)
    if size is not None and not cropped and not (-0.5 <= cx <= size[0] - 0.5 and -0.5 <= cy <= size[1] - 0.5):
        raise ValueError("the principal point %g, %g is outside of the image of %d x %d" % (cx, cy, size[0], size[1]))
    reach = math.hypot(max(cx, (size or (2 * cx, 0))[0] - cx) / fx, max(cy, (size or (0, 2 * cy))[1] - cy) / fy)
    if abs(k[1]) * reach > _LEFT_OUT_PX:
        raise ValueError("the skew %g is not taken: calibrate without it" % k[1])
    hint = CameraHint(focal_px=fx, principal_point_px=(cx, cy))
    _set_lens(hint, fx, fy, d, model, reach)
    return hint


def _set_lens(hint: CameraHint, fx: float, fy: float, d: Sequence[float], model: str, reach: float) -> None:
    plain = model.rpartition(".")[2].lower().replace("_", "").replace("-", "").replace(" ", "")
    if not all(map(math.isfinite, d)):
        raise ValueError("D: a number is not finite")
    if plain in _FISHEYE:
        if len(d) < 4 or any(d[4:]):
            raise ValueError("D: distortion_model %s has four numbers, not %d" % (model, len(d)))
        hint.focal_y_px, hint.fisheye = fy, tuple(d[:4])
        return
    if any(d) and plain not in _BROWN:
        raise ValueError("distortion_model %r is not read; plumb_bob, rational_polynomial and equidistant are, and any whose "
                         "numbers are all 0" % model)
    if len(d) > 14:
        raise ValueError("D: more than 14 numbers")
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, t1, t2 = (list(d) + [0.0] * 14)[:14]
    r2 = reach * reach
    thin = max(fx, fy) * r2 * (math.hypot(s1 + r2 * s2, s3 + r2 * s4) + abs(t1) + abs(t2))
    if thin > _LEFT_OUT_PX:
        raise ValueError("D: thin prism and tilt (numbers 9 to 14) move pixels by up to %.2g and are not read" % thin)
    hint.k1 = k1
    # Square pixels and k1 alone are told without a rectification.
    if abs(fx / fy - 1.0) < _SQUARE and not any((k2, p1, p2, k3, k4, k5, k6)):
        hint.focal_px = math.sqrt(fx * fy)
        return
    hint.focal_y_px = fy
    hint.k2, hint.p1, hint.p2, hint.k3 = k2, p1, p2, k3
    if any((k4, k5, k6)):
        hint.k4, hint.k5, hint.k6 = k4, k5, k6


def _region(info: Any) -> Optional[Tuple[int, int, int, int, int, int]]:
    """x, y, width, height (0: all that is left) of the region, and binning; None where there is neither."""
    roi = _get(info, "roi")
    x, y, w, h = (int(_get(roi, name) or 0) for name in ("x_offset", "y_offset", "width", "height"))
    bx, by = max(1, int(_get(info, "binning_x") or 0)), max(1, int(_get(info, "binning_y") or 0))
    width, height = int(_get(info, "width", "image_width") or 0), int(_get(info, "height", "image_height") or 0)
    if min(x, y, w, h) < 0 or (width and (x >= width or x + w > width)) or (height and (y >= height or y + h > height)):
        raise ValueError("the roi is not within %d x %d" % (width, height))
    whole = not x and not y and w in (0, width) and h in (0, height)
    return None if whole and bx == by == 1 else (x, y, w, h, bx, by)


def _placed(info: Any, size: Size, image: Optional[Size], focal: Tuple[float, float], centre: Tuple[float, float]):
    """Focal lengths and centre in the pixels of the image."""
    region = _region(info)
    x, y, bx, by = 0, 0, 1.0, 1.0
    if region is not None:
        x, y, w, h, bin_x, bin_y = region
        w, h = w or size[0] - x, h or size[1] - y
        bx, by = float(bin_x), float(bin_y)
        if image is not None and w > 0 and h > 0:
            def fits(of: Size, b: Size) -> bool:
                return all(o > 0 and i in (o // n, -(-o // n)) for i, o, n in zip(image, of, b))
            ways = [((w, h), (bin_x, bin_y), (x, y)), ((w, h), (1, 1), (x, y)), (size, (bin_x, bin_y), (0, 0)),
                    (size, (1, 1), (0, 0))]
            fitting = {(b, at) for of, b, at in ways if fits(of, b)}
            told = ((bin_x, bin_y), (x, y))
            if told in fitting and fits((w, h), (bin_x, bin_y)):
                fitting = {told}
            if len(fitting) != 1:
                raise ValueError("the image has %d x %d, which is %s: the camera has %d x %d with a roi of %d x %d at %d, %d and a "
                                 "binning of %d x %d" % (*image, "both the region and all of it binned" if fitting else
                                                         "neither all, nor the region, nor either of them binned", *size, w, h,
                                                         x, y, bin_x, bin_y))
            ((bin_x, bin_y), (x, y)), = fitting
            bx, by = float(bin_x), float(bin_y)
    elif image is not None and all(size) and tuple(image) != tuple(size):
        bx = by = size[0] / image[0]
        if abs(image[1] * by / size[1] - 1.0) > 0.01:
            raise ValueError("the camera was calibrated with images of %d x %d, the image has %d x %d" % (*size, *image))
        warnings.warn("calibrated with images of %d x %d; that of %d x %d is supposed to be scaled by %.4g and not cut"
                      % (*size, *image, 1.0 / bx), stacklevel=3)
    # Pixel centres are integers: the image's edge lies at -0.5.
    return ((focal[0] / bx, focal[1] / by), ((centre[0] - x + 0.5) / bx - 0.5, (centre[1] - y + 0.5) / by - 0.5))


def _get(of: Any, *names: str) -> Any:
    for name in names:
        value = of.get(name) if isinstance(of, dict) else getattr(of, name, None)
        if value is not None and not (hasattr(value, "__len__") and len(value) == 0):
            return value
    return None


def _flat(numbers: Any) -> List[float]:
    """Of a list, a list of lists, an array, or the `data` of a mapping; none of None. Raises ValueError for anything else: what
    is not understood must not count as a lens without distortion."""
    if isinstance(numbers, dict):
        if numbers and "data" not in numbers:
            raise ValueError("%s is no list of numbers" % sorted(map(str, numbers)))
        numbers = numbers.get("data")
    if numbers is None:
        return []
    if isinstance(numbers, (str, bytes)):
        raise ValueError("%r is no list of numbers" % numbers[:40])
    if not hasattr(numbers, "__iter__"):
        numbers = [numbers]
    out: List[float] = []
    for n in numbers:
        out += _flat(n) if hasattr(n, "__len__") and getattr(n, "shape", None) != () else [float(n)]
    return out
