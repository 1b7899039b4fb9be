"""Brackets with a known truth through `translume hdr` and OpenCV. Called by run.sh, from the root of the project."""
import argparse, csv, json, os, platform, re, subprocess, sys, tempfile, time
import cv2
import numpy as np
import OpenEXR
import cases as bench_cases
import simulate as sim

BINARY = os.path.join(os.environ.get("CARGO_TARGET_DIR", "target"), "release", "translume")
SCENES = {"room": "crates/translume/assets/room.exr"}
MORE_SCENES = {"living-room": "scenes/living-room/TungstenRender.exr", "modern-hall": "scenes/modern-hall/TungstenRender.exr"}
PIXELS = 1e6  # scenes with more are scaled down
MU = 5000.0
INNER = 0.04  # of the sides, beside which nothing is measured
LOAD = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0  # before the bench began
ABLATION = ["turn 2°", "parallax", "moving object", "hand-held + moving", "large parallax, 60 px"]


def read_exr(path, channels=("R", "G", "B")):
    with OpenEXR.File(path, separate_channels=True) as file:
        planes = file.channels()
        return np.stack([planes[c].pixels.astype(np.float32) for c in channels], -1)


def write_exr(path, rgb):
    planes = {c: np.ascontiguousarray(rgb[..., i]) for i, c in enumerate("RGB")}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, planes).write(path)


