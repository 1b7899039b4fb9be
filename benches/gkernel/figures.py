"""The figures 1, 4 and 7 of Bekaert et al. 2003 with our methods: what the method is right about and what it is wrong about. Called by
`run.sh --figures`, from the root; writes `benches/results/gkernel-figures.{png,md}`.

1. Direct light alone after equal time: a photon map that is looked at as it is blurs shadows and leaks through a thin wall.
4. The bias of the method as published (`gkernel-2003`), exaggerated by footprints that are large because light paths are few: too little light, or too much, on
   surfaces that the lamp meets at flat angles, and along edges. Beside it the default and `unbiased`, with as few light paths; below, what
   squares of 4 × 4 pixels have too much (red) or too little (blue).
7. The many-light floor of rough metal after equal time.

relMSE = mean of (x - r)^2 / (r^2 + 0.01 mean(r)^2) over pixels and channels.
"""
import os, tempfile
import numpy as np
from bench import LAMP, METHODS, RESULTS, rel_mse, render
from floor import floor

BOX = '<shape type="cube"><transform name="to_world"><scale x="{sx}" y="{sy}" z="{sz}"/><translate x="{x}" y="{y}" z="{z}"/></transform><ref id="gray"/></shape>'
SCENE = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
<sensor type="perspective"><float name="fov" value="{fov}"/><transform name="to_world"><lookat origin="{eye}" target="{target}" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="256"/><integer name="height" value="192"/><rfilter type="box"/></film></sensor>
<bsdf type="twosided" id="gray"><bsdf type="diffuse"><rgb name="reflectance" value="0.6"/></bsdf></bsdf>{shapes}</scene>"""


def box(low, high):
    half, middle = (np.subtract(high, low) / 2).tolist(), (np.add(high, low) / 2).tolist()
    return BOX.format(**dict(zip(("sx", "sy", "sz", "x", "y", "z"), half + middle)))


def table(x, y):
    """A table top on four legs."""
    legs = [box((x + a, y + b, 0), (x + a + 0.05, y + b + 0.05, 0.7)) for a in (-0.5, 0.45) for b in (-0.35, 0.3)]
    return box((x - 0.55, y - 0.4, 0.7), (x + 0.55, y + 0.4, 0.75)) + "".join(legs)


ROOM = box((-2, -2, -0.1), (2, 2, 0)) + box((-2, 2, 0), (2, 2.1, 2.5))
LEAK = ROOM + box((0.58, -1.0, 0), (0.6, 2, 1.6)) + table(-0.6, 0.5) + LAMP.format(s=0.1, x=-0.9, y=-0.6, z=2.2)
# A blue lamp stands in the back wall; the shelf above it and the floor below see it at flat angles.
BLUE = ('<shape type="rectangle"><transform name="to_world"><scale x="1.2" y="0.5"/><rotate x="1" angle="90"/><translate y="1.99" z="1.0"/></transform>'
        '<emitter type="area"><rgb name="radiance" value="0.6, 1.2, 5"/></emitter></shape>')
GRAZED = ROOM + BLUE + box((-2, 1.0, 1.55), (2, 2, 1.6)) + box((-0.9, 1.2, 0), (-0.6, 1.5, 1.0)) + box((0.7, 0.2, 0), (0.72, 1.9, 1.1))


def written(folder, shapes, eye, target, fov, depth):
    path = os.path.join(folder, "scene.xml")
    with open(path, "w") as f:
        f.write(SCENE.format(depth=depth, eye=eye, target=target, fov=fov, shapes=shapes))
    return path


def row(scene, title, methods, limits, reference, size=(256, 192)):
    """Pictures by name, the reference first, and their lines of the table."""
    truth, _ = render(scene, reference, size, 1000)
    pictures, lines = {"path, long": truth}, []
    for name, options in methods.items():
        picture, told = render(scene, [*options, *limits], size, 1)
        pictures[name] = picture
        lines.append(f"| {title} | {name} | {rel_mse(picture, truth):.3g} | {100 * (picture.mean() / truth.mean() - 1):+.2f} | {told['render_seconds']:.1f} |")
        print(lines[-1], flush=True)
    return pictures, lines


def figures(seconds, reference):
    with tempfile.TemporaryDirectory() as folder:
        long = ["--integrator", "path", "--time", f"{reference}s"]
        gkernel = {k: METHODS[k] for k in ("gkernel-2003", "gkernel")}
        in_map = {"photon map, no gather": ["--integrator", "photonmap", "-O", "gather=false", "-O", "direct=map"]}
        direct = written(folder, LEAK, "0.2, -4.4, 2.6", "0, 0.6, 0.6", 42, 2)
        yield row(direct, "1: direct light", in_map | gkernel, ["--time", f"{seconds}s"], long)
        few = [*METHODS["gkernel"], "-O", "light-paths=500"]
        large = {"2003, 500 light paths": [*METHODS["gkernel-2003"], "-O", "light-paths=500"], "default, 500 light paths": few, "unbiased, 500 light paths": [*few, "--unbiased"]}
        grazed = written(folder, GRAZED, "0.1, -4.2, 1.5", "0, 1, 0.8", 36, 2)
        yield row(grazed, "4: bias", large, ["--spp", "256"], long)
        glossy, _ = floor(folder, "shut", 1, True)
        yield row(glossy, "7: rough metal", {k: METHODS[k] for k in ("path", "bdpt", "photonmap")} | gkernel, ["--time", f"{3 * seconds}s"], long)


def too_much(pictures):
    """Relative errors of squares of 4 x 4 pixels, by name; the reference has none."""
    squares = {name: p.mean(-1).reshape(p.shape[0] // 4, 4, p.shape[1] // 4, 4).mean((1, 3)) for name, p in pictures.items()}
    truth = squares.pop("path, long")
    return {f"error: {name}": (s - truth) / (truth + 0.02 * truth.mean()) for name, s in squares.items()}


def show(rows, path):
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    columns = max(len(p) for p in rows)
    figure, axes = plt.subplots(len(rows), columns, figsize=(2.3 * columns, 1.95 * len(rows)), squeeze=False)
    [axis.axis("off") for axis in axes.flat]
    for line, pictures in zip(axes, rows):
        errors = "path, long" not in pictures
        white = 1.0 if errors else np.percentile(pictures["path, long"], 97)
        for axis, (name, picture) in zip(line[1:] if errors else line, pictures.items()):
            if errors:
                axis.imshow(picture, cmap="RdBu_r", vmin=-0.5, vmax=0.5, interpolation="nearest")
            else:
                axis.imshow(np.clip(picture / white, 0, 1) ** (1 / 2.2), interpolation="nearest")
            axis.set_title(name, fontsize=7)
    figure.tight_layout(pad=0.3)
    figure.savefig(path, dpi=110)


def main(seconds=3.0, reference=60.0):
    pictures, lines = zip(*figures(seconds, reference))
    head = ["# The figures of the paper", "",
            "Figures 1, 4 and 7 of Bekaert et al. 2003 with scenes of our own (`benches/gkernel/figures.py`): direct light after equal time, the bias of large",
            "footprints (below the pictures: too much light in red, too little in blue, white to full colour 50 %), the many-light floor of rough metal after equal",
            "time. Bias: of the picture's mean, in percent, against `path`.", "",
            "![figures](gkernel-figures.png)", "", "| figure | method | relMSE | bias | seconds |", "| --- | --- | --- | --- | --- |"]
    pictures = [pictures[0], pictures[1], too_much(pictures[1]), pictures[2]]
    show(pictures, os.path.join(RESULTS, "gkernel-figures.png"))
    with open(os.path.join(RESULTS, "gkernel-figures.md"), "w") as f:
        f.write("\n".join([*head, *(line for part in lines for line in part)]) + "\n")
