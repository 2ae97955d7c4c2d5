"""Paint shaded solids into a colour picture and a depth map, with true occlusion.

Every solid is drawn as a convex outline with soft edges, then tested pixel by pixel against the
depth that is already there. Motion blur is the mean of the outline over the exposure. Work is
done only on the pixels of the outline: a whole scene is some ten thousand of them.
"""

import math
from typing import Callable, Optional, Sequence, Tuple

import cv2
import numpy as np

from apex_edge.geometry import project, rays
from apex_edge.twin.palette import Bgr
from apex_edge.types import Array, CameraModel

LIGHT = np.array([0.34, 0.42, 0.84]) / np.linalg.norm([0.34, 0.42, 0.84])
AMBIENT = 0.52
DIFFUSE = 0.56
SHADOW = 0.42
NEAREST_M = 0.05
SHIFT_BITS = 4
MAX_BLUR_SAMPLES = 6
_CIRCLE = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
_RING = np.column_stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])

Surface = Callable[[Array, Array], Tuple[Array, Array]]
"""Ray slopes x/z, y/z of m pixels -> depth (m,) in m and shade (m,)."""


class Lens:
    """One camera's geometry, computed once: viewing rays of all pixels in its own frame."""

    def __init__(self, camera: CameraModel) -> None:
        self.camera = camera
        self.shape = camera.height_px, camera.width_px
        self.rotation: Array = np.ascontiguousarray(camera.table_from_cam[:3, :3].T)
        self.eye_m: Array = camera.table_from_cam[:3, 3]
        self.light: Array = self.rotation @ LIGHT
        ys, xs = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
        table_rays = rays(camera, np.column_stack([xs.ravel(), ys.ravel()]))
        cam_rays = table_rays @ self.rotation.T
        self.slope_x: Array = cam_rays[:, 0].astype(np.float32)
        self.slope_y: Array = cam_rays[:, 1].astype(np.float32)
        self.table_rays: Array = table_rays.reshape(*self.shape, 3)
        self._is_plain = not np.any(camera.dist)

    def to_cam(self, points_m: Array) -> Array:
        """Return table points (n, 3) in the camera frame."""
        result: Array = (points_m - self.eye_m) @ self.rotation.T
        return result

    def pixels(self, cam_m: Array) -> Array:
        """Project points (n, 3) of the camera frame to pixels (n, 2)."""
        camera = self.camera
        if self._is_plain:
            scale = np.array([camera.fx_px, camera.fy_px])
            result: Array = cam_m[:, :2] / cam_m[:, 2:] * scale + (camera.cx_px, camera.cy_px)
            return result
        return project(camera, cam_m @ self.rotation + self.eye_m)[0]


