"""A scene seen by a camera held by hand, with the true displacement of every pixel.

A shot is described by where its pixels lie in the anchor's frame (`back`, for making the picture) and by where the
anchor's pixels lie in it (`forth`, the truth for a displacement field). Both are arrays (rows, columns, 2) of x and y.
"""
import cv2
import numpy as np

FULL_WELL, READ_NOISE = 12000.0, 4.0  # electrons
WHITE_SECS = 1 / 15  # radiance 1 fills the well
MARGIN = 0.1  # of the scene's sides, which the anchor does not see


def response(x):
    """Code in [0, 1] over exposure in [0, 1]: a power of 1/2.2 with a toe and a shoulder; as translume-hdr's simulate."""
    v = np.clip(x, 0, 1) ** (1 / 2.2)
    return v - 0.5 * np.sin(2 * np.pi * v) / (2 * np.pi)


def expose(view, secs, rng, depth):
    """What the camera writes: uint8 or uint16 codes through the response, or floats proportional to exposure."""
    electrons = np.minimum(np.maximum(view, 0) * secs / WHITE_SECS, 2) * FULL_WELL
    electrons = rng.poisson(electrons) + rng.normal(0, READ_NOISE, view.shape)
    linear = np.clip(electrons / FULL_WELL, 0, 1)
    if depth == "linear":
        return linear.astype(np.float32)
    top, kind = (255, np.uint8) if depth == "8 bit" else (65535, np.uint16)
    return np.round(top * response(linear)).astype(kind)


def frame_of(scene):
    """(x, y, width, height) of the anchor's frame within the scene."""
    h, w = scene.shape[:2]
    x, y = int(w * MARGIN), int(h * MARGIN)
    return x, y, w - 2 * x, h - 2 * y


def grid(frame):
    y, x = np.mgrid[0:frame[3], 0:frame[2]].astype(np.float32)
    return np.stack([x, y], -1)


def view(scene, frame, back):
    """The scene at anchor positions `back`; what lies beside the scene is mirrored."""
    m = (back + np.float32([frame[0], frame[1]])).astype(np.float32)
    near = cv2.remap(scene, m, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT)
    return np.maximum(near, 0)


def rigid(frame, degrees, dx, dy):
    """back and forth of a rotation about the frame's middle and a shift."""
    a, p = np.radians(degrees), grid(frame)
    c = np.float32([(frame[2] - 1) / 2, (frame[3] - 1) / 2])
    turn = np.float32([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])  # of row vectors
    shift = np.float32([dx, dy])
    return (p - c - shift) @ turn.T + c, (p - c) @ turn + c + shift


def smooth(frame, displacement):
    """back and forth of a smooth displacement, given as a function of the shot's own pixels."""
    p = grid(frame)
    back = p - displacement(p)
    forth = p.copy()
    for _ in range(20):  # forth is where back comes home: a fixed point, the displacement varies slowly
        forth = p + displacement(forth)
    return back, forth


def depth_ramp(frame, px):
    """Parallax of a floor: the lower part of the picture moves further than the upper."""
    h = frame[3]
    return smooth(frame, lambda p: np.stack([px * (0.3 + 0.7 * p[..., 1] / h), np.full(p.shape[:2], px * 0.2)], -1).astype(np.float32))


class Object:
    """A disc with the scene's own texture, turned around and brighter, that is somewhere else in every shot."""
    def __init__(self, scene, frame):
        s = int(0.11 * frame[3])
        x, y = frame[0] + frame[2] // 4, frame[1] + frame[3] // 4
        patch = scene[y - s:y + s, x - s:x + s, ::-1][::-1]
        self.patch = np.minimum(1.5 * patch + 0.05, 0.7).astype(np.float32)
        yy, xx = np.mgrid[-s:s, -s:s] + 0.5
        self.share = np.clip(s - np.hypot(xx, yy), 0, 1)[..., None].astype(np.float32)
        self.half, self.frame = s, frame

    def centre(self, px):
        return int(self.frame[2] * 0.5 + px), int(self.frame[3] * 0.55)

    def put(self, scene, px):
        """The scene with the object px to the right of the middle."""
        out, s = scene.copy(), self.half
        x, y = self.centre(px)
        here = (slice(self.frame[1] + y - s, self.frame[1] + y + s), slice(self.frame[0] + x - s, self.frame[0] + x + s))
        out[here] += self.share * (self.patch - out[here])
        return out

    def hides(self, px):
        """Anchor pixels on or next to the object."""
        x, y = self.centre(px)
        p = grid(self.frame)
        return np.hypot(p[..., 0] - x, p[..., 1] - y) < self.half + 6


class Layers:
    """Upright strips before a background, each layer moved as a whole: large parallax with occlusion."""
    def __init__(self, scene, frame):
        p = grid(frame)
        self.scene, self.frame = scene, frame
        self.front = cv2.flip(scene, -1) * 0.7 + 0.02  # the scene turned around
        w = frame[2]
        self.strips = [(0.18 * w, 0.09 * w), (0.55 * w, 0.12 * w), (0.85 * w, 0.06 * w)]
        self.p = p

    def front_at(self, p, near):
        """Which positions the front layer covers, when moved by `near`."""
        return np.any([np.abs(p[..., 0] - near - c) < half for c, half in self.strips], axis=0)

    def shot(self, near, far):
        """(view, forth, anchor pixels where forth is known) with the layers moved by near and far pixels to the right."""
        step = lambda d: np.float32([d, 0])
        back, front = (view(s, self.frame, self.p - step(d)) for s, d in ((self.scene, far), (self.front, near)))
        seen = np.where(self.front_at(self.p, near)[..., None], front, back)
        mine = self.front_at(self.p, 0)
        forth = self.p + np.where(mine[..., None], step(near), step(far))
        known = mine | ~self.front_at(forth, near)
        inside = (forth[..., 0] >= 0) & (forth[..., 0] < self.frame[2])
        return seen, forth, known & inside
