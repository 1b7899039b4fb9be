"""Makes the small files of this folder: pip install OpenEXR==3.5.3 pillow==13.0.0 tifffile==2026.3.3, then run here."""
import numpy as np
import OpenEXR
import tifffile
from PIL import Image, ImageCms

Y, X = np.mgrid[0:20, 0:24].astype(np.float32)
RGB = np.stack([0.1 + X / 16, 0.2 + Y / 8, 0.05 + (X + Y) / 32], -1).astype(np.float32)
W = np.float32([0.2126390, 0.7151687, 0.0721923])  # luminance of Rec. 709


def scanlines(**more):
    return {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **more}


def rgb(dtype=np.float32, prefix=""):
    return {prefix + c: np.ascontiguousarray(RGB[..., i]).astype(dtype) for i, c in enumerate("RGB")}


# Luminance and chroma at half resolution. Chroma is linear here, so that interpolation recovers it.
lum = RGB @ W
ry, by = 0.2 + X / 64 - Y / 128, -0.1 - X / 128 + Y / 256
for name, compression in [("none", OpenEXR.NO_COMPRESSION), ("rle", OpenEXR.RLE_COMPRESSION), ("zips", OpenEXR.ZIPS_COMPRESSION),
                          ("zip", OpenEXR.ZIP_COMPRESSION), ("piz", OpenEXR.PIZ_COMPRESSION)]:
    def half(a, s):  # the module wants full-size arrays and takes the samples from their beginning
        samples = np.zeros(20 * 24, np.float16)
        samples[:20 // s * (24 // s)] = a[::s, ::s].ravel()
        return OpenEXR.Channel(samples.reshape(20, 24), s, s)
    channels = {"Y": half(lum, 1), "RY": half(ry, 2), "BY": half(by, 2)}
    OpenEXR.File({"compression": compression, "type": OpenEXR.scanlineimage}, channels).write(f"chroma-{name}.exr")
OpenEXR.File(scanlines(), {"Y": lum.astype(np.float16)}).write("luminance.exr")

tiles = OpenEXR.TileDescription()
tiles.xSize, tiles.ySize, tiles.mode = 16, 8, OpenEXR.LevelMode.ONE_LEVEL
OpenEXR.File({"compression": OpenEXR.PIZ_COMPRESSION, "type": OpenEXR.tiledimage, "tiles": tiles},
             rgb(np.float16)).write("tiled.exr")
# Stored: 24 x 20 from (2, 3) on; shown: 30 x 16 from (-4, 8) on.
OpenEXR.File(scanlines(dataWindow=((2, 3), (25, 22)), displayWindow=((-4, 8), (25, 23))), rgb()).write("windows.exr")
depth = OpenEXR.Part(scanlines(name="depth"), {"Z": OpenEXR.Channel(X.copy())}, "depth")
beauty = OpenEXR.Part(scanlines(name="beauty"), {k: OpenEXR.Channel(v) for k, v in rgb().items()}, "beauty")
OpenEXR.File([depth, beauty]).write("multipart.exr")
OpenEXR.File(scanlines(), {**rgb(prefix="albedo."), "depth.Z": X.copy()}).write("layers.exr")

deep = np.empty((4, 6), dtype=object)
for i in range(24):
    deep.flat[i] = np.arange(i % 3, dtype=np.float32)
OpenEXR.File({"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}, {"Z": deep}).write("deep.exr")

flat = OpenEXR.Part(scanlines(name="beauty"), {k: OpenEXR.Channel(np.ascontiguousarray(v[:4, :6])) for k, v in rgb(np.float16).items()}, "beauty")
depths = OpenEXR.Part({"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.deepscanline}, {"Z": deep}, "depths")
OpenEXR.File([flat, depths]).write("flat-and-deep.exr")

# Integer pictures: gray ramps and primaries, with profiles and orientations.
ramp = np.linspace(0, 255, 48).reshape(6, 8).astype(np.uint8)
patches = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [128, 128, 128]]], np.uint8).repeat(8, 0).repeat(8, 1)
exif = Image.Exif()
exif[0x0112] = 6
exif[0x010F], exif[0x0110], exif[0x8298] = "Acme", "One", "Nobody"
exif.get_ifd(0x8769).update({0x829A: 0.125, 0x829D: 2.8, 0x8827: 400, 0x9003: "2026:01:02 03:04:05"})
Image.fromarray(patches).save("turned.jpg", quality=100, subsampling=0, exif=exif)
Image.fromarray(patches).save("turned.png", exif=exif)
Image.fromarray(patches).save("turned.tif", tiffinfo={0x0112: 6, 0x010F: "Acme", 0x0110: "One"})
Image.fromarray(ramp).save("gray.jpg", quality=100)
Image.fromarray(patches).save("progressive.jpg", quality=100, progressive=True)
Image.fromarray(patches).quantize(4).save("palette.png", bits=2)
Image.fromarray(np.dstack([patches, np.arange(256, dtype=np.uint8).reshape(16, 16)])).save("alpha.png")
Image.fromarray(ramp > 100).save("one-bit.png")
profile = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
Image.fromarray(patches).save("srgb-profile.png", icc_profile=profile)
tifffile.imwrite("gray-float.tif", RGB[..., 0])
tifffile.imwrite("half-tiled.tif", np.pad(RGB, ((0, 12), (0, 8), (0, 0))).astype(np.float16), tile=(16, 16), photometric="rgb")
tifffile.imwrite("planes.tif", np.ascontiguousarray(np.moveaxis((RGB * 8000).astype(np.uint16), -1, 0)), photometric="rgb",
                 planarconfig="separate")
tifffile.imwrite("big-endian.tif", (RGB * 8000).astype(np.uint16), photometric="rgb", byteorder=">", compression="zlib")
