"""Methods of light transport at equal time, and their bias. Called by run.sh, from the root.

Equal time: on the floors of `floor.py` every method renders for the same seconds on the same threads (loading and compiling
do not count); relMSE = mean of (x - r)^2 / (r^2 + 0.01 mean(r)^2) over pixels and channels. The reference r is the mean of
two long renders by `path` with seeds of their own; what they differ by tells its noise, which is taken out of each relMSE.

Parts: what can be switched off, each left out of the default, and the method as published, at the same steps; beside it the processor time. (The table of all
parts, results/gkernel-parts.md, was made when each had a switch.)

Bias: on four small scenes the mean of a patch against `path`, in percent, with the standard error.
"""
import argparse, csv, json, os, resource, subprocess, sys, tempfile, time
import numpy as np
import OpenEXR
from floor import floor

BINARY = os.environ.get("TRANSLUME") or os.path.join(os.environ.get("CARGO_TARGET_DIR", "target"), "release", "translume")
RESULTS = os.path.join("benches", "results")
METHODS = {"path": ["--integrator", "path"], "bdpt": ["--integrator", "bdpt"], "photonmap": ["--integrator", "photonmap"],
           "gkernel": ["--integrator", "gkernel"], "gkernel-2003": ["--integrator", "gkernel-2003", "-O", "eye-paths=16"]}
UNBIASED = {"gkernel, unbiased": ["--integrator", "gkernel", "--unbiased"]}
PARTS = {"caustics": "false", "shared": "1", "emitters": "false", "unbiased": "true"}


def read(path):
    channels = OpenEXR.File(path, separate_channels=True).channels()
    return np.stack([channels[c].pixels for c in "RGB"], -1).astype(np.float64)


def render(scene, arguments, size, seed):
    """A picture and what the program told."""
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "o.exr")
        told = subprocess.run([BINARY, "render", scene, "-o", out, "--size", f"{size[0]}x{size[1]}", "--seed", str(seed), "--quiet", "--json", *arguments],
                              capture_output=True, check=True, text=True).stdout
        return read(out), json.loads(told)


def mitsuba_process(scene, width, height, seconds, seed, out):
    """Mitsuba's `path` for so many seconds: passes of one sample until the time is up."""
    import drjit, mitsuba
    mitsuba.set_variant("scalar_rgb")
    mitsuba.set_log_level(mitsuba.LogLevel.Error)
    loaded = mitsuba.load_file(scene)
    params = mitsuba.traverse(loaded.sensors()[0])
    params["film.size"] = mitsuba.ScalarVector2u(int(width), int(height))
    params.update()
    total, n, begun = 0, 0, time.time()
    while n == 0 or time.time() - begun < float(seconds):
        total = total + np.array(mitsuba.render(loaded, spp=1, seed=int(seed) * 100_003 + n))[..., :3].astype(np.float64)
        n += 1
    np.save(out, total / n)


def mitsuba_picture(scene, size, seconds, seed):
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "o.npy")
        command = [sys.executable, __file__, "--mitsuba", scene, str(size[0]), str(size[1]), str(seconds), str(seed), out]
        return np.load(out) if subprocess.run(command, capture_output=True).returncode == 0 else None


def rel_mse(picture, reference, noise=0.0):
    weight = 1.0 / (reference ** 2 + 0.01 * reference.mean() ** 2)
    return float((((picture - reference) ** 2 - noise) * weight).mean())


def two_halves(scene, a):
    """The reference, and what its noise adds to squared errors."""
    halves = [render(scene, ["--integrator", "path", "--time", f"{a.reference}s"], a.size, 1000 + a.seed * 2 + i)[0] for i in (0, 1)]
    return (halves[0] + halves[1]) / 2, (halves[0] - halves[1]) ** 2 / 4


PARTS_SIZE = (256, 192)


def parts(a):
    """Rows of: part, (relMSE, processor seconds) of the default without it; the default and the method as published first."""
    with tempfile.TemporaryDirectory() as folder:
        scene, _ = floor(folder, "shut", a.seed, False)
        b = argparse.Namespace(**{**vars(a), "size": PARTS_SIZE})
        reference, noise = two_halves(scene, b)
        def error(*options, method="gkernel"):
            arguments = [word for o in options for word in ("-O", o)]
            spent = -resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            picture, _ = render(scene, ["--integrator", method, "--steps", str(a.parts), *arguments], b.size, a.seed)
            spent += resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            found = rel_mse(picture, reference, noise), spent
            print(f"  parts, {method} {' '.join(options)}: %.4g, %.1f s" % found, flush=True)
            return found
        rows = [("all", error()), ("as published", error(method="gkernel-2003"))]
        return rows + [(f"{part}={off}", error(f"{part}={off}")) for part, off in PARTS.items()]


