"""SmallVCM's box scenes with a diffuse floor, by our methods and by its own, at equal processor time.

From the root, with the release binary built: `python3 benches/gkernel/smallvcm.py` (numpy, OpenEXR, Pillow). The scenes are written here from their
facts: corners, reflectances and lights. Of the two floors SmallVCM has only the diffuse one is here: its Phong lobe is none of our materials.

SmallVCM itself (MIT, github.com/SmallVCM/SmallVCM) is no part of this project. If the environment variable SMALLVCM names an executable,
called as `-s MASK -a pt|bpt|ppm|bpm|vcm -t PROCESSOR_SECONDS -r SIZE -n THREADS -seed N -o OUT.pfm` (MASK: its `BoxMask`), it takes part;
its own command line wants a small `main` for that. Otherwise only our methods run.

Equal processor time: ours are stopped by an interrupt, as by Ctrl-C, when the process has used its seconds; SmallVCM stops itself after the
iteration in which they ran out. What each really took is printed.

relMSE = mean of (x - r)^2 / (r^2 + 0.01 mean(r)^2) over pixels and channels, the reference's own noise taken out; median over the seeds.
"""
import argparse, os, signal, subprocess, tempfile, time
import numpy as np
import OpenEXR

BINARY = os.path.join(os.environ.get("CARGO_TARGET_DIR", "target"), "release", "translume")
SMALLVCM = os.environ.get("SMALLVCM")
RESULTS = os.path.join("benches", "results")

LOW, HIGH = np.array([-1.27029, -1.25549, -1.28002]), np.array([1.28975, 1.30455, 1.28002])  # the box, open towards -y
WHITE, GREEN, RED = "0.803922, 0.803922, 0.803922", "0.156863, 0.803922, 0.172549", "0.803922, 0.152941, 0.152941"
MASK = {"ceiling": 1, "sun": 2, "point": 4, "background": 8, "large mirror": 16, "small": 64 + 128}
SCENES = {  # name: what is in the box, its light
    "mirror, ceiling": ("large mirror", "ceiling"),
    "balls, sun": ("small", "sun"),
    "balls, point": ("small", "point"),
    "balls, background": ("small", "background"),
}
OURS = {"path": [], "bdpt": [], "photonmap": [], "gkernel": []}
THEIRS = {"PT": "pt", "BPT": "bpt", "PPM": "ppm", "BPM": "bpm", "VCM": "vcm"}
SHOWN = ("bdpt", "photonmap", "gkernel", "BPT", "PPM", "VCM")  # in the strip
CAUSTICS_SEEN_BY_MERGING_ONLY = ("sun", "point")  # in mirrors: no connection finds mirror-floor-glass-point


def rectangle(corner, u, v, inside):
    """A rectangle from a corner along u and v; its normal u x v."""
    m = np.column_stack([u / 2, v / 2, np.cross(u, v) / np.linalg.norm(np.cross(u, v)), corner + u / 2 + v / 2])
    rows = " ".join(f"{x:.9g}" for x in np.vstack([m, [0, 0, 0, 1]]).ravel())
    return f'<shape type="rectangle"><transform name="to_world"><matrix value="{rows}"/></transform>{inside}</shape>\n'


def ball(centre, radius, inside):
    x, y, z = centre
    return f'<shape type="sphere"><point name="center" x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/><float name="radius" value="{radius}"/>{inside}</shape>\n'


