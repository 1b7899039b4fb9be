"""Writes a flat capture set of a known fall-off, larger than memory: frames of 768 × 496 floats, 0 but for a window around the spot.
   python3 benches/scatter/large_capture.py FOLDER [GIGABYTES]      (no packages needed)
Its frames, unpacked, have at least that many gigabytes. R = 0.05 exp(-1.2 r) per mm² in red, 0.8 and 0.6 of it in green and blue."""
import array, gzip, json, math, os, sys

WIDTH, HEIGHT, FOCAL, DISTANCE = 768, 496, 6000.0, 600.0
PX_PER_MM = FOCAL / DISTANCE
HALF = 60  # of the window, in pixels
AMPLITUDE, DECAY, COLOURS = 0.05, 1.2, (1.0, 0.8, 0.6)


def transmitted(cos, eta):
    sin2 = (1 - cos * cos) / eta / eta
    inner = math.sqrt(1 - sin2)
    s, p = (cos - eta * inner) / (cos + eta * inner), (eta * cos - inner) / (eta * cos + inner)
    return 1 - (s * s + p * p) / 2


def main():
    folder, gigabytes = sys.argv[1], float(sys.argv[2]) if len(sys.argv) > 2 else 4.0
    frames = math.ceil(gigabytes * 2**30 / (WIDTH * HEIGHT * 4) / 3)
    side = math.ceil(math.sqrt(frames))
    # Whole pixels apart, so that each spot lies in the middle of one.
    step = min((WIDTH - 2 * HALF - 2) // side, (HEIGHT - 2 * HALF - 2) // side)
    offset = [(k - (side - 1) / 2) * step for k in range(side)]
    offset = [math.floor(o) + 0.5 for o in offset]
    hits = [[x / PX_PER_MM, -y / PX_PER_MM, 0.0] for y in offset for x in offset]
    rig = {
        "format": "translume capture", "version": "1.1", "units": "mm", "frames": "frames", "mesh": "mesh.ply", "eta": 1.3,
        "channels": [{"name": n, "wavelength_nm": w, "white_balance": 1.0, "noise_floor": 1e-7}
                     for n, w in (("red", 640), ("green", 532), ("blue", 473))],
        "views": [{"turntable_deg": 0.0, "camera": {
            "width": WIDTH, "height": HEIGHT, "focal_px": FOCAL, "center_px": [WIDTH / 2, HEIGHT / 2],
            "camera_from_world": [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, DISTANCE]]}}],
        "laser": {"origin_mm": [0, 0, 1e6], "beam_diameter_mm": 1.0, "power": [1, 1, 1], "grid": [side, side], "hits_mm": hits},
        "provenance": {"made": "benches/scatter/large_capture.py"},
    }
    os.makedirs(os.path.join(folder, "frames"))
    json.dump(rig, open(os.path.join(folder, "rig.json"), "w"))
    with open(os.path.join(folder, "mesh.ply"), "w") as f:
        f.write("ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
                "property list uchar int vertex_indices\nend_header\n-50 -50 0\n50 -50 0\n50 50 0\n-50 50 0\n3 0 1 2\n3 0 2 3\n")
    shape = [1, len(hits), 3, HEIGHT, WIDTH]
    meta = {
        "zarr_format": 3, "node_type": "array", "shape": shape, "data_type": "float32", "fill_value": 0.0,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": [1, 1, 1, HEIGHT, WIDTH]}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "gzip", "configuration": {"level": 1}}],
        "dimension_names": ["view", "position", "channel", "row", "column"], "attributes": {},
    }
    json.dump(meta, open(os.path.join(folder, "frames", "zarr.json"), "w"))
    # L = R F_t(out) F_t(in) / pi; the angle to the camera changes little over a window, so it is that of the spot.
    window = [[math.exp(-DECAY * math.hypot(x, y) / PX_PER_MM) for x in range(-HALF, HALF + 1)] for y in range(-HALF, HALF + 1)]
    for position, (x, y, _) in enumerate(hits):
        cos = DISTANCE / math.sqrt(DISTANCE**2 + x * x + y * y)
        scale = AMPLITUDE * transmitted(cos, 1.3) * transmitted(1.0, 1.3) / math.pi
        column, row = int(x * PX_PER_MM + WIDTH / 2) - HALF, int(-y * PX_PER_MM + HEIGHT / 2) - HALF
        for channel, colour in enumerate(COLOURS):
            frame = bytearray(4 * WIDTH * HEIGHT)
            for j, line in enumerate(window):
                at = 4 * ((row + j) * WIDTH + column)
                frame[at:at + 4 * len(line)] = array.array("f", [scale * colour * v for v in line]).tobytes()
            path = os.path.join(folder, "frames", "c", "0", str(position), str(channel), "0")
            os.makedirs(path)
            with gzip.open(os.path.join(path, "0"), "wb", compresslevel=1) as f:
                f.write(frame)
    unpacked = math.prod(shape) * 4 / 2**30
    print(f"{len(hits)} laser positions, {3 * len(hits)} frames, {unpacked:.2f} GiB unpacked")


if __name__ == "__main__":
    main()
