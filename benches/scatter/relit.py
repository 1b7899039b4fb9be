"""Models of captured objects under light that was never captured, against the truth. Called by relit.sh, from the root.

The object has 1002 vertices, a hollow and two bumps, 24 mm, index of refraction 1.5. The truth comes from a random walk from the lights with two seeds,
t1 and t2, whose noise cancels in the error: E^2 = sum (x - t1)(x - t2) / sum t1 t2 over pixels and channels. With --volpath it also
comes from `render --integrator volpath` through a boundary of roughness 0.2 (a smooth one does not let it find lights without size).
FLIP and CIEDE2000 are those of `translume compare` of 2 x 2 blocks with the 98th percentile of the truth at 0.8, as displayed.
"""
import argparse, csv, json, math, os, subprocess, tempfile
import numpy as np
import OpenEXR
from PIL import Image

PROGRAM = os.environ.get("PROGRAM") or os.path.join(os.environ.get("CARGO_TARGET_DIR", "target"), "release", "translume")
RESULTS = os.path.join("benches", "results")
WIDTH, HEIGHT = 128, 96
SIDE, BACK = [0, -70, 35], [0, -78, 5]
LIGHTS = {
    "side": (SIDE, {"type": "point", "position": [-50, -20, 30], "intensity": [3000] * 3}),
    "projector": (SIDE, {"type": "projector", "position": [10, -60, 40], "target": [0.5, 0, 0], "fov_deg": 25, "file": "slide.png", "scale": 4000}),
    "behind": (BACK, {"type": "point", "position": [30, 45, 10], "intensity": [3000] * 3}),
}
MODELS = {
    "hierarchical": ["--model", "hierarchical", "--threshold", "0"],
    "exponential for each vertex": ["--model", "exponential", "--threshold", "0.05"],
    "dipole": ["--model", "dipole", "--uniform", "--threshold", "0"],
    "better dipole": ["--model", "better-dipole", "--uniform", "--threshold", "0"],
    "normalized": ["--model", "normalized", "--uniform", "--threshold", "0"],
}
UNIFORM = ["dipole", "better dipole", "normalized"]


def translume(*arguments):
    done = subprocess.run([PROGRAM, *map(str, arguments), "--quiet", "--json"], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"translume {' '.join(map(str, arguments))}: {done.stderr}")
    return json.loads(done.stdout)


def read(path):
    channels = OpenEXR.File(path, separate_channels=True).channels()
    return np.stack([channels[c].pixels for c in "RGB"], -1).astype(np.float64)


def blob(path, n):
    """An icosphere of frequency n, moved."""
    t = (1 + 5**0.5) / 2
    corners = np.array([(-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0), (0, -1, t), (0, 1, t), (0, -1, -t), (0, 1, -t), (t, 0, -1), (t, 0, 1), (-t, 0, -1), (-t, 0, 1)])
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6), (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8),
             (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10), (8, 6, 7), (9, 8, 1)]
    number, points, triangles = {}, [], []

    def add(p):
        p = p / np.linalg.norm(p)
        key = tuple(np.round(p, 6))
        if key not in number:
            number[key] = len(points)
            points.append(p)
        return number[key]

    for a, b, c in (corners[list(f)] for f in faces):
        grid = {(i, j): add((a * (n - i - j) + b * i + c * j) / n) for i in range(n + 1) for j in range(n + 1 - i)}
        for i, j in ((i, j) for i in range(n) for j in range(n - i)):
            triangles.append((grid[i, j], grid[i + 1, j], grid[i, j + 1]))
            if i + j < n - 1:
                triangles.append((grid[i + 1, j], grid[i + 1, j + 1], grid[i, j + 1]))

    def radius(p):
        bump = lambda x, y, z, s: math.exp(-((p[0] - x) ** 2 + (p[1] - y) ** 2 + (p[2] - z) ** 2) / s**2)
        return 10 * (1 + 0.35 * bump(0.8, 0, 0.6, 0.45) + 0.3 * bump(-0.6, 0.6, 0.5, 0.4) - 0.35 * bump(0.1, -1, 0.1, 0.45) - 0.15 * bump(0, 0, -1, 0.6))

    with open(path, "w") as out:
        for p in points:
            out.write("v %.5f %.5f %.5f\n" % tuple(p * radius(p) * (1.1, 0.8, 0.9)))
        for f in triangles:
            out.write("f %d %d %d\n" % tuple(i + 1 for i in f))