class Canvas:
    """A picture in the making: ``colour (h, w, 3)`` uint8 and ``depth_m (h, w)`` float32."""

    def __init__(self, lens: Lens, colour: Array, depth_m: Array, exposure_s: float) -> None:
        self.lens = lens
        self.colour = colour
        self.depth_m = depth_m
        self.exposure_s = exposure_s
        self._colour_rows = colour.reshape(-1, 3)
        self._depth_row = depth_m.reshape(-1)

    def sphere(
        self, centre_m: Array, radius_m: float, bgr: Bgr, vel_m_s: Array, gloss: float = 0.0
    ) -> None:
        """Paint a ball; ``gloss`` is the strength of its highlight."""
        centre = self.lens.to_cam(np.asarray(centre_m, dtype=np.float64)[None])[0]
        if centre[2] < NEAREST_M + radius_m:
            return
        surface = _ball_surface(centre, radius_m, self.lens.light, gloss)
        self._paint(_sphere_outline(centre, radius_m), surface, bgr, self._blur(centre, vel_m_s))

    def polygon(self, corners_m: Array, bgr: Bgr, vel_m_s: Array, lift_m: float = 0.0) -> None:
        """Paint a flat convex face (k, 3); ``lift_m`` brings a marking in front of its ground."""
        cam = self.lens.to_cam(np.asarray(corners_m, dtype=np.float64))
        if cam[:, 2].min() < NEAREST_M:
            return
        normal = _cross(cam[1] - cam[0], cam[2] - cam[0])
        nx, ny, nz = (normal / math.sqrt(float(normal @ normal))).tolist()
        offset = float(normal @ cam[0]) / math.sqrt(float(normal @ normal))
        facing = -1.0 if offset > 0.0 else 1.0
        lx, ly, lz = self.lens.light.tolist()
        lit = AMBIENT + DIFFUSE * max(facing * (nx * lx + ny * ly + nz * lz), 0.0)

        def surface(sx: Array, sy: Array) -> Tuple[Array, Array]:
            z = offset / (nx * sx + ny * sy + nz) - lift_m
            return z, np.full(len(sx), lit, np.float32)

        self._paint(cam, surface, bgr, self._blur(cam.mean(axis=0), vel_m_s))

    def box(self, centre_m: Array, half_m: Array, yaw_rad: float, bgr: Bgr, vel_m_s: Array) -> None:
        """Paint an upright box with ``half_m (3,)`` half sides: every face that shows."""
        corners = box_corners(centre_m, half_m, yaw_rad)
        middle = corners.mean(axis=0)
        for face in _FACES:
            points = corners[list(face)]
            outward = points.mean(axis=0) - middle
            if outward @ (self.lens.eye_m - points.mean(axis=0)) > 0.0:
                self.polygon(points, bgr, vel_m_s)

    def capsule(
        self, ends_m: Array, radii_m: Tuple[float, float], bgr: Bgr, vel_m_s: Array
    ) -> None:
        """Paint a round bar between ``ends_m (2, 3)``, tapered from one radius to the other."""
        cam = self.lens.to_cam(np.asarray(ends_m, dtype=np.float64))
        if cam[:, 2].min() < NEAREST_M + max(radii_m):
            return
        rims = [_sphere_outline(cam[k], radii_m[k]) for k in (0, 1)]
        surface = _bar_surface(cam, radii_m, self.lens.light)
        self._paint(np.concatenate(rims), surface, bgr, self._blur(cam.mean(axis=0), vel_m_s))

    def shade_ground(self, outlines_m: Sequence[Array], is_table: Array) -> None:
        """Darken the table (mask ``is_table`` (h, w) 0/255) under shadow outlines (k, 3) each."""
        mask = np.zeros(self.lens.shape, np.uint8)
        low, high = np.array(self.lens.shape[::-1]), np.zeros(2, np.int64)
        for outline in outlines_m:
            cam = self.lens.to_cam(outline)
            if cam[:, 2].min() < NEAREST_M:
                continue
            hull = _fixed_point(_hull(self.lens.pixels(cam)))
            cv2.fillConvexPoly(mask, hull, 255, cv2.LINE_AA, SHIFT_BITS)
            low = np.minimum(low, (hull.min(axis=0) >> SHIFT_BITS) - 9)
            high = np.maximum(high, (hull.max(axis=0) >> SHIFT_BITS) + 10)
        x0, y0 = np.maximum(low, 0)
        x1, y1 = np.minimum(high, self.lens.shape[::-1])
        if x0 >= x1 or y0 >= y1:
            return
        soft = cv2.GaussianBlur(mask[y0:y1, x0:x1], (0, 0), 2.2) & is_table[y0:y1, x0:x1]
        light = cv2.convertScaleAbs(soft, alpha=-SHADOW, beta=255.0)
        window = self.colour[y0:y1, x0:x1]
        window[:] = cv2.multiply(window, cv2.merge([light] * 3), scale=1.0 / 255.0)

    def _blur(self, cam_m: Array, vel_m_s: Array) -> Optional[Array]:
        """Return the pixel shifts (k, 2) of a point over the exposure, None when it is sharp."""
        way = self.lens.rotation @ np.asarray(vel_m_s, dtype=np.float64) * self.exposure_s
        if not way.any():
            return None
        ends = self.lens.pixels(np.array([cam_m - 0.5 * way, cam_m + 0.5 * way]))
        length = float(np.linalg.norm(ends[1] - ends[0]))
        if length < 0.5:
            return None
        n_samples = min(MAX_BLUR_SAMPLES, int(length) + 2)
        result: Array = np.linspace(-0.5, 0.5, n_samples)[:, None] * (ends[1] - ends[0])
        return result

    def _paint(self, cam: Array, surface: Surface, bgr: Bgr, shifts: Optional[Array]) -> None:
        """Fill the hull of camera-frame points with a surface, where it is in front."""
        hull = _hull(self.lens.pixels(cam))
        reach = 2.0 if shifts is None else 2.0 + float(np.abs(shifts).max())
        height, width = self.lens.shape
        x0, y0 = np.maximum(np.floor(hull.min(axis=0) - reach), 0).astype(int)
        x1, y1 = np.minimum(np.ceil(hull.max(axis=0) + reach) + 1, (width, height)).astype(int)
        if x0 >= x1 or y0 >= y1:
            return
        alpha = self._coverage(hull - (x0, y0), (y1 - y0, x1 - x0), shifts)
        flat = alpha.reshape(-1)
        inside = np.flatnonzero(flat)
        at = inside + (inside // (x1 - x0)) * (width - (x1 - x0)) + (y0 * width + x0)
        depth, shade = surface(self.lens.slope_x.take(at), self.lens.slope_y.take(at))
        front = np.flatnonzero(depth < self._depth_row.take(at))
        if len(front) < len(at):
            at, inside, depth, shade = (part.take(front) for part in (at, inside, depth, shade))
        cover = flat.take(inside)
        colour = np.minimum(shade[:, None] * np.asarray(bgr, dtype=np.float32), 255.0)
        soft = np.flatnonzero(cover < 255)
        weight = (cover.take(soft) * np.float32(1.0 / 255.0))[:, None]
        under = self._colour_rows.take(at.take(soft), axis=0)
        colour[soft] = under * (1.0 - weight) + weight * colour.take(soft, axis=0)
        self._colour_rows[at] = colour
        solid = np.flatnonzero(cover > 127)
        self._depth_row[at.take(solid)] = depth.take(solid)

    def _coverage(self, hull: Array, shape: Tuple[int, int], shifts: Optional[Array]) -> Array:
        """Return how much of each pixel of a window the outline covers, 0..255."""
        if shifts is None:
            mask = np.zeros(shape, np.uint8)
            cv2.fillConvexPoly(mask, _fixed_point(hull), 255, cv2.LINE_AA, SHIFT_BITS)
            return mask
        total = np.zeros(shape, np.float32)
        for shift in shifts:
            mask = np.zeros(shape, np.uint8)
            cv2.fillConvexPoly(mask, _fixed_point(hull + shift), 255, cv2.LINE_AA, SHIFT_BITS)
            cv2.accumulate(mask, total)
        return np.asarray(cv2.convertScaleAbs(total, alpha=1.0 / len(shifts)))


_FACES = ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))


