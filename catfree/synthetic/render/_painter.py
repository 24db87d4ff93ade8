"""Drawing of people, their shadows and sensor noise into the still picture of one camera."""

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from catfree.synthetic._silhouettes import on_ground, project_points
from catfree.synthetic._walkers import Walkers
from catfree.synthetic.render._backdrop import Background
from catfree.synthetic.render._bodies import BAG, FACES, PART, TUBE, body_vertices
from catfree.synthetic.render._clothes import dress
from catfree.synthetic.render._stage import Stage
from catfree.types import Rig

OVERSAMPLING = 2  # bodies are drawn in patches of twice the size and averaged down
FRACTION_BITS = 3  # polygon corners are rounded to eighths of a sample
SHADOW_SCALE = 2  # shadows are drawn in a picture of half the size
NEAREST = 0.8  # meters; people closer to the camera are not drawn
NOISE = 2.0  # gray levels of sensor noise, standard deviation
NOISE_PICTURES = 5

Frame = UInt8[np.ndarray, "row column 3"]


class Painter:
    """One camera's view of a world: `paint(frame)` gives its picture."""

    def __init__(
        self, walkers: Walkers, rig: Rig, camera: int, background: Background, stage: Stage
    ) -> None:
        self.walkers, self.rig, self.camera = walkers, rig, camera
        self.background, self.stage = background, stage
        self.clothes, self.has_bag = dress(len(walkers.height), stage.seed)
        self.center = np.asarray(rig.centers)[camera]
        rows, columns = background.picture.shape[:2]
        size = (columns // SHADOW_SCALE, rows // SHADOW_SCALE)
        self.sunlit = cv2.resize(background.sunlit, size, interpolation=cv2.INTER_AREA)
        direct = stage.sunlight * float(stage.sun[2])
        self.darkening = direct / (direct + stage.skylight)
        rng = np.random.default_rng([stage.seed, 12, camera])
        middle = 4 * NOISE
        self.noise_middle = np.full_like(background.picture, int(middle))
        self.noise = [
            np.clip(rng.normal(middle, NOISE, (rows, columns, 3)), 0, 255).astype(np.uint8)
            for _ in range(NOISE_PICTURES)
        ]

    def paint(self, frame: int) -> Frame:
        """Paint the (H, W, 3) BGR picture of a frame."""
        picture = self.background.picture.copy()
        people, vertices = self._bodies(frame)
        self._shadows(picture, vertices)
        self._draw_bodies(picture, people, vertices)
        picture = cv2.add(picture, self.noise[frame % NOISE_PICTURES])
        return cv2.subtract(picture, self.noise_middle)

    def _bodies(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Find people who may be seen, farthest first, and their vertices (N, V, 3) in meters."""
        walkers = self.walkers
        people = np.flatnonzero(walkers.present[frame])
        middle = np.column_stack([walkers.position[frame, people], walkers.height[people] / 2])
        pixel, depth = project_points(self.rig, self.camera, middle)
        size = np.asarray(self.rig.image_size)[self.camera]
        # A body with its shadow extends less than a picture's height beyond the border.
        near = (depth > NEAREST) & (pixel > -size[1]).all(-1) & (pixel < size + size[1]).all(-1)
        distance = np.linalg.norm(middle - self.center, axis=-1)
        order = np.argsort(-distance)
        people = people[order[near[order]]]
        speed = np.linalg.norm(walkers.velocity[frame, people], axis=-1)
        body = body_vertices(walkers.stride[frame, people], speed)
        place, heading = walkers.position[frame, people], walkers.heading[frame, people]
        return people, on_ground(body, place, heading, walkers.height[people])

    def _shadows(self, picture: Frame, vertices: Float[np.ndarray, "n v 3"]) -> None:
        """Darken the sunlit ground where bodies stand between it and the sun, in place."""
        sun = self.stage.sun
        ground = vertices - vertices[..., 2:] * (sun / sun[2])
        pixel, depth = project_points(self.rig, self.camera, ground)
        # Pixel centers of the half-size picture are at (2 i + 0.5).
        corner = (pixel - (SHADOW_SCALE - 1) / 2) / SHADOW_SCALE
        mask = np.zeros_like(self.sunlit)
        fixed = np.round(np.clip(corner, -4000, 4000) * 16).astype(np.int32)
        starts = np.flatnonzero(np.diff(TUBE, prepend=-1))
        pieces = list(zip(starts, [*starts[1:], len(TUBE)], strict=True))
        for body in fixed[depth.min(1) >= NEAREST]:
            for first, last in pieces[:-1]:  # the bag's shadow is within the torso's
                hull = cv2.convexHull(body[first:last])
                cv2.fillConvexPoly(mask, hull, 255, cv2.LINE_AA, 4)
        x, y, width, height = cv2.boundingRect(mask)
        if not width:
            return
        pad = 6
        rows = slice(max(y - pad, 0), y + height + pad)
        columns = slice(max(x - pad, 0), x + width + pad)
        typical = np.median(depth)
        blur = self.stage.shadow_blur * self.rig.K[self.camera, 0, 0] / typical / SHADOW_SCALE / 2
        soft = cv2.GaussianBlur(mask[rows, columns], (0, 0), max(float(blur), 0.6))
        soft = cv2.multiply(soft, self.sunlit[rows, columns], scale=self.darkening / 255)
        full = cv2.resize(soft, None, fx=SHADOW_SCALE, fy=SHADOW_SCALE)
        window = picture[
            SHADOW_SCALE * rows.start : SHADOW_SCALE * rows.start + len(full),
            SHADOW_SCALE * columns.start : SHADOW_SCALE * columns.start + full.shape[1],
        ]
        full = cv2.merge([full[: len(window), : window.shape[1]]] * 3)
        cv2.subtract(window, cv2.multiply(window, full, scale=1 / 255), dst=window)

    def _draw_bodies(
        self, picture: Frame, people: np.ndarray, vertices: Float[np.ndarray, "n v 3"]
    ) -> None:
        """Paint every body over what is behind it, in place; furniture in front stays."""
        pixel, depth = project_points(self.rig, self.camera, vertices)
        corner = pixel[:, FACES]  # (N, F, 4, 2)
        diagonal, other = corner[:, :, 2] - corner[:, :, 0], corner[:, :, 3] - corner[:, :, 1]
        facing = diagonal[..., 0] * other[..., 1] - diagonal[..., 1] * other[..., 0] < 0
        facing &= self.has_bag[people, None] | (PART != BAG)
        nearness = depth[:, FACES].mean(-1)
        color = np.round(self._colors(people, vertices) * 255).clip(0, 255)
        rows, columns = picture.shape[:2]
        lows = np.maximum(np.floor(pixel.min(1)).astype(int) - 1, 0)
        highs = np.minimum(np.ceil(pixel.max(1)).astype(int) + 2, [columns, rows])
        away = np.linalg.norm(vertices.mean(1) - self.center, axis=-1)
        drawable = (depth.min(1) >= NEAREST) & (highs - lows >= 2).all(1)
        for body in np.flatnonzero(drawable):
            low, high = lows[body], highs[body]
            window = (slice(low[1], high[1]), slice(low[0], high[0]))
            faces = np.flatnonzero(facing[body])
            faces = faces[np.argsort(-nearness[body, faces])]
            # The center of pixel p is at OVERSAMPLING * p + (OVERSAMPLING - 1) / 2 in the patch.
            inside = (corner[body, faces] - low + 0.5) * OVERSAMPLING - 0.5
            points = np.round(inside * 2**FRACTION_BITS).astype(np.int32)
            patch = cv2.resize(
                picture[window],
                None,
                fx=OVERSAMPLING,
                fy=OVERSAMPLING,
                interpolation=cv2.INTER_NEAREST,
            )
            for face, shade in zip(points, color[body, faces].tolist(), strict=True):
                cv2.fillConvexPoly(patch, face, shade, cv2.LINE_8, FRACTION_BITS)
            drawn = cv2.resize(
                patch, (high[0] - low[0], high[1] - low[1]), interpolation=cv2.INTER_AREA
            )
            in_front = self.background.distance[window] < away[body]
            if in_front.any():
                drawn = np.where(in_front[..., None], picture[window], drawn)
            picture[window] = drawn

    def _colors(
        self, people: np.ndarray, vertices: Float[np.ndarray, "n v 3"]
    ) -> Float[np.ndarray, "n f 3"]:
        """Color the clothes under sun and sky, darker toward the feet, which see less sky."""
        face = vertices[:, FACES]
        normal = np.cross(face[:, :, 2] - face[:, :, 0], face[:, :, 3] - face[:, :, 1])
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        normal = normal / np.maximum(length, 1e-12)
        openness = 0.8 + 0.2 * np.clip(face[..., 2].mean(-1) / 1.2, 0, 1)
        shade = self.stage.light(normal) * openness
        return self.clothes[people][:, PART] * shade[..., None]