def load_scene(path):
    """Linear, at most PIXELS large, with the brightest three in a hundred pixels above 1."""
    scene = np.maximum(read_exr(path), 0)
    scale = min(1.0, (PIXELS / (scene.shape[0] * scene.shape[1])) ** 0.5)
    scene = cv2.resize(scene, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return scene / np.percentile(scene.mean(-1), 97)


def inner(image):
    h, w = image.shape[:2]
    return image[int(h * INNER):h - int(h * INNER), int(w * INNER):w - int(w * INNER)]


def score(case, image):
    """PSNR-µ in dB at the anchor, up to the radiance that the shortest exposure holds; absolute scale is free."""
    limit = sim.WHITE_SECS / min(case.secs)
    truth = np.clip(case.views[case.anchor], 0, limit)
    t, i = truth.mean(-1), image.mean(-1)
    low, high = np.percentile(t, [20, 95])
    ok = (t > low) & (t < high) & (i > 0)
    image = np.clip(image * np.median(t[ok] / i[ok]), 0, limit) if ok.any() else image
    top = np.percentile(truth, 99.9)
    law = lambda x: np.log1p(MU * np.clip(x / top, 0, 1)) / np.log1p(MU)
    return float(-10 * np.log10(np.mean((law(inner(image)) - law(inner(truth))) ** 2)))


def run_translume(case, options=(), with_fields=True):
    """(radiance, seconds, mean end-point error in pixels or None)"""
    with tempfile.TemporaryDirectory() as folder:
        files = []
        for k, shot in enumerate(case.shots):
            files.append(os.path.join(folder, f"shot{k}." + ("exr" if case.depth == "linear" else "png")))
            write_exr(files[-1], shot) if case.depth == "linear" else cv2.imwrite(files[-1], shot[..., ::-1])
        out = os.path.join(folder, "out.exr")
        command = [BINARY, "hdr", *files, "--exposures=" + ",".join(f"{t:.9g}" for t in case.secs), f"--anchor={case.anchor}", "-o", out, "--json", *options]
        start = time.perf_counter()
        run = subprocess.run(command, capture_output=True, text=True)
        seconds = time.perf_counter() - start
        if run.returncode:
            sys.exit(f"{case.name}: {run.stderr.strip()}")
        for warning in json.loads(run.stdout)["warnings"]:
            print(f"    {case.name}: {warning}", file=sys.stderr)
        error = None
        if with_fields:  # in a run of its own, so that writing them is not timed
            fields = os.path.join(folder, "fields")
            subprocess.run([*command, "--fields", fields], capture_output=True, check=True)
            error = end_point_error(case, [os.path.join(fields, n) for n in sorted(os.listdir(fields))])
        return read_exr(out), seconds, error


def end_point_error(case, files):
    """Mean over the shots but the anchor, of all pixels where the true displacement is known and stays in the picture."""
    w, h = case.shots[0].shape[1], case.shots[0].shape[0]
    errors = []
    for k, file in enumerate(files):
        if k != case.anchor:
            truth = case.forth[k] - grid_like(case)
            inside = (case.forth[k] >= 0).all(-1) & (case.forth[k][..., 0] <= w - 1) & (case.forth[k][..., 1] <= h - 1)
            away = np.linalg.norm(read_exr(file, ("X", "Y")) - truth, axis=-1)
            errors.append(away[inside & case.known[k]].mean())
    return float(np.mean(errors))


def grid_like(case):
    h, w = case.shots[0].shape[:2]
    return sim.grid((0, 0, w, h))


def run_opencv(case, align):
    """(radiance, seconds): Debevec's response and merge, after MTB alignment against the anchor if asked for."""
    start = time.perf_counter()
    images = [to_8_bit(shot)[..., ::-1].copy() for shot in case.shots]
    if align:
        mtb = cv2.createAlignMTB(6, 4, False)
        gray = [cv2.cvtColor(i, cv2.COLOR_BGR2GRAY) for i in images]
        images = [mtb.shiftMat(i, mtb.calculateShift(gray[case.anchor], g)) for i, g in zip(images, gray)]
    secs = np.float32(case.secs)
    curve = cv2.createCalibrateDebevec().process(images, secs)
    merged = cv2.createMergeDebevec().process(images, secs, curve)[..., ::-1]
    return np.nan_to_num(merged, posinf=0, neginf=0), time.perf_counter() - start


def to_8_bit(shot):
    """OpenCV's chain takes 8 bits and nothing else: what a user would convert to."""
    if shot.dtype == np.uint16:
        return np.round(shot / 257).astype(np.uint8)
    return np.round(255 * shot ** (1 / 2.2)).astype(np.uint8) if shot.dtype != np.uint8 else shot


def measure(scene_name, scene, names, rows, keep):
    for name, make in bench_cases.cases(scene).items():
        if name not in names:
            continue
        case = make().photograph(7)
        ours, seconds, error = run_translume(case)
        plain, aligned = run_opencv(case, False), run_opencv(case, True)
        row = {"scene": scene_name, "case": name, "translume_db": score(case, ours), "opencv_db": score(case, plain[0]),
               "opencv_mtb_db": score(case, aligned[0]), "translume_s": seconds, "opencv_s": plain[1], "opencv_mtb_s": aligned[1],
               "end_point_px": error, "megapixels": len(case.shots) * case.shots[0].shape[0] * case.shots[0].shape[1] / 1e6}
        if name in ABLATION and has_align_option():
            for how in ("global", "nonlinear"):
                for ghosts, more in (("", []), ("_keep_ghosts", ["--no-deghost"])):
                    row[f"{how}{ghosts}_db"] = score(case, run_translume(case, [f"--align={how}", *more], False)[0])
        rows.append(row)
        print(line(row), flush=True)
        keep(case, ours, plain[0], aligned[0])


def has_align_option():
    text = subprocess.run([BINARY, "hdr", "--help"], capture_output=True, text=True).stdout
    return re.search(r"^\s+--align\b", text, re.M) is not None


def line(r):
    return (f"{r['scene']:12s} {r['case']:22s} translume {r['translume_db']:6.2f} dB {r['translume_s']:5.2f} s   OpenCV {r['opencv_db']:6.2f} dB "
            f"{r['opencv_s']:5.2f} s   + MTB {r['opencv_mtb_db']:6.2f} dB {r['opencv_mtb_s']:5.2f} s   field off by {r['end_point_px']:.2f} px")


def machine():
    try:
        with open("/proc/cpuinfo") as f:
            model = next((l.split(":", 1)[1].strip() for l in f if l.startswith("model name")), platform.processor())
    except OSError:
        model = platform.processor()
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True).stdout.strip()
    return f"{model}, {len(os.sched_getaffinity(0))} cores (load {LOAD:.1f} from other work), OpenCV {cv2.__version__}, translume {commit}"


def markdown(rows):
    """The table, means over the scenes, and the ablation."""
    names = list(dict.fromkeys(r["case"] for r in rows))
    mean = lambda name, key: np.mean([r[key] for r in rows if r["case"] == name])
    out = [f"Means over {', '.join(dict.fromkeys(r['scene'] for r in rows))}. {machine()}.", "",
           "| case | translume | OpenCV | OpenCV + MTB | translume, s | OpenCV, s | + MTB, s | field off by |", "|---|--:|--:|--:|--:|--:|--:|--:|"]
    for n in names:
        dbs = [mean(n, k) for k in ("translume_db", "opencv_db", "opencv_mtb_db")]
        cells = [f"**{v:.2f} dB**" if v == max(dbs) else f"{v:.2f} dB" for v in dbs]
        cells += [f"{mean(n, k):.2f}" for k in ("translume_s", "opencv_s", "opencv_mtb_s")]
        out.append(f"| {n} | {' | '.join(cells)} | {mean(n, 'end_point_px'):.2f} px |")
    if "global_db" in next((r for r in rows if r["case"] in ABLATION), {}):
        out += ["", "What alignment and ghost removal bring, in dB PSNR-µ:", "",
                "| case | linear | linear, ghosts removed | non-linear | non-linear, ghosts removed |", "|---|--:|--:|--:|--:|"]
        for n in [n for n in names if n in ABLATION]:
            keys = ("global_keep_ghosts_db", "global_db", "nonlinear_keep_ghosts_db", "nonlinear_db")
            out.append(f"| {n} | " + " | ".join(f"{mean(n, k):.2f}" for k in keys) + " |")
    return "\n".join(out) + "\n"