def slide(path):
    """Stripes and a disc with sharp edges."""
    y, x = np.mgrid[0:96, 0:128]
    light = (x < 60) | ((x - 95) ** 2 + (y - 48) ** 2 < 22**2)
    Image.fromarray(np.repeat((255 * light[..., None]).astype(np.uint8), 3, 2)).save(path)


def scene(name, medium, eye, light, samples):
    """The object for `render`."""
    vector = lambda v: ",".join(map(str, v))
    if light["type"] == "point":
        x, y, z = light["position"]
        emitter = f'<emitter type="point"><point name="position" x="{x}" y="{y}" z="{z}"/><rgb name="intensity" value="{vector(light["intensity"])}"/></emitter>'
    else:
        emitter = (f'<emitter type="projector"><transform name="to_world"><lookat origin="{vector(light["position"])}" target="{vector(light["target"])}" up="0,0,1"/></transform>'
                   f'<float name="fov" value="{light["fov_deg"]}"/><texture name="irradiance" type="bitmap"><string name="filename" value="{light["file"]}"/></texture>'
                   # Mitsuba's irradiance is ours over pi.
                   f'<float name="scale" value="{light["scale"] / math.pi}"/></emitter>')
    volume = lambda n: (f'<volume name="{n}" type="gridvolume"><string name="filename" value="{medium}-{n}.vol"/><boolean name="use_grid_bbox" value="true"/>'
                        '<boolean name="raw" value="true"/><string name="filter_type" value="nearest"/></volume>')
    with open(name, "w") as out:
        out.write(f'<scene version="3.0.0"><integrator type="volpath"><integer name="max_depth" value="1000"/><integer name="rr_depth" value="60"/></integrator>'
                  f'<sensor type="perspective"><float name="fov" value="22"/><string name="fov_axis" value="x"/><transform name="to_world"><lookat origin="{vector(eye)}" '
                  f'target="0.5,0,0" up="0,0,1"/></transform><sampler type="independent"><integer name="sample_count" value="{samples}"/></sampler><film type="hdrfilm">'
                  f'<integer name="width" value="{WIDTH}"/><integer name="height" value="{HEIGHT}"/><rfilter type="box"/></film></sensor>'
                  '<shape type="obj"><string name="filename" value="blob.obj"/><boolean name="face_normals" value="true"/><bsdf type="roughdielectric"><float name="int_ior" value="1.5"/>'
                  '<float name="ext_ior" value="1"/><float name="alpha" value="0.2"/></bsdf>'
                  f'<medium name="interior" type="heterogeneous">{volume("sigma_t")}{volume("albedo")}</medium></shape>{emitter}</scene>')


def error(x, truths):
    a, b = truths
    return math.sqrt(max(0.0, ((x - a) * (x - b)).sum() / (a * b).sum()))