def equal_time(a):
    rows, counts = [], {}
    names = [(setting, False) for setting in a.settings.split(",") if setting] + [("shut", True)] * a.glossy
    for number, (setting, glossy) in enumerate(names):
        with tempfile.TemporaryDirectory() as folder:
            scene, facts = floor(folder, setting, a.seed, glossy)
            title = f"{setting}{', glossy' if glossy else ''}"
            print(f"{title}: {facts}", flush=True)
            reference, noise = two_halves(scene, a)
            print(f"  reference: relMSE {rel_mse(reference, reference, -noise):.3g}", flush=True)
            for seconds in a.seconds + [a.long] * (a.long > 0 and number < 2):
                few = seconds == a.long
                for method, options in METHODS.items():
                    if few and method not in ("path", "gkernel"):
                        continue
                    picture, told = render(scene, [*options, "--time", f"{seconds}s"], a.size, a.seed)
                    if method == "gkernel":
                        counts[title] = told["counts"]
                    rows.append((title, method, seconds, rel_mse(picture, reference, noise)))
                    print("  %s, %s, %g s: %.4g" % rows[-1], flush=True)
                picture = None if few else mitsuba_picture(scene, a.size, seconds, a.seed)
                if picture is not None:
                    rows.append((title, "Mitsuba path", seconds, rel_mse(picture, reference, noise)))
                    print("  %s, %s, %g s: %.4g" % rows[-1], flush=True)
    return rows, counts


PATCH = """<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="{depth}"/></integrator>
<sensor type="perspective"><float name="fov" value="6"/><transform name="to_world"><lookat origin="{eye}" target="{target}" up="0, 1, 0.01"/></transform>
<film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/><rfilter type="box"/></film></sensor>
<bsdf type="twosided" id="gray"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></bsdf>{shapes}</scene>"""
LAMP = ('<shape type="rectangle"><transform name="to_world"><scale x="{s}" y="{s}"/><rotate x="1" angle="180"/><translate x="{x}" y="{y}" z="{z}"/></transform>'
        '<emitter type="area"><rgb name="radiance" value="10"/></emitter></shape>')
GROUND = '<shape type="rectangle"><transform name="to_world"><scale x="{s}" y="{s}"/><translate x="{x}"/></transform><ref id="gray"/></shape>'
WALL = '<shape type="rectangle"><transform name="to_world"><scale x="2" y="2"/><rotate y="1" angle="-90"/><translate x="1" z="2"/></transform><ref id="gray"/></shape>'
MIRROR = ('<shape type="rectangle"><transform name="to_world"><scale x="0.6" y="0.6"/><rotate y="1" angle="-60"/><translate x="1.2" z="0.7"/></transform>'
          '<bsdf type="roughconductor"><string name="material" value="Al"/><string name="distribution" value="ggx"/><float name="alpha" value="0.1"/></bsdf></shape>')
BIAS = {  # scene, where to look
    "open floor": (GROUND.format(s=4, x=0) + LAMP.format(s=0.3, x=0, y=0, z=2), (0.0, 0.0)),
    "near an edge": (GROUND.format(s=2, x=-1) + WALL + LAMP.format(s=0.3, x=-0.5, y=0, z=2), (0.9, 0.0)),
    "grazing": (GROUND.format(s=4, x=0) + WALL + LAMP.format(s=0.05, x=0.9, y=0, z=0.6), (-2.0, 0.0)),
    "strongly directional": (GROUND.format(s=4, x=0) + MIRROR + LAMP.format(s=0.1, x=0.3, y=0, z=1.5), (0.3, 0.0)),
}


def bias(samples, seeds):
    methods = {k: v for k, v in (METHODS | UNBIASED).items() if k not in ("path", "bdpt")}
    rows = []
    for name, (shapes, (x, y)) in BIAS.items():
        with tempfile.TemporaryDirectory() as folder:
            scene = os.path.join(folder, "scene.xml")
            with open(scene, "w") as f:
                f.write(PATCH.format(depth=4, eye=f"{x}, {y - 0.5}, 3.5" if name != "near an edge" else f"{x - 0.5}, {y}, 1.6", target=f"{x}, {y}, 0", shapes=shapes))
            means = {m: np.array([render(scene, [*o, "--spp", str(n)], (32, 32), s)[0].mean() for s in range(seeds)])
                     for m, o, n in [("path", METHODS["path"], 16 * samples)] + [(m, o, samples) for m, o in methods.items()]}
            truth = means["path"].mean()
            for m in methods:
                error = np.hypot(means[m].std(ddof=1), means["path"].std(ddof=1)) / np.sqrt(seeds)
                rows.append((name, m, 100 * (means[m].mean() / truth - 1), 100 * error / truth))
                print("bias, %s, %s: %+.2f %% +- %.2f" % rows[-1], flush=True)
    return rows