def write_results(rows, folder):
    os.makedirs(folder, exist_ok=True)
    columns = list(dict.fromkeys(k for r in rows for k in r))
    with open(os.path.join(folder, "hdr.csv"), "w", newline="") as f:
        writer = csv.DictWriter(f, [*columns, "machine"])
        writer.writeheader()
        writer.writerows({k: f"{v:.4f}" if isinstance(v, float) else v for k, v in {**r, "machine": machine()}.items()} for r in rows)
    with open(os.path.join(folder, "hdr.md"), "w") as f:
        f.write(markdown(rows))


def tone(image, white):
    """Reinhard's global operator at one white, sRGB."""
    lum = np.maximum(image @ np.float32([0.2126, 0.7152, 0.0722]), 1e-9)
    key = 0.18 / np.exp(np.log(lum).mean())
    l, w = lum * key, white * key
    shown = np.clip(image * (key * (1 + l / w ** 2) / (1 + l))[..., None], 0, 1)
    return np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)


def save_strip(case, images, folder):
    """One JPEG with the longest and the shortest shot, the merges and the truth, for docs/hdr.md."""
    truth = case.views[case.anchor]
    t = truth.mean(-1)
    white = np.percentile(truth, 99.9)
    ok = (t > np.percentile(t, 20)) & (t < np.percentile(t, 95))
    shown = [tone(np.maximum(i, 0) * np.median(t[ok] / np.maximum(i.mean(-1)[ok], 1e-9)), white) for i in [*images, truth]]
    panels = [to_8_bit(case.shots[-1]) / 255.0, *shown]
    h, w = truth.shape[:2]
    crop = (slice(int(h * 0.28), int(h * 0.92)), slice(int(w * 0.18), int(w * 0.82)))
    panels = [cv2.resize(np.float32(p[crop]), (300, round(300 * h / w)), interpolation=cv2.INTER_AREA) for p in panels]
    gap = np.ones((panels[0].shape[0], 4, 3), np.float32)
    strip = np.hstack([x for p in panels for x in (p, gap)][:-1])
    name = "hdr-" + re.sub(r"[^a-z0-9]+", "-", case.name.lower()).strip("-") + ".jpg"
    cv2.imwrite(os.path.join(folder, name), np.uint8(np.clip(255 * strip[..., ::-1] + 0.5, 0, 255)), [cv2.IMWRITE_JPEG_QUALITY, 86])


def update_page(path, text):
    """Puts the table between the marks of the page."""
    with open(path) as f:
        page = f.read()
    page = re.sub(r"(<!-- table -->\n).*(<!-- end -->)", lambda m: m[1] + text + m[2], page, flags=re.S)
    with open(path, "w") as f:
        f.write(page)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--quick", action="store_true", help="the built-in scene and six cases only; results are not written")
    parser.add_argument("--docs", action="store_true", help="also renew docs/hdr.md and its pictures")
    arguments = parser.parse_args()
    scenes = dict(SCENES)
    data = os.environ.get("TRANSLUME_DATA")
    if data and not arguments.quick:
        scenes |= {n: os.path.join(data, p) for n, p in MORE_SCENES.items() if os.path.exists(os.path.join(data, p))}
    elif not data:
        print("TRANSLUME_DATA is not set: the built-in scene only", file=sys.stderr)
    if not has_align_option():
        print("this translume has no --align: no ablation", file=sys.stderr)
    rows, pictures = [], {"hand-held + moving", "large parallax, 60 px", "turn 10°", "parallax"}
    for name, path in scenes.items():
        scene = load_scene(path)
        names = list(bench_cases.cases(scene))

        def keep(case, ours, plain, aligned):
            if arguments.docs and name == "room" and case.name in pictures:
                save_strip(case, [plain, aligned, ours], "docs/images")
        measure(name, scene, names[:6] if arguments.quick else names, rows, keep)
    print("\n" + markdown(rows))
    if not arguments.quick:
        write_results(rows, "benches/results")
    if arguments.docs:
        update_page("docs/hdr.md", markdown(rows))


if __name__ == "__main__":
    main()