def box_corners(centre_m: Array, half_m: Array, yaw_rad: float) -> Array:
    """Return the corners (8, 3) of an upright box, the four at the bottom first."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    corners = np.array(
        [(a, b, z) for z in (-1, 1) for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    )
    corners = corners * np.asarray(half_m)
    turned = corners[:, :2] @ np.array([[c, s], [-s, c]])
    result: Array = np.column_stack([turned, corners[:, 2]]) + centre_m
    return result


def shadow_of(points_m: Array, radius_m: float = 0.0) -> Array:
    """Return the shadow (k, 3) that points, or spheres around them, throw on the table."""
    points = np.atleast_2d(np.asarray(points_m, dtype=np.float64))
    fallen = points[:, :2] - points[:, 2:] / LIGHT[2] * LIGHT[:2]
    if radius_m > 0.0:
        fallen = (fallen[:, None, :] + radius_m * _RING[::2][None]).reshape(-1, 2)
    result: Array = np.column_stack([fallen, np.zeros(len(fallen))])
    return result


def _cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors; np.cross takes 30 us for this."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _sphere_outline(centre: Array, radius_m: float) -> Array:
    """Return points (k, 3) of the circle along which a sphere is seen from the origin."""
    x, y, z = centre.tolist()
    square = x * x + y * y + z * z
    shrink = 1.0 - radius_m * radius_m / square
    radius = radius_m * math.sqrt(shrink)
    # Two directions square to the line of sight: (-z, 0, x) and sight x that.
    flat, length = math.hypot(x, z), math.sqrt(square)
    basis = np.array([(-z, 0.0, x), (x * y / length, -flat * flat / length, y * z / length)])
    result: Array = centre * shrink + (radius / flat) * (_RING @ basis)
    return result


def _ball_surface(centre: Array, radius_m: float, light: Array, gloss: float) -> Surface:
    """Return depth and shade of a ball; plain floats keep the arrays in float32."""
    cx, cy, cz = centre.tolist()
    lx, ly, lz = light.tolist()
    half = light - centre / math.sqrt(float(centre @ centre))
    hx, hy, hz = (half / math.sqrt(float(half @ half))).tolist()
    tangent = cx * cx + cy * cy + cz * cz - radius_m * radius_m

    def surface(sx: Array, sy: Array) -> Tuple[Array, Array]:
        a = sx * sx + sy * sy + 1.0
        b = sx * cx + sy * cy + cz
        z = (b - np.sqrt(np.maximum(b * b - a * tangent, 0.0))) / a
        nx, ny, nz = z * sx - cx, z * sy - cy, z - cz
        lit = np.maximum(nx * lx + ny * ly + nz * lz, 0.0) * (DIFFUSE / radius_m)
        shade = 1.06 * (AMBIENT + lit)
        if gloss > 0.0:
            shine = np.maximum(nx * hx + ny * hy + nz * hz, 0.0) / radius_m
            for _ in range(5):  # to the power of 32
                shine = shine * shine
            shade = shade + gloss * shine
        return z, shade

    return surface


def _bar_surface(cam: Array, radii_m: Tuple[float, float], light: Array) -> Surface:
    """Return depth and shade of a round bar, taken as a cylinder across its axis.

    Across the bar the exact cylinder is used; along it the radius goes from end to end, which is
    off by less than the taper times the radius.
    """
    start, axis = cam[0], cam[1] - cam[0]
    length = max(math.sqrt(float(axis @ axis)), 1e-9)
    ax, ay, az = (axis / length).tolist()
    offset = float(start @ axis) / length
    wx, wy, wz = (start - offset * axis / length).tolist()
    lx, ly, lz = light.tolist()
    square = wx * wx + wy * wy + wz * wz
    first, taper = radii_m[0], radii_m[1] - radii_m[0]

    def surface(sx: Array, sy: Array) -> Tuple[Array, Array]:
        # Work across the axis: u is the ray and w the bar, both with their axial part removed.
        along = sx * ax + sy * ay + az
        ux, uy, uz = sx - along * ax, sy - along * ay, 1.0 - along * az
        a = np.maximum(ux * ux + uy * uy + uz * uz, 1e-9)
        b = ux * wx + uy * wy + uz * wz
        middle = b / a
        share = np.clip((middle * along - offset) * (1.0 / length), 0.0, 1.0)
        radius = share * taper + first
        z = middle - np.sqrt(np.maximum(radius * radius - square + b * middle, 0.0) / a)
        lit = (z * ux - wx) * lx + (z * uy - wy) * ly + (z * uz - wz) * lz
        return z, np.clip(lit / radius, 0.0, 1.0) * (1.04 * DIFFUSE) + 1.04 * AMBIENT

    return surface


def _hull(pixels: Array) -> Array:
    found: Array = cv2.convexHull(np.asarray(pixels, dtype=np.float32)).reshape(-1, 2)
    return found


def _fixed_point(pixels: Array) -> Array:
    result: Array = np.rint(np.asarray(pixels) * (1 << SHIFT_BITS)).astype(np.int32)
    return result