def table(rows, a):
    """One line per floor and time, one column per method; how gkernel compares with the best of the unbiased."""
    methods = list(dict.fromkeys(r[1] for r in rows))
    lines = ["| floor | seconds | " + " | ".join(methods) + " | best rival / gkernel |", "| --- | --- |" + " --- |" * (len(methods) + 1)]
    for key in dict.fromkeys((r[0], r[2]) for r in rows):
        of = {r[1]: r[3] for r in rows if (r[0], r[2]) == key}
        best = min(v for k, v in of.items() if k in ("path", "bdpt", "Mitsuba path"))
        lines.append(f"| {key[0]} | {key[1]:g} | " + " | ".join(f"{of[m]:.3g}" if m in of else "-" for m in methods) + f" | {best / of['gkernel']:.2f} |")
    return lines


def plot(rows, path):
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    floors = list(dict.fromkeys(r[0] for r in rows))
    figure, axes = plt.subplots(1, len(floors), figsize=(4.2 * len(floors), 3.6), squeeze=False)
    for axis, name in zip(axes[0], floors):
        for method in dict.fromkeys(r[1] for r in rows):
            points = [(r[2], r[3]) for r in rows if r[0] == name and r[1] == method]
            axis.loglog(*zip(*points), marker="o", label=method)
        axis.set(title=f"doors {name}", xlabel="seconds", ylabel="relMSE")
    axes[0][0].legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(path, dpi=80)


def main():
    if sys.argv[1:2] == ["--mitsuba"]:
        return mitsuba_process(*sys.argv[2:])
    size = lambda text: tuple(int(v) for v in text.split("x"))
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--settings", default="shut,half,open", help="doors")
    p.add_argument("--glossy", action="store_true", help="also the floor of rough metal, doors shut")
    p.add_argument("--seconds", type=lambda t: [float(v) for v in t.split(",")], default=[10.0, 30.0, 100.0])
    p.add_argument("--long", type=float, default=0, metavar="SECONDS", help="one more time, of path and gkernel alone, on the first two floors")
    p.add_argument("--reference", type=float, default=600, help="seconds of each half")
    p.add_argument("--size", type=size, default=(512, 384))
    p.add_argument("--seed", type=int, default=1, help="of the floor and of the methods")
    p.add_argument("--bias", type=int, default=64, metavar="SPP", help="samples for the bias table; 0: none")
    p.add_argument("--parts", type=int, default=16, metavar="STEPS", help="of each row of the table of parts; 0: none")
    p.add_argument("--dry", action="store_true", help="write no results")
    p.add_argument("--figures", action="store_true", help="the paper's figures 1, 4 and 7 instead (3 minutes)")
    a = p.parse_args()
    if a.figures:
        import figures
        return figures.main()
    rows, counts = equal_time(a)
    partly = parts(a) if a.parts else []
    biased = bias(a.bias, 8) if a.bias else []
    lines = ["# The generalized kernel method beside its rivals", "",
             f"relMSE after equal time at {a.size[0]} × {a.size[1]}, {os.cpu_count()} threads, floor of seed {a.seed} (`benches/gkernel/floor.py`), against",
             f"2 × {a.reference:g} s of `path` whose noise is taken out. Doors shut: 2 % of the lamps reach the view; half: 20 %; open: all. The last",
             "column is above 1 where gkernel is ahead of the best of path, bdpt and Mitsuba's path. Made by `benches/gkernel/run.sh`.", ""]
    lines += table(rows, a) if rows else []
    if counts:
        lines += ["", "What gkernel did in its longest run: " + "; ".join(
            f"doors {k}: h {c['h']:.2g}, {c['steps']} steps, {c['candidates_per_eye_vertex']:.1f} candidates, {c['requested_per_eye_vertex']:.1f} requested and "
            f"{c['unoccluded_per_eye_vertex']:.1f} unoccluded links per eye vertex, visibility {c['mean_visibility']:.2f}" for k, c in counts.items()) + "."]
    if partly:
        lines += ["", f"Parts, relMSE after {a.parts} steps at {PARTS_SIZE[0]} × {PARTS_SIZE[1]}, doors shut, one seed (processor seconds, loading included):", "", "| part | relMSE | seconds |", "| --- | --- | --- |"]
        lines += [f"| {name} | {relmse:.3g} | {spent:.1f} |" for name, (relmse, spent) in partly]
    if biased:
        lines += ["", "Bias of a patch's mean against `path`, in percent, with its standard error:", "", "| scene | method | bias | error |", "| --- | --- | --- | --- |"]
        lines += [f"| {s} | {m} | {b:+.2f} | {e:.2f} |" for s, m, b, e in biased]
    print("\n".join(lines))
    if not a.dry:
        with open(os.path.join(RESULTS, "gkernel.md"), "w") as f:
            f.write("\n".join(lines) + "\n")
        with open(os.path.join(RESULTS, "gkernel.csv"), "w", newline="") as f:
            writer = csv.writer(f)
            writer.writerow(("floor", "method", "seconds", "relmse"))
            writer.writerows(rows)
        if rows:
            plot(rows, os.path.join(RESULTS, "gkernel.png"))


if __name__ == "__main__":
    main()