def scene(contents, light, size):
    """The Mitsuba XML of a scene."""
    x, y, z = (np.eye(3) * (HIGH - LOW))
    matt = lambda rgb: f'<bsdf type="diffuse"><rgb name="reflectance" value="{rgb}"/></bsdf>'
    mirror, glass = '<bsdf type="conductor"><string name="material" value="none"/></bsdf>', '<bsdf type="dielectric"><float name="int_ior" value="1.6"/><float name="ext_ior" value="1"/></bsdf>'
    box = (rectangle(LOW, x, y, matt(WHITE)) + rectangle(LOW + z, y, x, matt(WHITE)) + rectangle(LOW + y, x, z, matt(WHITE))
           + rectangle(LOW, y, z, matt(GREEN)) + rectangle(LOW + x, z, y, matt(RED)))
    if light != "point":  # the lamp's box hangs from the ceiling, lit or not
        a, b = np.array([-0.25, -0.25, 1.26002]), np.array([0.5, 0.5, 0.02])
        u, v, w = np.eye(3) * b
        lamp = '<emitter type="area"><rgb name="radiance" value="25.03329895614464"/></emitter>' if light == "ceiling" else ""
        box += rectangle(a, v, u, matt("0, 0, 0" if lamp else WHITE) + lamp)
        box += rectangle(a, u, w, matt(WHITE)) + rectangle(a + v, w, u, matt(WHITE)) + rectangle(a, w, v, matt(WHITE)) + rectangle(a + u, v, w, matt(WHITE))
    floor = np.array([(LOW[0] + HIGH[0]) / 2, (LOW[1] + HIGH[1]) / 2, LOW[2]])
    if contents == "small":
        shift = np.array([(0.5 - 2 / 7) * x[0], 0, 0])
        box += ball(floor - shift + [0, 0, 0.5], 0.5, mirror) + ball(floor + shift + [0, 0, 0.5], 0.5, glass)
    else:
        box += ball(floor + [0, 0, 0.8], 0.8, mirror)
    rgb = lambda name, values: f'<rgb name="{name}" value="{", ".join(f"{v:.9g}" for v in values)}"/>'
    box += {"ceiling": "", "sun": '<emitter type="directional"><vector name="direction" x="-1" y="1.5" z="-1"/>' + rgb("irradiance", (10, 4, 0)) + "</emitter>",
            "point": '<emitter type="point"><point name="position" x="0" y="-0.5" z="1"/>' + rgb("intensity", (70 / (4 * np.pi),) * 3) + "</emitter>",
            "background": '<emitter type="constant">' + rgb("radiance", np.array([135, 206, 250]) / 255) + "</emitter>"}[light]
    eye = np.array([-0.0439815, -4.12529, 0.222539])
    point = lambda p: ", ".join(f"{v:.9g}" for v in p)
    return f"""<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="10"/></integrator>
<sensor type="perspective"><float name="fov" value="45"/><transform name="to_world">
<lookat origin="{point(eye)}" target="{point(eye + [0.00688625, 0.998505, -0.0542161])}" up="0.000373896, 0.0542148, 0.998529"/></transform>
<film type="hdrfilm"><integer name="width" value="{size}"/><integer name="height" value="{size}"/><rfilter type="box"/></film></sensor>
{box}</scene>
"""


def read_exr(path):
    channels = OpenEXR.File(path, separate_channels=True).channels()
    return np.stack([channels[c].pixels for c in "RGB"], -1).astype(np.float64)


def read_pfm(path):
    with open(path, "rb") as f:
        assert f.readline().strip() == b"PF"
        width, height = map(int, f.readline().split())
        assert float(f.readline()) < 0
        return np.frombuffer(f.read(), "<f4").reshape(height, width, 3)[::-1].astype(np.float64)