def blocks(a, n=2):
    return a.reshape(a.shape[0] // n, n, a.shape[1] // n, n, 3).mean((1, 3))


def shown(picture, white, path):
    light = np.clip(blocks(picture) * 0.8 / white, 0, 1)
    code = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    Image.fromarray((255 * code + 0.5).astype(np.uint8)).save(path)


def once(path, make):
    if not os.path.exists(path):
        make(path)
    return path


def medium_rows(medium, options, work):
    at = lambda *names: os.path.join(work, "-".join(names))
    object_of = ["scatter", "simulate", medium, "--mesh", at("blob.obj")]
    capture = once(at(medium), lambda p: translume(*object_of, "--spacing", 1.2, "--pixels", 96, "--photons", options.photons, "--evenness", 0.5, "--views", 5, "--cameras", 2,
                                                   "--beam", 1, "--save-medium", at(medium), "-o", p))
    told = {}
    for model, arguments in MODELS.items():
        folder = at(medium, model.replace(" ", "_"))
        fit = lambda p: json.dump(translume("scatter", "fit", capture, *arguments, "-o", folder), open(p, "w"))
        told[model] = json.load(open(once(folder + ".json", fit)))
    chosen = min(UNIFORM, key=lambda m: told[m]["held_out_error"])
    with open(os.path.join(capture, "rig.json")) as rig:
        photons = json.load(rig)["provenance"]["parameters"]["photons"]
    rows, strip = [], []
    for name, (eye, light) in LIGHTS.items():
        lights = at(name + ".json")
        with open(lights, "w") as out:
            view = {"eye": eye, "target": [0.5, 0, 0], "fov_deg": 22, "width": WIDTH, "height": HEIGHT, "samples": 2}
            json.dump({"view": view, "lights": [light]}, out)
        walk = [once(at(medium, name, f"truth{s}.exr"), lambda p: translume(*object_of, "--lights", lights, "--photons", options.truth, "--seed", s, "-o", p)) for s in (1, 2)]
        truths = {"walk": [read(p) for p in walk]}
        if options.volpath and medium in options.volpath_media:
            file = at(f"{medium}-{name}.xml")
            scene(file, medium, eye, light, options.volpath)
            volpath = [once(at(medium, name, f"volpath{s}.exr"), lambda p: translume("render", file, "--seed", s, "-o", p)) for s in (1, 2)]
            truths["volpath"] = [read(p) for p in volpath]
        mean = sum(truths["walk"]) / 2
        white = np.percentile(mean[mean.sum(-1) > 0], 98)
        shown(mean, white, at("truth.png"))
        pictures = {}
        for model in MODELS:
            out = at(medium, name, model.replace(" ", "_") + ".exr")
            translume("scatter", "relight", at(medium, model.replace(" ", "_")), "--lights", lights, "-o", out)
            pictures[model] = read(out)
            shown(pictures[model], white, at("test.png"))
            display = translume("compare", at("truth.png"), at("test.png"))
            row = {"medium": medium, "photons": photons, "light": name, "model": model, "chosen": model == chosen, "flip": display["flip_mean"], "ciede2000": display["delta_e_mean"]}
            row.update({kind: error(pictures[model], pair) for kind, pair in truths.items()})
            rows.append(row)
        tone = lambda a: np.clip(a * 0.9 / white, 0, 1) ** (1 / 2.2)
        coarse = lambda a: np.kron(blocks(a), np.ones((2, 2, 1)))
        off = lambda a: np.clip(np.stack([coarse(a - mean).mean(-1), 0 * a[..., 0], coarse(mean - a).mean(-1)], -1) / white / 0.3, 0, 1)
        strip.append([tone(mean), tone(pictures["hierarchical"]), tone(pictures[chosen]), off(pictures["hierarchical"]), off(pictures[chosen])])
    picture = np.concatenate([np.concatenate(row, 1) for row in strip], 0)
    Image.fromarray((255 * picture).astype(np.uint8)).save(at(medium + "-strip.png"))
    return rows, picture


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--media", nargs="*", default=["marble", "apple", "sponge", "wax", "stone"])
    parser.add_argument("--photons", type=int, default=1500, help="of each laser position")
    parser.add_argument("--truth", type=int, default=500_000, help="photons of each of two pictures of the truth")
    parser.add_argument("--volpath", type=int, default=0, help="samples of a pixel in each of two pictures by volpath")
    parser.add_argument("--volpath-media", nargs="*", default=["marble"])
    parser.add_argument("--work", help="keeps captures, models and pictures here, and uses those that are there")
    options = parser.parse_args()
    work = options.work or tempfile.mkdtemp()
    os.makedirs(work, exist_ok=True)
    blob(os.path.join(work, "blob.obj"), 10)
    slide(os.path.join(work, "slide.png"))
    rows, pictures = [], []
    for medium in options.media:
        told, picture = medium_rows(medium, options, work)
        rows += told
        pictures.append(picture)
        write(rows, pictures, options)


def write(rows, pictures, options):
    with open(os.path.join(RESULTS, "scatter-relit.csv"), "w", newline="") as out:
        table = csv.DictWriter(out, ["medium", "photons", "light", "model", "chosen", "walk", "volpath", "flip", "ciede2000"], lineterminator="\n")
        table.writeheader()
        table.writerows({k: f"{v:.4f}" if isinstance(v, float) else v for k, v in r.items()} for r in rows)
    photons = ", ".join(f"{m} {n}" for m, n in dict((r["medium"], r["photons"]) for r in rows).items())
    lines = ["# Objects under light that was never captured", "",
             "Relative RMSE per pixel against a random walk from the lights, its noise taken out; mean FLIP and CIEDE2000 in brackets, of pictures as displayed. An object of",
             f"24 mm with 1002 vertices, index of refraction 1.5, 927 laser positions of some thousand photons each ({photons}). The dipoles and normalised diffusion are one fall-off for",
             "each colour with an albedo by place, all fitted to the same capture; of these, bold is the one that the pixels held out choose. The last",
             "columns are the errors of the bold one and of the one that is best in hindsight, over the hierarchical model's. Made by",
             "`benches/scatter/relit.sh`; all figures are in [scatter-relit.csv](scatter-relit.csv).", "",
             "| medium | light | " + " | ".join(MODELS) + " | ratio, bold | ratio, best |", "|---|---|" + "---|" * (len(MODELS) + 2)]
    of = {(r["medium"], r["light"], r["model"]): r for r in rows}
    media = list(dict.fromkeys(r["medium"] for r in rows))

    def line(medium, light, find, cell):
        hierarchical = find("hierarchical")
        bold = next(m for m in UNIFORM if of[medium, "side", m]["chosen"])
        cells = [cell(m).join(["**"] * 2 if m == bold else [""] * 2) for m in MODELS]
        ratios = [find(bold) / hierarchical, min(map(find, UNIFORM)) / hierarchical]
        lines.append(f"| {medium} | {light} | " + " | ".join(cells) + f" | {ratios[0]:.2f} | {ratios[1]:.2f} |")

    for medium in media:
        for light in LIGHTS:
            row = lambda m: of[medium, light, m]
            line(medium, light, lambda m: row(m)["walk"], lambda m: f'{row(m)["walk"]:.3f} ({row(m)["flip"]:.3f}, {row(m)["ciede2000"]:.1f})')
        root = lambda m: math.sqrt(sum(of[medium, light, m]["walk"] ** 2 for light in LIGHTS) / len(LIGHTS))
        line(medium, "all three", root, lambda m: f"{root(m):.3f}")
    checked = [r for r in rows if "volpath" in r]
    if checked:
        lines += ["", f"The same against `render --integrator volpath` ({options.volpath} samples a pixel, twice, noise taken out as well) through a boundary of roughness 0.2:", "",
                  "| medium | light | " + " | ".join(MODELS) + " |", "|---|---|" + "---|" * len(MODELS)]
        for medium in dict.fromkeys(r["medium"] for r in checked):
            for light in LIGHTS:
                lines.append(f"| {medium} | {light} | " + " | ".join(f'{of[medium, light, m]["volpath"]:.3f}' for m in MODELS) + " |")
    lines += ["", "![For each medium, side by side, and each light, from above: truth, hierarchical, the chosen dipole, and their errors (red: too bright, blue: too dark)](scatter-relit.png)", ""]
    with open(os.path.join(RESULTS, "scatter-relit.md"), "w") as out:
        out.write("\n".join(lines))
    # Two media side by side.
    pairs = [pictures[i:i + 2] for i in range(0, len(pictures), 2)]
    pairs = [np.concatenate(p + [np.zeros_like(p[0])] * (2 - len(p)), 1) for p in pairs]
    Image.fromarray((255 * np.concatenate(pairs, 0)).astype(np.uint8)).save(os.path.join(RESULTS, "scatter-relit.png"))
    print("\n".join(lines))


if __name__ == "__main__":
    main()
