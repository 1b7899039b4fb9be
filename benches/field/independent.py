"""Reads fields with nothing of translume: by docs/formats/field.md, and with block decoders of others. Needs NumPy, Pillow, imagecodecs
and texture2ddecoder (all from PyPI); check also needs OpenEXR.

    independent.py blocks FILE                      writes blocks of each codec and what others decode them to: the fixture of
                                                    crates/translume-field/tests/decoders.rs
    independent.py check FIELD X,Y,Z PICTURE.exr    lights FIELD and compares with the picture of
                                                    `translume field relight FIELD --light X,Y,Z -o PICTURE.exr`
"""
import io
import json
import struct
import sys

import imagecodecs
import numpy as np
import texture2ddecoder
from PIL import Image

# DXGI number for the DX10 header of a DDS file, bytes of a block.
DXGI = {"bc1": (71, 8), "bc4": (80, 8), "bc6h": (95, 16), "bc7": (98, 16)}
# Of Vulkan, in KTX2 files: codec and channels.
VULKAN = {9: ("r8", 1), 70: ("r16", 1), 23: ("rgb8", 3), 131: ("bc1", 3), 139: ("bc4", 1), 143: ("bc6h", 3), 145: ("bc7", 3)}


def pillow(codec, blocks):
    """8-bit values of blocks side by side, by Pillow."""
    number, size = DXGI[codec]
    width = 4 * (len(blocks) // size)
    header = struct.pack("<4s7I44x", b"DDS ", 124, 0x1007, 4, width, 0, 0, 1)
    header += struct.pack("<2I4s5I", 32, 4, b"DX10", 0, 0, 0, 0, 0) + struct.pack("<5I", 0x1000, 0, 0, 0, 0)
    header += struct.pack("<5I", number, 3, 0, 1, 0)
    picture = np.asarray(Image.open(io.BytesIO(header + blocks)))
    return picture[:, :, None] if picture.ndim == 2 else picture[:, :, :3]


def perfare(codec, blocks):
    """The same by texture2ddecoder, which gives BGRA."""
    width = 4 * (len(blocks) // DXGI[codec][1])
    name = {"bc6h": "bc6"}.get(codec, codec)
    raw = getattr(texture2ddecoder, "decode_" + name)(blocks, width, 4)
    picture = np.frombuffer(raw, np.uint8).reshape(4, width, 4)[:, :, [2, 1, 0]]
    return picture[:, :, :1] if codec == "bc4" else picture


def bcdec(codec, blocks, width, height):
    """Values of a texture by imagecodecs (bcdec): 8 bits, for BC6H half floats."""
    channels = {"bc4": (), "bc6h": (3,)}.get(codec, (4,))
    number = {"bc1": 1, "bc4": 4, "bc6h": 6, "bc7": 7}[codec]
    picture = imagecodecs.bcn_decode(blocks, number, shape=(height, width) + channels)
    return picture.reshape(height, width, -1)[:, :, :3]


def make_blocks(codec, rng):
    size, n = DXGI[codec][1], 48
    blocks = rng.integers(0, 256, (n, size), dtype=np.uint8)
    if codec == "bc6h":
        # The four modes with one pair of ends.
        blocks[:, 0] = blocks[:, 0] & 0xE0 | np.array([3, 7, 11, 15], np.uint8)[np.arange(n) % 4]
    if codec == "bc7":
        # Each of the eight modes as often; random ones are nearly always of the first.
        mode = np.arange(n) % 8
        keep = np.array([0xFF << (m + 1) & 0xFF for m in mode], np.uint8)
        blocks[:, 0] = blocks[:, 0] & keep | (1 << mode).astype(np.uint8)
    return blocks


def write_blocks(path):
    rng = np.random.default_rng(6)
    with open(path, "w") as out:
        out.write("# codec, block, values of its 16 texels by channel; written by benches/field/independent.py blocks\n")
        for codec in DXGI:
            blocks = make_blocks(codec, rng)
            values = bcdec(codec, blocks.tobytes(), 4 * len(blocks), 4)
            eight = (255 * np.clip(values.astype(np.float32), 0, 1) + 0.5).astype(int) if codec == "bc6h" else values.astype(int)
            for name, other in (("Pillow", pillow), ("texture2ddecoder", perfare)):
                off = np.abs(other(codec, blocks.tobytes()).astype(int) - eight).max()
                print(f"{codec}: {name} and bcdec differ by at most {off} of 255")
                assert off <= 2, "two decoders that should agree do not"
            codes = values.view(np.uint16) if codec == "bc6h" else values
            for i, block in enumerate(blocks):
                texels = codes[:, 4 * i : 4 * i + 4].reshape(16, -1).T.reshape(-1)
                out.write(f"{codec} {block.tobytes().hex()} {' '.join(map(str, texels))}\n")


def ktx2(data):
    """Codec, and planes by layer and channel in [0, 1], of a KTX2 texture."""
    number, _, width, height, _, layers = struct.unpack_from("<6I", data, 12)
    start, length = struct.unpack_from("<2Q", data, 80)
    codec, channels = VULKAN[number]
    size, planes = length // layers, []
    for j in range(layers):
        layer = data[start + j * size : start + (j + 1) * size]
        if codec in DXGI:
            w, h = -(-width // 4) * 4, -(-height // 4) * 4
            picture = bcdec(codec, layer, w, h)[:height, :width]
            picture = picture.view(np.uint16) / 31743 if codec == "bc6h" else picture / 255
        else:
            kind, last = (np.uint16, 65535) if codec == "r16" else (np.uint8, 255)
            picture = np.frombuffer(layer, kind).reshape(height, width, channels) / last
        planes.append(picture[:, :, :channels])
    return planes


def read(path):
    """The description, buffer views, and the layers as whole pictures (zero with weight zero where a tile has them not)."""
    data = open(path, "rb").read()
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    binary = data[28 + length :]
    view = lambda i: binary[document["bufferViews"][i].get("byteOffset", 0) :][: document["bufferViews"][i]["byteLength"]]
    field = document["extensions"]["TRANSLUME_reflectance_field"]
    assert field["version"].split(".")[0] == "1"
    w, h = field["width"], field["height"]
    textures = [ktx2(view(t)) for t in field["textures"]]
    if "tiles" not in field:
        return field, view, [(textures[l["texture"]][l["layer"]], np.ones((h, w, 1))) for l in field["layers"]]
    side, counts = field["tiles"]["side"], np.frombuffer(view(field["tiles"]["countsView"]), np.uint8)
    across = -(-w // side)
    pictures = [[np.zeros((-(-h // side) * side, across * side, c)) for c in (len(l["low"]), 1)] for l in field["layers"]]
    for t, texture in enumerate(textures):
        own = sorted((l["layer"], j) for j, l in enumerate(field["layers"]) if l["texture"] == t)
        rows, columns = texture[0].shape[0] // side, texture[0].shape[1] // side
        slot = 0
        for tile, count in enumerate(counts):
            y, x = tile // across * side, tile % across * side
            for _, j in own:
                if j < count:
                    place = slot % (rows * columns)
                    r, c = place // columns * side, place % columns * side
                    pictures[j][0][y : y + side, x : x + side] = texture[slot // (rows * columns)][r : r + side, c : c + side]
                    pictures[j][1][y : y + side, x : x + side] = 1
                    slot += 1
    return field, view, [(p[:h, :w], there[:h, :w]) for p, there in pictures]


def covariance(kernel, domain, a, b):
    """k of each row of `a` with each of `b`, without the scale of the matt part; and that part's own values."""
    d = np.linalg.norm(a[:, None] - b[None], axis=-1)
    if kernel["kind"] == "gaussian":
        return np.exp(-((d / kernel["width"]) ** 2)), None
    i = np.arange(256)
    s2, angle = (i + 0.5) / 256, np.pi * (1 + 5**0.5) * i
    normals = np.stack([np.sqrt(s2) * np.cos(angle), np.sqrt(s2) * np.sin(angle), np.sqrt(1 - s2)])

    def slopes(l):
        light = np.maximum(l[:, :3] @ normals, 0)[:, :, None] * [0.1, 0.3, 0.7]
        scale = {"log": lambda x: np.log(domain["delta"] + x), "root": lambda x: np.log(domain["delta"] + np.sqrt(x)), "linear": lambda x: x}
        return scale[domain["kind"]](light).reshape(len(l), -1)

    q = np.sqrt(3) * d / kernel["width"]
    return kernel["rough"] * (1 + q) * np.exp(-q) + 1e4, slopes(a) @ slopes(b).T


def weights_at(field, view, direction):
    """The row of weights for a light; `direction` has six numbers where the field has several views."""
    weights = field["weights"]
    assert weights["kind"] == "lights", "fields with weights by light only"
    at = np.frombuffer(view(weights["directionsView"]), "<f4").reshape(-1, 3)
    if "viewsView" in weights:
        at = np.hstack([at, np.frombuffer(view(weights["viewsView"]), "<f4").reshape(-1, 3)])
    at = at.astype(float)
    codes = np.frombuffer(view(weights["weightsView"]), "<u2" if weights["bits"] == 16 else "u1").reshape(weights["count"], -1)
    low, high = np.array(weights["low"]), np.array(weights["high"])
    table = low + codes / (2 ** weights["bits"] - 1) * (high - low)
    kernel, domain = weights["kernel"], field["domain"]
    among, matt = covariance(kernel, domain, at, at)
    here, matt_here = covariance(kernel, domain, direction[None], at)
    if matt is not None:
        scale = (1 - kernel["rough"]) * len(at) / np.trace(matt)
        among, here = among + scale * matt, here + scale * matt_here
        among = among + kernel["noise"] * np.eye(len(at))
    return (here @ np.linalg.solve(among, table))[0]


def light(path, direction):
    """Light of the texels under a light."""
    field, view, layers = read(path)
    weights = field["weights"]
    row = weights_at(field, view, direction)
    sums = np.zeros((field["height"], field["width"], 3))
    at = 0
    if weights["colour"]:
        sums += row[:3]
        at = 3
    for (texels, there), entry in zip(layers, field["layers"]):
        values = (np.array(entry["low"]) + texels * (np.array(entry["high"]) - np.array(entry["low"]))) * there
        if weights["colour"]:
            for c in range(values.shape[2]):
                sums += values[:, :, c : c + 1] * row[at : at + 3]
                at += 3
        else:
            sums += values * row[at]
            at += 1
    domain, white = field["domain"], field["white"]
    assert domain["kind"] in ("root", "log", "linear"), "fields on these scales only"
    values = np.maximum(sums if domain["kind"] == "linear" else np.exp(sums) - domain["delta"], 0)
    return white * values ** (2 if domain["kind"] == "root" else 1), white


def check(path, direction, picture):
    import OpenEXR

    direction = np.array([float(v) for v in direction.split(",")])
    direction[:3] /= np.linalg.norm(direction[:3])
    got, white = light(path, direction)
    channels = OpenEXR.File(picture).channels()
    truth = channels["RGB"].pixels if "RGB" in channels else np.dstack([channels[c].pixels for c in "RGB"])
    shown = lambda v: np.clip(v / white, 0, 1) ** (1 / 2.2)
    off = np.abs(shown(got) - shown(truth.astype(float)))
    print(f"{path}: largest difference on a display {off.max():.5f}, RMS {np.sqrt((off ** 2).mean()):.6f}")
    assert np.sqrt((off**2).mean()) < 2e-3, "the readers do not agree"


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["blocks", path]:
            write_blocks(path)
        case ["check", path, direction, picture]:
            check(path, direction, picture)
        case _:
            sys.exit(__doc__)