def used(pid):
    """Processor seconds of a running process."""
    with open(f"/proc/{pid}/stat") as f:
        fields = f.read().rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def ours(xml, options, seconds, seed, threads):
    """A picture after so many processor seconds, and those it really took."""
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "o.exr")
        process = subprocess.Popen([BINARY, "render", xml, "-o", out, "--seed", str(seed), "--threads", str(threads), "--quiet", "--time", "10h", *options],
                                   stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        while used(process.pid) < seconds and process.poll() is None:
            time.sleep(0.005)
        process.send_signal(signal.SIGINT)
        error = process.stderr.read().decode()
        _, _, usage = os.wait4(process.pid, 0)
        if not os.path.exists(out):
            raise SystemExit(f"{options}: {error}")
        return read_exr(out), usage.ru_utime + usage.ru_stime


def theirs(mask, algorithm, seconds, seed, threads, size):
    with tempfile.TemporaryDirectory() as folder:
        out = os.path.join(folder, "o.pfm")
        process = subprocess.Popen([SMALLVCM, "-s", str(mask), "-a", algorithm, "-t", str(seconds), "-r", str(size), "-n", str(threads), "-seed", str(seed), "-o", out],
                                   stdout=subprocess.DEVNULL)
        _, _, usage = os.wait4(process.pid, 0)
        return read_pfm(out), usage.ru_utime + usage.ru_stime


def rel_mse(picture, reference, noise=0.0):
    weight = 1.0 / (reference ** 2 + 0.01 * reference.mean() ** 2)
    return float((((picture - reference) ** 2 - noise) * weight).mean())


def draw(method, name, xml, seconds, seed, a):
    """A picture by one of all methods, and the processor seconds it took."""
    if method in OURS:
        return ours(xml, ["--integrator", method, *OURS[method]], seconds, seed, a.threads)
    return theirs(sum(MASK[part] for part in SCENES[name]), THEIRS[method], seconds, seed, a.threads, a.size)


def reference(name, xml, a):
    """A long picture, what its noise adds to squared errors, and by which methods it was made."""
    merging = SCENES[name][1] in CAUSTICS_SEEN_BY_MERGING_ONLY
    methods = (("VCM", "VCM") if merging else ("bdpt", "BPT")) if SMALLVCM else (("gkernel", "gkernel") if merging else ("bdpt", "bdpt"))
    one, two = (draw(method, name, xml, a.reference, 1001 + i, a)[0] for i, method in enumerate(methods))
    return (one + two) / 2, (one - two) ** 2 / 4, " + ".join(methods)


def table(errors, methods, a):
    """One line per scene and time: the median over the seeds by each method."""
    lines = ["| scene | seconds | " + " | ".join(methods) + " |", "| --- | --- |" + " --- |" * len(methods)]
    for name in SCENES:
        for seconds in a.seconds:
            of = [np.median(errors[name, seconds, m]) for m in methods]
            lines.append(f"| {name} | {seconds:g} | " + " | ".join(f"**{v:.3g}**" if v == min(of) else f"{v:.3g}" for v in of) + " |")
    return lines


def main():
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--seconds", type=lambda t: [float(v) for v in t.split(",")], default=[10.0, 30.0], help="processor seconds of a picture")
    p.add_argument("--reference", type=float, default=200, help="processor seconds of each half of a reference")
    p.add_argument("--size", type=int, default=256, help="pixels across")
    p.add_argument("--threads", type=int, default=2)
    p.add_argument("--seeds", type=int, default=3)
    p.add_argument("--keep", metavar="FOLDER", help="write the scenes' XML here and stop")
    p.add_argument("--dry", action="store_true", help="write no results")
    a = p.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        xml = {name: os.path.join(a.keep or temporary, name.replace(", ", "-") + ".xml") for name in SCENES}
        for name, path in xml.items():
            with open(path, "w") as f:
                f.write(scene(*SCENES[name], a.size))
        if not a.keep:
            measure(xml, a)


def measure(xml, a):
    methods = [*OURS, *(THEIRS if SMALLVCM else ())]
    truth = {name: reference(name, xml[name], a) for name in SCENES}
    errors, pictures, took, means = {}, {}, {}, {}
    for seed in range(1, a.seeds + 1):
        for name in SCENES:
            for seconds in a.seconds:
                for m in methods:
                    picture, cpu = draw(m, name, xml[name], seconds, seed, a)
                    errors.setdefault((name, seconds, m), []).append(rel_mse(picture, *truth[name][:2]))
                    took.setdefault((seconds, m), []).append(cpu)
                    means.setdefault((name, m), []).append(picture.mean() / truth[name][0].mean() - 1)
                    pictures[name, m] = picture
                    print(f"seed {seed}, {name}, {m}, {cpu:.2f} s: {errors[name, seconds, m][-1]:.4g}", flush=True)
    over = max(max(v) / k[0] for k, v in took.items()) - 1
    lines = table(errors, methods, a) + ["", f"No picture took more than {100 * over:.0f} % longer than the others' seconds. Its mean beside the reference's, in percent (all runs; ±: standard error):", "",
        "| scene | reference by | its own relMSE | " + " | ".join(methods) + " |", "| --- | --- | --- |" + " --- |" * len(methods)]
    for name, (picture, noise, by) in truth.items():
        cells = [f"{100 * np.mean(v):+.2f} ± {100 * np.std(v, ddof=1) / len(v) ** 0.5:.2f}" for v in (means[name, m] for m in methods)]
        lines.append(f"| {name} | {by} | {rel_mse(picture, picture, -noise):.2g} | " + " | ".join(cells) + " |")
    print("\n".join(lines))
    if not a.dry:
        write(lines, truth, pictures, methods, a)


def write(lines, truth, pictures, methods, a):
    """The tables go below the heading of the page whose words are written by hand; the strip beside it."""
    from PIL import Image
    page = os.path.join(RESULTS, "smallvcm.md")
    words = open(page).read().split("\n## Tables\n")[0] if os.path.exists(page) else "# SmallVCM's boxes\n"
    with open(page, "w") as f:
        f.write(words + "\n## Tables\n\n" + "\n".join(lines) + "\n")
    rows = [np.hstack([truth[name][0], *(pictures[name, m] for m in SHOWN if m in methods)]) for name in SCENES]
    strip = (255 * np.clip(np.vstack(rows), 0, 1) ** (1 / 2.2)).astype(np.uint8)
    Image.fromarray(strip).resize((strip.shape[1] * 96 // a.size, strip.shape[0] * 96 // a.size), Image.BOX).quantize(256).save(os.path.join(RESULTS, "smallvcm.png"), optimize=True)


if __name__ == "__main__":
    main()
